"""ROHM BH1750: illuminance, by single measurements.

The measurement time is the shortest, so that the range includes sunlight.
"""

from . import SensorError

try:
    from typing import Any, Final
except ImportError:
    pass

# Set the measurement time to 31 (default 69), in two commands; then start one measurement at high
# resolution. All three are sent each time, for a sensor that was replaced.
_TIME_HIGH: Final = b"\x40"
_TIME_LOW: Final = b"\x7f"
_MEASURE: Final = b"\x20"
_LUX: Final = 69 / 31 / 1.2  # per count


class BH1750:
    """Light sensor; ``lux`` is of the last good read, in steps of 1.85 up to 121 000."""

    wait_ms = 90

    def __init__(self, i2c: "Any", address: int = 0x23) -> None:
        self.lux = 0.0
        self._i2c = i2c
        self._address = address
        self._buf = bytearray(2)

    def start(self) -> None:
        """Begin a measurement; `read` it after ``wait_ms``."""
        self._i2c.writeto(self._address, _TIME_HIGH)
        self._i2c.writeto(self._address, _TIME_LOW)
        self._i2c.writeto(self._address, _MEASURE)

    def read(self) -> None:
        """Take the measurement that `start` began."""
        buf = self._buf
        self._i2c.readfrom_into(self._address, buf)
        counts = buf[0] << 8 | buf[1]
        if counts == 0xFFFF:
            raise SensorError("the light is out of range")
        self.lux = counts * _LUX
