"""InvenSense MPU-6050: acceleration and angular velocity, measured continuously at 100 Hz.

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
# A self-test response may deviate from the factory's by 14 %.
_TOLERANCE: Final = 0.14


class MPU6050(Sampled):
    """Inertial sensor with six axes; its values are of the last good read.

    ``ax``, ``ay`` and ``az`` are the proper acceleration in m/s² (at rest: 9.8 upwards), ``gx``,
    ``gy`` and ``gz`` the angular velocity in rad/s, ``temperature`` is that of the chip in °C.

    Args:
        i2c: The bus.
        address: The sensor's address.
        accel_g: Range of the acceleration: 2, 4, 8 or 16 g.
        gyro_dps: Range of the angular velocity: 250, 500, 1000 or 2000 degrees a second.

    Raises:
        ValueError: There is no such range.
    """

    wait_ms = 10

    def __init__(
        self, i2c: "Any", address: int = 0x68, accel_g: int = 2, gyro_dps: int = 250
    ) -> None:
        # The gyroscope takes 30 ms to start: the first samples are discarded.
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
        """Check the identity and write the settings."""
        self._testing = 0
        self.identify(_WHO_AM_I, 0x68, "an MPU-6050")
        self.put(_POWER, _AWAKE)
        self.put(_SETTINGS, _RATE, _FILTER, self._gyro, self._accel)
        self.put(_INT_ENABLE, _DATA_READY)

    def take(self, buf: bytearray) -> None:
        """Store a sample. Raises SensorError if one of its axes is out of range."""
        index = 1
        while index < 15:
            raw = word(buf, index, index + 1)
            if index != 7 and (raw == 32767 or raw == -32768):
                quantity = "acceleration" if index < 7 else "rate of turn"
                raise SensorError("%s is out of range" % quantity)
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
        """Compare each axis's self-test response with the factory's; the sensor must lie still.

        Readings continue afterwards.

        Returns:
            Whether the test is complete and all six axes passed. If not, call it again 50 ms later.

        Raises:
            SensorError: Some axes failed; the text names them.
        """
        self.start()
        step, self._testing = self._testing, 0
        self._is_set_up = False  # so that it is set up again afterwards, whatever the result
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
