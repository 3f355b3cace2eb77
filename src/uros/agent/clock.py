"""The clock of the agent: the one place where it reads the time.

Timestamps of a session are milliseconds modulo 2^30 and are compared modulo 2^30, so two must not
be more than 6 days apart. A process that was stopped for longer, or a virtual machine that was,
would find its deadlines in the future; :meth:`Clock.ticks` therefore limits each step.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Final

from ..ticks import TIME_MASK

# The last second of a TIMESTAMP submessage; the first is in 1970.
_LAST_SECOND: Final = 0x7FFFFFFF
# The most milliseconds that ticks() advances between two calls.
MAX_STEP: Final = 3_600_000


class Clock:
    """The time of an agent and its parts.

    Attributes:
        monotonic: Returns seconds that never go backwards.
        time_ns: Returns nanoseconds since 1970, which may jump.
        thread_time: Returns the seconds of CPU that the calling thread has used.
        process_time: Returns the seconds of CPU that all threads have used.

    Args:
        monotonic: By default :func:`time.monotonic`.
        time_ns: By default :func:`time.time_ns`.
    """

    def __init__(
        self,
        monotonic: Callable[[], float] | None = None,
        time_ns: Callable[[], int] | None = None,
    ) -> None:
        self.monotonic = monotonic or time.monotonic
        self.time_ns = time_ns or time.time_ns
        self.thread_time = time.thread_time
        self.process_time = time.process_time
        self._last = int(self.monotonic() * 1000)
        self._skipped = 0  # milliseconds that ticks() has not counted

    def ticks(self) -> int:
        """Return milliseconds modulo 2^30, at most :data:`MAX_STEP` after the call before."""
        now = int(self.monotonic() * 1000)
        step = now - self._last
        self._last = now
        if step > MAX_STEP:
            self._skipped += step - MAX_STEP
        elif step < 0:  # a monotonic clock never does that, but some systems' do
            self._skipped += step
        return (now - self._skipped) & TIME_MASK

    def wall_clock(self) -> tuple[int, int]:
        """Return seconds and nanoseconds since 1970, within the range of a TIMESTAMP submessage."""
        return divmod(min(max(0, self.time_ns()), _LAST_SECOND * 1_000_000_000), 1_000_000_000)
