"""Memory that clients have left goes back to the system.

glibc keeps freed pages that lie between used ones. Where boards come and go for long, the process
would come to hold the worst moment of each part of the heap.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

# How often at most, in seconds: it takes 0.2 ms with a hundred boards, and 4 ms for each ten
# megabytes that are full of holes.
PAUSE: Final = 30.0


class Heap:
    """Asks the C library to give back what is free, some time after clients have left."""

    def __init__(self) -> None:
        self.somebody_left = False
        self._next: float | None = None
        self._trim: Callable[[int], int] | None = None

    def check(self, now: float) -> None:
        """``now`` in seconds; called about once a second."""
        if not self.somebody_left:
            return
        if self._next is None:
            self._next = now + PAUSE
        elif now >= self._next:
            self._next = None
            self.somebody_left = False
            self.trim()

    def trim(self) -> None:
        """Give back what is free; nothing where the C library is not glibc."""
        if self._trim is None:
            import ctypes

            try:
                self._trim = ctypes.CDLL(None).malloc_trim
            except (OSError, AttributeError, TypeError):  # musl, macOS, Windows
                self._trim = lambda keep: 0
        self._trim(0)
