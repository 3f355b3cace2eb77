"""A call after changes, with a limited rate: a starting node makes dozens in a moment."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Final

# Seconds from the first change to the call, and between two calls. Boards get the whole graph at
# every change, some on a line of 11 kB a second.
_SETTLE: Final = 0.1
_INTERVAL: Final = 1.0


class PacedCall:
    """Calls a function at most once a second, soon after a change.

    Attributes:
        due: When :meth:`tick` calls it (``time.monotonic``), or None.

    Args:
        call: The function.
    """

    def __init__(self, call: Callable[[], None]) -> None:
        self.due: float | None = None
        self._call = call
        self._called_at = 0.0

    def changed(self) -> None:
        """Have it called."""
        if self.due is None:
            self.due = max(time.monotonic() + _SETTLE, self._called_at + _INTERVAL)

    def tick(self, now: float) -> None:
        """Call it; ``now`` is ``time.monotonic``."""
        self.due = None
        self._called_at = now
        self._call()
