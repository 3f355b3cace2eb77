"""Sensirion SHT30, SHT31, SHT35: temperature and relative humidity.

It makes single measurements of high repeatability, which take up to 15.5 ms (datasheet, 2.2).
"""

from . import SensorError

try:
    from typing import Any, Final
except ImportError:
    pass

# With clock stretching: a read that comes too early is delayed, not refused.
_MEASURE: Final = b"\x2c\x06"


def crc8(buf: "bytes | bytearray", start: int, end: int) -> int:
    """Return the CRC of ``buf[start:end]``: polynomial 0x31, start value 0xFF (datasheet, 4.12)."""
    crc = 0xFF
    while start < end:
        crc ^= buf[start]
        start += 1
        bits = 8
        while bits:
            crc = crc << 1 ^ 0x131 if crc & 0x80 else crc << 1
            bits -= 1
    return crc


class SHT3x:
    """Sensor; ``temperature`` (°C) and ``humidity`` (0.0 to 1.0) are of the last good read."""

    wait_ms = 20

    def __init__(self, i2c: "Any", address: int = 0x44) -> None:
        self.temperature = 0.0
        self.humidity = 0.0
        self._i2c = i2c
        self._address = address
        self._buf = bytearray(6)

    def start(self) -> None:
        """Begin a measurement; `read` it after ``wait_ms``."""
        self._i2c.writeto(self._address, _MEASURE)

    def read(self) -> None:
        """Take the measurement that `start` began."""
        buf = self._buf
        self._i2c.readfrom_into(self._address, buf)
        if crc8(buf, 0, 2) != buf[2]:
            raise SensorError("wrong CRC of the temperature")
        if crc8(buf, 3, 5) != buf[5]:
            raise SensorError("wrong CRC of the humidity")
        temperature = (buf[0] << 8 | buf[1]) * 175 / 65535 - 45
        if not -40 <= temperature <= 125:
            raise SensorError("%.1f C is out of range" % temperature)
        self.temperature = temperature
        self.humidity = (buf[3] << 8 | buf[4]) / 65535
