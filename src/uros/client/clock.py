"""A board's ticks, and the time since 1970 that it learns from its agent."""

from ..ticks import TIME_MASK, sleep_ms, ticks_ms, ticks_us

try:
    from typing import Any, Final
except ImportError:  # MicroPython
    pass

# A correction beyond this is made at once, backwards too: the agent's own clock was set.
STEP_US: Final = 1000000


class Clock:
    """Ticks, and epoch time of which every part stays a small integer on a board: ``high`` and
    ``low``, 16 bits each, are its seconds.

    Until :meth:`set` epoch time counts from when the clock was made. It must be asked for at
    least every eight minutes, as a spinning node does: the ticks wrap. Small corrections
    backwards are made by going at half speed, so that stamps never jump back.
    """

    def __init__(self) -> None:
        self.synchronized = False
        self.high = self.low = 0
        self._last = self.us()
        self._us = 0
        self._ahead = 0  # microseconds that time is still too late by being early

    # Milliseconds and microseconds modulo 2^30; doing nothing for so many milliseconds.
    ms = staticmethod(ticks_ms)
    us = staticmethod(ticks_us)
    sleep = staticmethod(sleep_ms)

    @property
    def seconds(self) -> int:
        """Since 1970, once :attr:`synchronized`; as of the last time it was asked for."""
        return self.high << 16 | self.low

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
            low = self.low + us // 1000000
            us %= 1000000
            self.high = (self.high + (low >> 16)) & 0x7FFF
            self.low = low & 0xFFFF
        self._us = us

    def now(self) -> "tuple[int, int]":
        """Seconds since 1970 and nanoseconds, once :attr:`synchronized`."""
        self._update()
        return self.seconds, self._us * 1000

    def stamp(self, time: "Any") -> bool:
        """Write the time into a ``builtin_interfaces/Time``; allocates nothing.

        False: it is not :attr:`synchronized` yet, and nothing is written. A message that is
        stamped now and published later must then be left out.
        """
        if self.synchronized:
            self._update()
            time.high = self.high
            time.low = self.low
            time.nanosec = self._us * 1000
        return self.synchronized

    def set(self, seconds: int, nanoseconds: int) -> None:
        """This is the time now; the nanoseconds may be more than a second. ROS's seconds end in
        January 2038 and begin anew at 0 here, so that a clock which is wrong stops no publisher.
        """
        self._update()
        us = nanoseconds // 1000
        seconds += us // 1000000
        us %= 1000000
        behind = (seconds - self.seconds) * 1000000 + us - self._us
        if self.synchronized and -STEP_US < behind < 0:
            self._ahead = -behind
            return
        self._ahead = 0
        self.high = seconds >> 16 & 0x7FFF
        self.low = seconds & 0xFFFF
        self._us = us
        self.synchronized = True
