"""Clock of a board: ticks, and epoch time synchronized with the agent."""

from ..ticks import TIME_MASK, sleep_ms, ticks_ms, ticks_us

try:
    from typing import Any, Final
except ImportError:  # MicroPython
    pass

# A correction beyond this is made at once, also backwards, because the agent's own clock was set.
STEP_US: Final = 1000000


class Clock:
    """Ticks and epoch time.

    The seconds are kept as ``high`` and ``low``, 16 bits each, so that every part is a small
    integer on a board. Until :meth:`set` is called, epoch time counts from the creation of the
    clock. The time must be read at least every eight minutes, as a spinning node does, because the
    ticks wrap. Small corrections backwards are made by running at half speed, so that stamps never
    go back.
    """

    def __init__(self) -> None:
        self.synchronized = False
        self.high = self.low = 0
        self._last = self.us()
        self._us = 0
        self._ahead = 0  # microseconds by which the time is ahead, removed by running slower

    # Ticks in milliseconds and in microseconds, modulo 2^30; sleep for some milliseconds.
    ms = staticmethod(ticks_ms)
    us = staticmethod(ticks_us)
    sleep = staticmethod(sleep_ms)

    @property
    def seconds(self) -> int:
        """Seconds since 1970, if :attr:`synchronized`, as of the last time it was read."""
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
        """Return seconds since 1970, if :attr:`synchronized`, and nanoseconds."""
        self._update()
        return self.seconds, self._us * 1000

    def stamp(self, time: "Any") -> bool:
        """Write the time into a ``builtin_interfaces/Time``, without allocating.

        Returns:
            False if the clock is not :attr:`synchronized` yet; then nothing is written, and the
            program must not publish the message.
        """
        if self.synchronized:
            self._update()
            time.high = self.high
            time.low = self.low
            time.nanosec = self._us * 1000
        return self.synchronized

    def set(self, seconds: int, nanoseconds: int) -> None:
        """Set the time; the nanoseconds may be more than a second.

        ROS's seconds end in January 2038; then they restart at 0 here, so that a wrong clock does
        not stop a publisher.
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
