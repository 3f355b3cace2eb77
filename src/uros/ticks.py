"""The platform's ticks and sleep, with MicroPython's names, on MicroPython and on CPython.

Ticks count modulo 2^30, as everywhere in uros.
"""

import sys
import time

try:
    from typing import Any, Final
except ImportError:  # MicroPython
    pass

_MASK: Final = 0x3FFFFFFF
_time: "Any" = time

if sys.implementation.name == "micropython":

    def ticks_ms() -> int:
        ms: int = _time.ticks_ms() & _MASK
        return ms

    def ticks_us() -> int:
        us: int = _time.ticks_us() & _MASK
        return us

    sleep_ms = _time.sleep_ms
else:

    def ticks_ms() -> int:
        """Milliseconds modulo 2^30."""
        ms: int = _time.monotonic_ns() // 1000000 & _MASK
        return ms

    def ticks_us() -> int:
        """Microseconds modulo 2^30."""
        us: int = _time.monotonic_ns() // 1000 & _MASK
        return us

    def sleep_ms(ms: int) -> None:
        """Do nothing for so long."""
        _time.sleep(ms / 1000)
