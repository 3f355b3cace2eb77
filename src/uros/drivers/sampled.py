"""What drivers of sensors have in common that measure by themselves and say when it is new."""

from . import SensorError

try:
    from typing import Any, Final
except ImportError:
    pass

# Reads in a row without a new sample, or with the same one: the sensor has stopped.
_PATIENCE: Final = 8


def word(buf: bytearray, high: int, low: int) -> int:
    """The signed number of 16 bits in these two bytes."""
    raw = buf[high] << 8 | buf[low]
    return raw - 65536 if raw & 0x8000 else raw


class Sampled:
    """The sensor is set up by the first `start` or `read` that reaches it, and again after every
    error: one that was plugged in late, lost its supply or was swapped comes back with its
    settings. Reading makes no buffers anew.

    Subclasses have `set_up` and `take`; the status is the first of the ``size`` bytes from
    ``status`` on, and ``new`` the bit in it.
    """

    def __init__(
        self, i2c: "Any", address: int, status: int, new: int, size: int, discarded: int = 0
    ) -> None:
        self._i2c = i2c
        self._address = address
        self._status = bytes((status,))
        self._new = new
        self._discarded = discarded  # samples after it was set up that are not to be believed
        self._one = bytearray(1)
        self._buf = bytearray(size)
        self._last = bytearray(size)
        self._is_set_up = False
        self._left = 0
        self._missed = 0  # reads without anything new
        self._same = 0  # samples that were like the one before

    def start(self) -> None:
        """Make it measure, unless it does; `read` from ``wait_ms`` on."""
        if not self._is_set_up:
            self.set_up()
            self._is_set_up = True
            self._left = self._discarded
            self._missed = 0

    def read(self) -> bool:
        """Take the newest sample; False: there is none that is new, ask again."""
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
        # There is noise in every sample: one that is like the last, to the bit, is none. Settings
        # do not mend that, so it counts on until one differs.
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
        """Store what a sample says. Raises SensorError where it cannot be."""

    def identify(self, register: bytes, wanted: int, name: str) -> None:
        self.get(register, self._one)
        if self._one[0] != wanted:
            raise SensorError("id 0x%02x is not %s's" % (self._one[0], name))

    def put(self, *data: int) -> None:
        self._i2c.writeto(self._address, bytes(data))

    def get(self, register: bytes, buf: bytearray) -> None:
        self._i2c.writeto(self._address, register)
        self._i2c.readfrom_into(self._address, buf)
