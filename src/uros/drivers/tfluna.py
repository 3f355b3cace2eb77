"""Benewake TF-Luna: distance by time of flight, on I2C (pin 5 grounded before power-on).

It measures when triggered: in its continuous mode a number may change while it is read.
"""

from . import SensorError

try:
    from typing import Any, Final
except ImportError:
    pass

_RESULTS: Final = b"\x00"  # distance, strength, temperature, counter
_SIGNATURE: Final = b"\x3c"
_TRIGGERED: Final = b"\x23\x01"
_TRIGGER: Final = b"\x24\x01"
_NEAREST: Final = 20  # cm
_FARTHEST: Final = 800
_WEAK: Final = 100
_FOREIGN: Final = 32768  # and more: ambient light saturates it
_PATIENCE: Final = 5

MIN_RANGE: Final = 0.2
MAX_RANGE: Final = 8.0
FIELD_OF_VIEW: Final = 0.0349  # rad: 2 degrees
_INF: Final = float("inf")


class TFLuna:
    """Range finder; ``range`` (metres) and ``amplitude`` are of the last good read.

    By REP 117 ``range`` is plus infinity if nothing is within 8 m, and minus infinity if something
    is nearer than 0.2 m. ``amplitude`` is that of the reflected light.
    """

    wait_ms = 20

    def __init__(self, i2c: "Any", address: int = 0x10) -> None:
        self.range = _INF
        self.amplitude = 0
        self._i2c = i2c
        self._address = address
        self._buf = bytearray(8)
        self._name = bytearray(4)
        self._is_set_up = False
        self._counter = -1
        self._missed = 0

    def start(self) -> None:
        """Begin a measurement; `read` it after ``wait_ms``."""
        was_set_up, self._is_set_up = self._is_set_up, False
        if not was_set_up:
            self._get(_SIGNATURE, self._name)
            if self._name != b"LUNA":
                raise SensorError("it is no TF-Luna")
            self._i2c.writeto(self._address, _TRIGGERED)
            self._counter = -1
            self._missed = 0
            self._get(_RESULTS, self._buf)  # the counter of the measurement before
            self._counter = self._buf[6] | self._buf[7] << 8
        self._i2c.writeto(self._address, _TRIGGER)
        self._is_set_up = True

    def read(self) -> bool:
        """Take the measurement that `start` began. False: not ready yet, call it again."""
        was_set_up, self._is_set_up = self._is_set_up, False
        buf = self._buf
        self._get(_RESULTS, buf)
        counter = buf[6] | buf[7] << 8
        if counter == self._counter:
            self._missed += 1
            if self._missed >= _PATIENCE:
                raise SensorError("the measurement does not end")
            self._is_set_up = was_set_up
            return False
        self._counter = counter
        self._missed = 0
        self._is_set_up = was_set_up
        amplitude = buf[2] | buf[3] << 8
        if amplitude >= _FOREIGN:
            raise SensorError("it is blinded")
        centimetres = buf[0] | buf[1] << 8
        self.amplitude = amplitude
        if amplitude < _WEAK or centimetres > _FARTHEST:
            self.range = _INF
        elif centimetres < _NEAREST:
            self.range = -_INF
        else:
            self.range = centimetres / 100
        return True

    def _get(self, register: bytes, buf: bytearray) -> None:
        self._i2c.writeto(self._address, register)
        self._i2c.readfrom_into(self._address, buf)
