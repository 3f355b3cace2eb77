"""Base class of sensors that measure continuously and flag new samples."""

from . import SensorError

try:
    from typing import Any, Final
except ImportError:
    pass

# Reads in a row without a new sample, or with the same one: the sensor has stopped.
_PATIENCE: Final = 8


def word(buf: bytearray, high: int, low: int) -> int:
    """Return the signed 16-bit number in the bytes at these two indices."""
    raw = buf[high] << 8 | buf[low]
    return raw - 65536 if raw & 0x8000 else raw


class Sampled:
    """A sensor with a status register followed by its samples. Reading allocates no buffers.

    The sensor is set up by the first `start` or `read` that reaches it, and again after every
    error: one that was plugged in late, lost its supply or was replaced gets its settings again.

    Subclasses define `set_up` and `take`.

    Args:
        i2c: The bus.
        address: The sensor's address.
        status: The status register, the first of the registers to be read.
        new: Its bit that flags a new sample.
        size: Bytes to be read: the status and a sample.
        discarded: Number of samples to be dropped after each setup.
    """

    def __init__(
        self, i2c: "Any", address: int, status: int, new: int, size: int, discarded: int = 0
    ) -> None:
        self._i2c = i2c
        self._address = address
        self._status = bytes((status,))
        self._new = new
        self._discarded = discarded  # invalid samples after each setup
        self._byte = bytearray(1)
        self._buf = bytearray(size)
        self._last = bytearray(size)
        self._is_set_up = False
        self._left = 0
        self._missed = 0  # reads in a row without a new sample
        self._same = 0  # samples in a row that equal the one before

    def start(self) -> None:
        """Set the sensor up if necessary; `read` it after ``wait_ms``."""
        if not self._is_set_up:
            self.set_up()
            self._is_set_up = True
            self._left = self._discarded
            self._missed = 0

    def read(self) -> bool:
        """Read the newest sample. False: there is no new one yet, call it again."""
        self.start()
        self._is_set_up = False  # unless all goes well
        buf = self._buf
        self.get(self._status, buf)
        if not buf[0] & self._new:
            self._missed += 1
            if self._missed >= _PATIENCE:
                raise SensorError("it gives no new values")
            self._is_set_up = True
            return False
        self._missed = 0
        buf[0] = 0
        # Every sample has noise: identical ones mean that the sensor has stopped. A new setup does
        # not cure that, so the count is kept until a sample differs.
        self._same = self._same + 1 if buf == self._last else 0
        if self._same >= _PATIENCE:
            raise SensorError("it gives the same values again and again")
        self._buf, self._last = self._last, buf
        if self._left:
            self._left -= 1
            self._is_set_up = True
            return False
        self.take(buf)
        self._is_set_up = True
        return True

    def set_up(self) -> None:
        """Write the settings."""

    def take(self, buf: bytearray) -> None:
        """Store a sample. Raises SensorError if it is out of range."""

    def identify(self, register: bytes, wanted: int, name: str) -> None:
        """Compare the id in a register; ``name`` is for the error. Raises SensorError."""
        self.get(register, self._byte)
        if self._byte[0] != wanted:
            raise SensorError("id 0x%02x is not %s's" % (self._byte[0], name))

    def put(self, *data: int) -> None:
        """Write bytes: a register and its values."""
        self._i2c.writeto(self._address, bytes(data))

    def get(self, register: bytes, buf: bytearray) -> None:
        """Fill ``buf`` from a register on."""
        self._i2c.writeto(self._address, register)
        self._i2c.readfrom_into(self._address, buf)
