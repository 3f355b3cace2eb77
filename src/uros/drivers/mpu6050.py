"""InvenSense MPU-6050: acceleration and rate of turn. It measures by itself, 100 times a second.

Register numbers are those of the register map (rev. 4.2).
"""

from . import SensorError
from .sampled import Sampled, word

try:
    from typing import Any, Final
except ImportError:
    pass

_SELF_TEST: Final = b"\x0d"
_SETTINGS: Final = 0x19  # rate, filter, range of the gyroscope, of the accelerometer
_INT_ENABLE: Final = 0x38
_INT_STATUS: Final = 0x3A  # before the fourteen bytes of a sample
_POWER: Final = 0x6B
_WHO_AM_I: Final = b"\x75"

_RATE: Final = 9  # 1 kHz / (1 + 9)
_FILTER: Final = 3  # 44 Hz
_AWAKE: Final = 0x01  # by the clock of the gyroscope, which is steadier
_DATA_READY: Final = 0x01
_G: Final = 9.80665
_DEGREE: Final = 0.017453292519943295
# A self-test moves each axis by what is known from the factory, within 14 in 100.
_TOLERANCE: Final = 0.14


class MPU6050(Sampled):
    """``ax ay az`` in m/s² as it is felt (at rest: 9.8 upwards), ``gx gy gz`` in rad/s,
    ``temperature`` of the chip in °C: all of the last good read.

    ``accel_g`` is 2, 4, 8 or 16 and ``gyro_dps`` 250, 500, 1000 or 2000: where its ranges end.
    """

    wait_ms = 10

    def __init__(
        self, i2c: "Any", address: int = 0x68, accel_g: int = 2, gyro_dps: int = 250
    ) -> None:
        # 30 ms until the gyroscope has swung up.
        super().__init__(i2c, address, _INT_STATUS, _DATA_READY, 15, 4)
        if accel_g not in (2, 4, 8, 16):
            raise ValueError("accel_g is 2, 4, 8 or 16, not %r" % (accel_g,))
        if gyro_dps not in (250, 500, 1000, 2000):
            raise ValueError("gyro_dps is 250, 500, 1000 or 2000, not %r" % (gyro_dps,))
        self.ax = self.ay = self.az = 0.0
        self.gx = self.gy = self.gz = 0.0
        self.temperature = 0.0
        self._accel = (2, 4, 8, 16).index(accel_g) << 3
        self._gyro = (250, 500, 1000, 2000).index(gyro_dps) << 3
        self._per_accel = accel_g * _G / 32768
        self._per_turn = gyro_dps * _DEGREE / 32768
        self._still: "list[int] | None" = None
        self._testing = 0

    def set_up(self) -> None:
        self._testing = 0
        self.identify(_WHO_AM_I, 0x68, "an MPU-6050")
        self.put(_POWER, _AWAKE)
        self.put(_SETTINGS, _RATE, _FILTER, self._gyro, self._accel)
        self.put(_INT_ENABLE, _DATA_READY)

    def take(self, buf: bytearray) -> None:
        index = 1
        while index < 15:
            raw = word(buf, index, index + 1)
            if index != 7 and (raw == 32767 or raw == -32768):
                what = "acceleration" if index < 7 else "rate of turn"
                raise SensorError("%s is out of range" % what)
            index += 2
        per = self._per_accel
        self.ax = word(buf, 1, 2) * per
        self.ay = word(buf, 3, 4) * per
        self.az = word(buf, 5, 6) * per
        self.temperature = word(buf, 7, 8) / 340 + 36.53
        per = self._per_turn
        self.gx = word(buf, 9, 10) * per
        self.gy = word(buf, 11, 12) * per
        self.gz = word(buf, 13, 14) * per

    def self_test(self) -> bool:
        """Push the masses and see whether they move as they did in the factory, lying still. False:
        not done, call it again 50 ms later; True: all six axes are fine. Raises SensorError that
        names those that are not. Readings go on afterwards.
        """
        self.start()
        step, self._testing = self._testing, 0
        self._is_set_up = False  # and so it is set up anew afterwards, whatever comes of it
        if step == 0:
            self.put(_SETTINGS, _RATE, _FILTER, 0x00, 0x10)  # 250 degrees a second, 8 g
        elif step == 1:
            self._still = self._raw()
            self.put(_SETTINGS, _RATE, _FILTER, 0xE0, 0xF0)
        else:
            self._judge(self._raw())
            return True
        self._testing = step + 1
        self._is_set_up = True
        return False

    def _raw(self) -> "list[int]":
        buf = bytearray(15)
        self.get(self._status, buf)
        if not buf[0] & _DATA_READY:
            raise SensorError("it gives no new values")
        return [word(buf, 1 + 2 * i, 2 + 2 * i) for i in (0, 1, 2, 4, 5, 6)]

    def _judge(self, pushed: "list[int]") -> None:
        codes = bytearray(4)
        self.get(_SELF_TEST, codes)
        still = self._still or pushed
        wrong = ""
        axis = 0
        while axis < 6:
            if axis < 3:
                code = codes[axis] >> 3 & 0x1C | codes[3] >> 4 - 2 * axis & 3
                trim = 1392.64 * 2.7058823529 ** ((code - 1) / 30)
            else:
                code = codes[axis - 3] & 0x1F
                trim = 3275 * 1.046 ** (code - 1)
                if axis == 4:
                    trim = -trim
            moved = pushed[axis] - still[axis]
            if code and abs(moved - trim) > _TOLERANCE * abs(trim):
                wrong += " " + ("ax", "ay", "az", "gx", "gy", "gz")[axis]
            axis += 1
        if wrong:
            raise SensorError("self-test is wrong:" + wrong)
