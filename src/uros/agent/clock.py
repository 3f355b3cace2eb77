"""The agent's clock: milliseconds modulo 2^30, which no jump takes out of reach.

Times are compared modulo 2^30, so two must not be more than 6 days apart. A process that was
stopped for longer, or a virtual machine that was, would find its deadlines in the future.
"""

from __future__ import annotations

import time
from typing import Final

from ..ticks import TIME_MASK

# A TIMESTAMP knows no later one, and none before 1970.
_LAST_SECOND: Final = 0x7FFFFFFF
# More than this has not passed between two looks at the clock.
MAX_STEP: Final = 3_600_000


class Clock:
    """Call it for the time."""

    __slots__ = ("_behind", "_last")

    def __init__(self) -> None:
        self._last = int(time.monotonic() * 1000)
        self._behind = 0  # what was not counted

    def __call__(self) -> int:
        now = int(time.monotonic() * 1000)
        passed = now - self._last
        self._last = now
        if passed > MAX_STEP:
            self._behind += passed - MAX_STEP
        elif passed < 0:  # on no system that keeps its word
            self._behind += passed
        return (now - self._behind) & TIME_MASK


def wall_clock() -> tuple[int, int]:
    """Seconds and nanoseconds, as a message can have them: the clock may stand anywhere."""
    return divmod(min(max(0, time.time_ns()), _LAST_SECOND * 1_000_000_000), 1_000_000_000)
