"""Vishay VCNL4010: proximity and ambient light.

Both are measured on demand. Register numbers are those of the datasheet (rev. 1.5).
"""

from . import SensorError

try:
    from typing import Any, Final
except ImportError:
    pass

LUX_PER_COUNT: Final = 0.25

_COMMAND: Final = b"\x80"
_RESULTS: Final = b"\x85"
_PRODUCT: Final = b"\x81"
_START: Final = b"\x80\x18"  # one ambient light and one proximity measurement
_READY: Final = 0x60  # both are done: bits of the command register
_LED_CURRENT: Final = 20  # times 10 mA; the default is 20 mA
_AMBIENT: Final = 0x9D  # continuous conversion, 2 samples a second, offset compensated, 32 averaged


class VCNL4010:
    """Sensor whose counts are of the last good read.

    ``proximity`` is larger for nearer objects; ``ambient`` times `LUX_PER_COUNT` is in lux.

    The sensor is set up by the first `start` that reaches it, and again after every error: one that
    was plugged in late, lost its supply or was replaced gets its settings again.
    """

    wait_ms = 100

    def __init__(self, i2c: "Any", address: int = 0x13) -> None:
        self.proximity = 0
        self.ambient = 0
        self._i2c = i2c
        self._address = address
        self._is_set_up = False
        self._byte = bytearray(1)
        self._settings = bytearray(5)  # 0x80 to 0x84
        self._counts = bytearray(4)  # 0x85 to 0x88

    def start(self) -> None:
        """Begin both measurements; `read` them after ``wait_ms``."""
        if not self._is_set_up:
            self._set_up()
        self._is_set_up = False  # unless the transfer succeeds
        self._i2c.writeto(self._address, _START)
        self._is_set_up = True

    def read(self) -> bool:
        """Take the measurements that `start` began. False: not ready yet, call it again."""
        settings, counts = self._settings, self._counts
        was_set_up, self._is_set_up = self._is_set_up, False
        self._get(_COMMAND, settings)
        # The upper two bits at 0x83 are read-only.
        if not was_set_up or settings[3] & 0x3F != _LED_CURRENT or settings[4] != _AMBIENT:
            raise SensorError("it has lost its settings")
        if settings[0] & _READY != _READY:
            self._is_set_up = True
            return False
        self._get(_RESULTS, counts)
        self._is_set_up = True
        self.ambient = counts[0] << 8 | counts[1]
        self.proximity = counts[2] << 8 | counts[3]
        return True

    def _set_up(self) -> None:
        self._get(_PRODUCT, self._byte)
        if self._byte[0] >> 4 != 2:
            raise SensorError("product id 0x%02x is not a VCNL4010's" % self._byte[0])
        self._i2c.writeto(self._address, bytes((0x83, _LED_CURRENT)))
        self._i2c.writeto(self._address, bytes((0x84, _AMBIENT)))

    def _get(self, register: bytes, buf: bytearray) -> None:
        self._i2c.writeto(self._address, register)
        self._i2c.readfrom_into(self._address, buf)
