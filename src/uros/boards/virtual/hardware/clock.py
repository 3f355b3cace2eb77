"""The time of a virtual board.

A board has a crystal of its own, which is not quite right, and a real-time clock that nobody has
set. The world around it, its sensors and the host, go by true time. All of it comes from one
object, so that a test moves one clock (:class:`ManualClock`) and nothing ever sleeps.
"""

from __future__ import annotations

import math
import select
import threading
import time
from collections.abc import Callable, Iterable
from typing import Final

# 2000-01-01T00:00:00Z, in nanoseconds since 1970: where a clock begins that was never set.
RTC_START_NS: Final = 946_684_800 * 10**9
_BILLION: Final = 10**9


class BoardClock:
    """The clocks of one board from its power-on, which is when this is made.

    ``drift_ppm``: how much too fast the crystal runs. ``speed`` is how many times faster than the
    host's the time of the board and its world goes. ``host_ns`` and ``host_sleep`` (seconds) are
    the host's own time.
    """

    def __init__(
        self,
        drift_ppm: float = 50.0,
        host_ns: Callable[[], int] = time.monotonic_ns,
        host_sleep: Callable[[float], None] = time.sleep,
        speed: float = 1.0,
    ) -> None:
        self._host_ns = host_ns
        self._host_sleep = host_sleep
        self._speed = speed
        self._holding = threading.local()  # each core of a board carries out its own interrupts
        self._rate = _BILLION + round(drift_ppm * 1000)
        self._power_on = host_ns()
        self._restarted = 0
        self._rtc_offset = RTC_START_NS

    def host_ns(self) -> int:
        """The host's monotonic clock, in nanoseconds."""
        return self._host_ns()

    def world_us(self) -> int:
        """True microseconds since power-on. A reset of the board does not touch it."""
        return self._world_ns() // 1000

    def hold(self, world_us: int | None) -> None:
        """It is this moment of the world until told otherwise, for this thread: what a program
        sees in an interrupt that is carried out later than it was due. None: time goes on.
        """
        self._holding.ns = None if world_us is None else world_us * 1000

    @property
    def held(self) -> bool:
        """Whether :meth:`hold` holds it."""
        return getattr(self._holding, "ns", None) is not None

    def host_seconds(self, us: int) -> float:
        """How long the host waits for so many true microseconds."""
        return us / 1e6 / self._speed

    def _world_ns(self) -> int:
        held: int | None = getattr(self._holding, "ns", None)
        if held is not None:
            return held
        since = self._host_ns() - self._power_on
        return since if self._speed == 1.0 else int(since * self._speed)

    def _board_ns(self) -> int:
        return self._world_ns() * self._rate // _BILLION

    def ticks_us(self) -> int:
        """Microseconds since power-on or :meth:`restart`, as the board's crystal counts them.
        Never wraps; what a port of MicroPython makes of it is the engine's matter.
        """
        return (self._board_ns() - self._restarted) // 1000

    def restart(self) -> None:
        """The board was reset: ticks begin at 0 again, the real-time clock goes on."""
        self._restarted = self._board_ns()

    def epoch_ns(self) -> int:
        """What the real-time clock says, in nanoseconds since 1970."""
        return self._rtc_offset + self._board_ns()

    def set_epoch_ns(self, ns: int) -> None:
        """Set the real-time clock."""
        self._rtc_offset = ns - self._board_ns()

    def sleep_us(self, us: int) -> None:
        """Wait until the board's crystal has counted ``us`` microseconds."""
        if us > 0:
            self._host_sleep(us * 1000 / self._rate / self._speed)

    def sleep_world_us(self, us: int) -> None:
        """Wait for ``us`` true microseconds."""
        if us > 0:
            self._host_sleep(self.host_seconds(us))

    def sleep_host_ns(self, ns: int) -> None:
        """Wait for so long by the host's clock."""
        if ns > 0:
            self._host_sleep(ns / 1e9)

    def select(self, fds: Iterable[int], seconds: float | None) -> list[int]:
        """The descriptors that can be read, waiting up to ``seconds`` (None: for ever) of true
        time for one.
        """
        poll = select.poll()
        for fd in fds:
            poll.register(fd, select.POLLIN)
        return [fd for fd, _ in poll.poll(None if seconds is None else seconds * 1000)]


class ManualClock(BoardClock):
    """A clock that moves when told: by :meth:`advance`, and by every wait on it, which then takes
    no time at all.
    """

    def __init__(self, drift_ppm: float = 0.0, start_ns: int = 0) -> None:
        self._now = start_ns
        super().__init__(drift_ppm, lambda: self._now, self._sleep)

    def _sleep(self, seconds: float) -> None:
        # Up, so that the board's microseconds are over; a float's last digit does not count.
        self._now += math.ceil(round(seconds * 1e9, 3))

    def advance(self, us: int) -> None:
        """``us`` true microseconds pass."""
        self._now += us * 1000

    def select(self, fds: Iterable[int], seconds: float | None) -> list[int]:
        """What can be read now; where nothing can, the time is over at once. Waiting for ever
        for nothing is an error (RuntimeError), because nothing would ever end it.
        """
        ready = super().select(fds, 0)
        if not ready:
            if seconds is None:
                raise RuntimeError("a wait without an end on a clock that is moved by hand")
            self._sleep(seconds)
        return ready
