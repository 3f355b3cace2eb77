"""Ends a wait at a deadline, without a timer for each wait.

A poll with a timeout has the kernel set a timer and take it back, which costs a tenth of a turn
with one message. A deadline stays the same for many turns: a timerfd is set to it once.
"""

from __future__ import annotations

import math
import os
from collections.abc import Callable
from typing import Any, Final

_CLOCK_MONOTONIC: Final = 1
# The most seconds that the timer is set to: a farther deadline is looked at again then.
_FARTHEST: Final = 86_400.0


class DeadlineTimer:
    """A descriptor that is readable from a deadline on, where the system has timerfds.

    Attributes:
        fd: The descriptor; -1 without one.
        at: The deadline that it is set to, in seconds of the clock; infinity: none.

    Args:
        monotonic: The clock.
    """

    def __init__(self, monotonic: Callable[[], float]) -> None:
        self.at = math.inf
        self._monotonic = monotonic
        self.fd, self._set = _create()

    def wait_until(self, deadline: float) -> float | None:
        """Set the timer; return the timeout for the next poll, None where the timer ends it."""
        left = deadline - self._monotonic()
        if left <= 0:
            return 0.0
        if self.fd < 0 or not self._set(min(left, _FARTHEST)):
            return left
        self.at = deadline
        return None

    def clear(self) -> None:
        """Make the descriptor unreadable until the next deadline."""
        try:
            os.read(self.fd, 8)
        except BlockingIOError:
            pass
        self.at = math.inf

    def close(self) -> None:
        """Close the descriptor; idempotent."""
        if self.fd >= 0:
            os.close(self.fd)
            self.fd = -1


def _create() -> tuple[int, Callable[[float], bool]]:
    """Return a timerfd, -1 where there is none, and what sets it to so many seconds from now."""
    try:
        import ctypes

        library: Any = ctypes.CDLL(None)
        create, settime = library.timerfd_create, library.timerfd_settime
    except (ImportError, OSError, AttributeError, TypeError):  # macOS, Windows
        return -1, lambda seconds: False
    fd = create(_CLOCK_MONOTONIC, os.O_NONBLOCK | os.O_CLOEXEC)
    when = (ctypes.c_long * 4)()  # period and first time, each in seconds and nanoseconds

    def set_to(seconds: float) -> bool:
        whole = int(seconds)
        when[2] = whole
        when[3] = max(1, int((seconds - whole) * 1e9))  # 0 and 0 would stop it
        return bool(settime(fd, 0, when, None) == 0)

    return fd, set_to
