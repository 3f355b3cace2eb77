"""A board's ticks, and the time since 1970 that it learns from its agent."""

from ..ticks import sleep_ms, ticks_ms, ticks_us
from ..wire.streams import TIME_MASK

try:
    from typing import Any, Final
except ImportError:  # MicroPython
    pass

# A correction beyond this is made at once, backwards too: the agent's own clock was set.
STEP_US: Final = 1000000


class Clock:
    """Ticks, and epoch time in two halves: seconds, and microseconds that stay small integers.

    Until :meth:`set` epoch time counts from when the clock was made. It must be asked for at
    least every eight minutes, as a spinning node does: the ticks wrap. Small corrections
    backwards are made by going at half speed, so that stamps never jump back.
    """

    def __init__(self) -> None:
        self.synchronized = False
        self.seconds = 0
        self._last = self.us()
        self._us = 0
        self._ahead = 0  # microseconds that time is still too late by being early

    def ms(self) -> int:
        """Milliseconds modulo 2^30."""
        return ticks_ms()

    def us(self) -> int:
        """Microseconds modulo 2^30."""
        return ticks_us()

    def sleep(self, ms: int) -> None:
        """Do nothing for so long."""
        sleep_ms(ms)

    def _update(self) -> None:
        now = self.us()
        passed = (now - self._last) & TIME_MASK
        self._last = now
        if self._ahead:
            held = min(self._ahead, passed >> 1)
            self._ahead -= held
            passed -= held
        us = self._us + passed
        if us >= 1000000:
            self.seconds += us // 1000000
            us %= 1000000
        self._us = us

    def now(self) -> "tuple[int, int]":
        """Seconds since 1970 and nanoseconds, once :attr:`synchronized`."""
        self._update()
        return self.seconds, self._us * 1000

    def stamp(self, time: "Any") -> None:
        """Write the time into a ``builtin_interfaces/Time``."""
        self._update()
        time.sec = self.seconds
        time.nanosec = self._us * 1000

    def set(self, seconds: int, nanoseconds: int) -> None:
        """This is the time now; the nanoseconds may be more than a second."""
        self._update()
        us = nanoseconds // 1000
        seconds += us // 1000000
        us %= 1000000
        behind = (seconds - self.seconds) * 1000000 + us - self._us
        if self.synchronized and -STEP_US < behind < 0:
            self._ahead = -behind
            return
        self._ahead = 0
        self.seconds = seconds
        self._us = us
        self.synchronized = True

