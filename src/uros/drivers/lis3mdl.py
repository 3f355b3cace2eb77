"""ST LIS3MDL: magnetic field, measured continuously at 20 Hz, up to 4 gauss.

Register numbers are those of the datasheet (rev. 6).
"""

from . import SensorError
from .sampled import Sampled, word

try:
    from typing import Any, Final
except ImportError:
    pass

_ON: Final = 0x80  # auto-increment: a transfer continues with the next registers
_WHO_AM_I: Final = b"\x0f"
_CONTROL: Final = 0x20
_STATUS: Final = 0x27  # before the six bytes of a sample
_NEW: Final = 0x08
_RATE: Final = 0x74  # 20 a second, x and y in the best mode
_RANGE: Final = 0x00
_CONTINUOUS: Final = 0x00
_Z: Final = 0x0C  # in the best mode
_WHOLE: Final = 0x40  # block data update: no output changes while it is read
_PER_COUNT: Final = 1e-4 / 6842  # tesla
_END: Final = 4 * 6842


class LIS3MDL(Sampled):
    """Magnetometer; ``x``, ``y`` and ``z`` are in tesla, of the last good read."""

    wait_ms = 50

    def __init__(self, i2c: "Any", address: int = 0x1C) -> None:
        super().__init__(i2c, address, _STATUS | _ON, _NEW, 7)
        self.x = self.y = self.z = 0.0

    def set_up(self) -> None:
        """Check the identity and write the settings."""
        self.identify(_WHO_AM_I, 0x3D, "a LIS3MDL")
        self.put(_CONTROL | _ON, _RATE, _RANGE, _CONTINUOUS, _Z, _WHOLE)

    def take(self, buf: bytearray) -> None:
        """Store a sample. Raises SensorError if the field is out of range."""
        x, y, z = word(buf, 2, 1), word(buf, 4, 3), word(buf, 6, 5)
        if abs(x) > _END or abs(y) > _END or abs(z) > _END:
            raise SensorError("the field is out of range")
        self.x = x * _PER_COUNT
        self.y = y * _PER_COUNT
        self.z = z * _PER_COUNT
