"""Maxim MAX17048: voltage and state of charge of a lithium cell, measured continuously."""

from . import SensorError
from .sampled import word

try:
    from typing import Any, Final
except ImportError:
    pass

_VCELL: Final = b"\x02"  # followed by the state of charge
_VERSION: Final = b"\x08"
_CRATE: Final = b"\x16"
_VOLTS: Final = 78.125e-6
_EMPTY: Final = 2.0  # V: no cell has less
_FULL: Final = 5.0


class MAX17048:
    """Fuel gauge; its values are of the last good read.

    ``volts`` is the cell's voltage, ``fraction`` its state of charge from 0.0 to 1.0, ``rate`` the
    change of that fraction per hour (negative: discharging).
    """

    wait_ms = 10

    def __init__(self, i2c: "Any", address: int = 0x36) -> None:
        self.volts = 0.0
        self.fraction = 0.0
        self.rate = 0.0
        self._i2c = i2c
        self._address = address
        self._two = bytearray(2)
        self._four = bytearray(4)
        self._is_known = False

    def start(self) -> None:
        """Check the identity, the first time and after every error."""
        if self._is_known:
            return
        self._get(_VERSION, self._two)
        if self._two[0] != 0 or self._two[1] & 0xF0 != 0x10:
            raise SensorError(
                "version 0x%02x%02x is not a MAX17048's" % (self._two[0], self._two[1])
            )
        self._is_known = True

    def read(self) -> None:
        """Read the newest values, which are less than 0.25 s old."""
        self.start()
        self._is_known = False  # unless all goes well
        four = self._four
        self._get(_VCELL, four)
        volts = (four[0] << 8 | four[1]) * _VOLTS
        if not _EMPTY <= volts <= _FULL:
            raise SensorError("%.2f V is no cell's" % volts)
        self._get(_CRATE, self._two)
        self.volts = volts
        self.fraction = min((four[2] << 8 | four[3]) / 25600, 1.0)  # it may report a little more
        self.rate = word(self._two, 0, 1) * 0.00208
        self._is_known = True

    def _get(self, register: bytes, buf: bytearray) -> None:
        self._i2c.writeto(self._address, register)
        self._i2c.readfrom_into(self._address, buf)
