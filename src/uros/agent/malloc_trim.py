"""Returns freed memory to the system some time after clients have left.

glibc keeps freed pages that lie between used ones. While boards connect and leave for a long time,
the process would keep the largest size that each part of the heap ever had.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

# The least time between two trims, in seconds: one takes 0.2 ms with a hundred boards, and 4 ms for
# each ten megabytes of fragmented heap.
PAUSE: Final = 30.0


class Heap:
    """Makes the C library return free memory, some time after clients have left.

    Attributes:
        clients_left: Whether clients have left since the last trim; the agent sets it.
    """

    def __init__(self) -> None:
        self.clients_left = False
        self._next: float | None = None
        self._trim: Callable[[int], int] | None = None

    def check(self, now: float) -> None:
        """Trim if it is time to; called about once a second.

        Args:
            now: Seconds of a monotonic clock.
        """
        if not self.clients_left:
            return
        if self._next is None:
            self._next = now + PAUSE
        elif now >= self._next:
            self._next = None
            self.clients_left = False
            self.trim()

    def trim(self) -> None:
        """Return free memory to the system; does nothing if the C library is not glibc."""
        if self._trim is None:
            import ctypes

            try:
                self._trim = ctypes.CDLL(None).malloc_trim
            except (OSError, AttributeError, TypeError):  # musl, macOS, Windows
                self._trim = lambda keep: 0
        self._trim(0)
