"""The time of a virtual board.

A board has a crystal with a frequency error, and a real-time clock that was never set. Its
environment, its sensors and the host use true time. One object gives all of these, so that a test
moves one clock (:class:`ManualClock`) and never sleeps.
"""

from __future__ import annotations

import math
import select
import sys
import threading
import time
from collections.abc import Callable, Iterable
from typing import Final

# 2000-01-01T00:00:00Z, in nanoseconds since 1970: the start of a clock that was never set.
RTC_START_NS: Final = 946_684_800 * 10**9
_BILLION: Final = 10**9


class BoardClock:
    """The clocks of one board; power-on is when this object is made.

    Args:
        drift_ppm: How much too fast the crystal runs, in parts per million.
        host_ns: The host's monotonic clock, in nanoseconds.
        host_sleep: Sleeps on the host, in seconds.
        speed: How many times faster than the host's the time of the board and its environment goes.
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
        self._holding = threading.local()  # each core of a board handles its own interrupts
        self._rate = _BILLION + round(drift_ppm * 1000)
        self._power_on = host_ns()
        self._restarted = 0
        self._rtc_offset = RTC_START_NS

    def host_ns(self) -> int:
        """Return the host's monotonic clock, in nanoseconds."""
        return self._host_ns()

    def world_us(self) -> int:
        """Return the true microseconds since power-on; a reset of the board does not change it."""
        return self._world_ns() // 1000

    def hold(self, world_us: int | None) -> None:
        """Hold the true time at a moment, for the calling thread; None releases it.

        A program that handles an interrupt late thus sees the time at which the interrupt was due.
        """
        self._holding.ns = None if world_us is None else world_us * 1000

    @property
    def held(self) -> bool:
        """Whether :meth:`hold` holds the time for this thread."""
        return getattr(self._holding, "ns", None) is not None

    def host_seconds(self, us: int) -> float:
        """Convert true microseconds to seconds of the host."""
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
        """Return the microseconds of the board's crystal since power-on or :meth:`restart`.

        The count never wraps; the engine wraps it as its port of MicroPython does.
        """
        return (self._board_ns() - self._restarted) // 1000

    def ticks_formula(self) -> tuple[int, int, float, int] | None:
        """Return what another process of this host needs to compute the ticks itself.

        It is (P, R, S, N): the ticks in nanoseconds are (CLOCK_MONOTONIC - P) * S * N // 10**9 - R.
        The result is valid until :meth:`restart`, and while the time is not held. None: the clock
        is not that of the host.
        """
        if self._host_ns is not time.monotonic_ns or sys.platform != "linux":
            return None
        return self._power_on, self._restarted, self._speed, self._rate

    def restart(self) -> None:
        """Reset the board's ticks to 0; the real-time clock continues."""
        self._restarted = self._board_ns()

    def epoch_ns(self) -> int:
        """Return the time of the real-time clock, in nanoseconds since 1970."""
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
        """Wait for ``ns`` nanoseconds of the host's clock."""
        if ns > 0:
            self._host_sleep(ns / 1e9)

    def select(self, fds: Iterable[int], seconds: float | None) -> list[int]:
        """Return the descriptors that are readable.

        Waits for one for at most ``seconds`` of true time; None: without a limit.
        """
        poll = select.poll()
        for fd in fds:
            poll.register(fd, select.POLLIN)
        return [fd for fd, _ in poll.poll(None if seconds is None else seconds * 1000)]


class ManualClock(BoardClock):
    """A clock that only :meth:`advance` and waits move; a wait on it returns at once."""

    def __init__(self, drift_ppm: float = 0.0, start_ns: int = 0) -> None:
        self._now = start_ns
        super().__init__(drift_ppm, lambda: self._now, self._sleep)

    def _sleep(self, seconds: float) -> None:
        # Rounded up, so that the board's microseconds have passed, without float rounding errors.
        self._now += math.ceil(round(seconds * 1e9, 3))

    def advance(self, us: int) -> None:
        """Advance the clock by ``us`` true microseconds."""
        self._now += us * 1000

    def select(self, fds: Iterable[int], seconds: float | None) -> list[int]:
        """Return the descriptors that are readable now; if there are none, advance by ``seconds``.

        Raises:
            RuntimeError: Nothing is readable and ``seconds`` is None; such a wait would never end.
        """
        ready = super().select(fds, 0)
        if not ready:
            if seconds is None:
                raise RuntimeError("a wait without an end on a clock that is moved by hand")
            self._sleep(seconds)
        return ready
