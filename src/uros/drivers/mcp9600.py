"""Microchip MCP9600: temperatures of a thermocouple's two junctions, measured continuously.

The type of the thermocouple stays at the default, K.
"""

from . import SensorError

try:
    from typing import Any, Final
except ImportError:
    pass

_HOT: Final = b"\x00"
_COLD: Final = b"\x02"
_STATUS: Final = b"\x04"
_OUT_OF_RANGE: Final = 0x10


class MCP9600:
    """Thermocouple converter; temperatures are in °C, in steps of 0.0625."""

    def __init__(self, i2c: "Any", address: int = 0x67) -> None:
        self._i2c = i2c
        self._address = address
        self._buf = bytearray(2)
        self._status = bytearray(1)

    def read_hot(self) -> float:
        """Return the temperature at the thermocouple's tip, compensated by the sensor."""
        celsius = self._read(_HOT)
        # Read after the temperature, to reject a fault that arose in between, too.
        self._get(_STATUS, self._status)
        if self._status[0] & _OUT_OF_RANGE or not -200 <= celsius <= 1372:
            raise SensorError("the thermocouple is out of range, or broken")
        return celsius

    def read_cold(self) -> float:
        """Return the temperature at the sensor, where the thermocouple's wires end."""
        celsius = self._read(_COLD)
        if not -40 <= celsius <= 125:
            raise SensorError("cold junction: %.1f C is out of range" % celsius)
        return celsius

    def _read(self, register: bytes) -> float:
        buf = self._buf
        self._get(register, buf)
        raw = buf[0] << 8 | buf[1]
        return (raw - 65536 if raw & 0x8000 else raw) * 0.0625

    def _get(self, register: bytes, buf: bytearray) -> None:
        self._i2c.writeto(self._address, register)
        self._i2c.readfrom_into(self._address, buf)
