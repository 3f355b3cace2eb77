"""Tick counters, their arithmetic, and sleep: MicroPython's names on MicroPython and CPython.

All ticks of uros count modulo 2^30, milliseconds or microseconds. MicroPython's ports differ in
their own period, so readings are masked and `ticks_add` and `ticks_diff` are defined here.
"""

import sys
import time

try:
    from typing import Any, Final
except ImportError:  # MicroPython
    pass

TIME_MASK: Final = 0x3FFFFFFF
_time: "Any" = time


def ticks_add(now: int, delta: int) -> int:
    """``now + delta`` modulo 2^30."""
    return (now + delta) & TIME_MASK


def ticks_diff(a: int, b: int) -> int:
    """``a - b``, signed, for ticks less than 2^29 apart (6 days in milliseconds)."""
    return ((a - b + 0x20000000) & TIME_MASK) - 0x20000000


if sys.implementation.name == "micropython":

    def ticks_ms() -> int:
        """Milliseconds modulo 2^30."""
        ms: int = _time.ticks_ms() & TIME_MASK
        return ms

    def ticks_us() -> int:
        """Microseconds modulo 2^30."""
        us: int = _time.ticks_us() & TIME_MASK
        return us

    sleep_ms = _time.sleep_ms
else:

    def ticks_ms() -> int:
        """Milliseconds modulo 2^30."""
        ms: int = _time.monotonic_ns() // 1000000 & TIME_MASK
        return ms

    def ticks_us() -> int:
        """Microseconds modulo 2^30."""
        us: int = _time.monotonic_ns() // 1000 & TIME_MASK
        return us

    def sleep_ms(ms: int) -> None:
        """Sleep for ``ms`` milliseconds."""
        _time.sleep(ms / 1000)
