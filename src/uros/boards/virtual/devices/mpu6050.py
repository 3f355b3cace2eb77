"""The MPU-6050: acceleration, angular velocity and die temperature.

After power-on it is in sleep mode, and every output is 0. Awake it takes a sample every
(1 + SMPLRT_DIV) / 1 kHz (8 kHz with the low-pass filter off) and sets DATA_RDY, which reading
INT_STATUS clears. The fourteen output registers hold one sample, big-endian: acceleration x y z,
temperature (340 counts per °C from 36.53 °C), angular velocity x y z. The gyroscope needs 30 ms to
start after sleep mode.

Self-test deflects the masses by known forces: the six factory trim codes in registers 0x0D to 0x10
give the change of the outputs.

Left out: FIFO, auxiliary I2C bus, motion detection and its high pass, cycle mode; their registers
keep what is written. Of the low-pass filter only sample rate and noise bandwidth are modelled.
"""

from __future__ import annotations

import math
import random
from collections.abc import Callable
from typing import ClassVar, Final

from ..hardware.i2c import FAULTS
from ..hardware.registers import Registers, counts

ADDRESS: Final = 0x68

SELF_TEST: Final = 0x0D
SMPLRT_DIV: Final = 0x19
CONFIG: Final = 0x1A
GYRO_CONFIG: Final = 0x1B
ACCEL_CONFIG: Final = 0x1C
INT_ENABLE: Final = 0x38
INT_STATUS: Final = 0x3A
ACCEL: Final = 0x3B
TEMPERATURE: Final = 0x41
GYRO: Final = 0x43
PWR_MGMT_1: Final = 0x6B
WHO_AM_I: Final = 0x75

DATA_READY: Final = 0x01
SLEEP: Final = 0x40
RESET: Final = 0x80
G: Final = 9.80665

_GYRO_START_US: Final = 30_000
_READ_ONLY: Final = frozenset(
    (*range(SELF_TEST, SELF_TEST + 4), *range(INT_STATUS, 0x49), WHO_AM_I)
)
# Bandwidths of the low-pass filter in Hz; noise and offsets after the data sheet.
_BANDWIDTH: Final = (260, 184, 94, 44, 21, 10, 5, 260)
_ACCEL_NOISE: Final = 400e-6  # g per root of Hz
_GYRO_NOISE: Final = 0.005  # degrees a second per root of Hz
_ACCEL_OFFSET: Final = 0.02  # g: one sigma
_GYRO_OFFSET: Final = 1.0  # degrees a second: one sigma

Motion = tuple[float, float, float, float, float, float]


def accel_trim(code: int) -> float:
    """Return the self-test response of an accelerometer axis at ±8 g, in counts.

    Args:
        code: The 5-bit factory trim code; 0 for none.
    """
    return 4096 * 0.34 * (0.92 / 0.34) ** ((code - 1) / 30) if code else 0.0


def gyro_trim(code: int) -> float:
    """Return the self-test response of a gyroscope axis at ±250 °/s, in counts; negative for y.

    Args:
        code: The 5-bit factory trim code; 0 for none.
    """
    return 25 * 131 * 1.046 ** (code - 1) if code else 0.0


class Mpu6050(Registers):
    """An MPU-6050.

    Args:
        motion: Returns the proper acceleration (at rest: 1 g upwards) in m/s² and the angular
            velocity in rad/s, x y z each, at a time in seconds since power-on.
        ambient: Returns the ambient temperature in °C at a time; by default 25 °C.
        address: The I2C address.
        seed: The seed of noise, offsets and trim codes.
        noise: Whether there are noise and offsets.
    """

    FAULTS: ClassVar[dict[str, str]] = {
        **FAULTS,
        "asleep": "lost its supply for a moment: its registers are as after power-on",
        "frozen": "takes samples that are all the same",
        "saturated": "its x axes are at full scale",
        "selftest": "the mass of its z axis sticks: its self-test response is half of what it was",
    }

    def __init__(
        self,
        motion: Callable[[float], Motion],
        ambient: Callable[[float], float] | None = None,
        address: int = ADDRESS,
        seed: int = 0,
        noise: bool = True,
    ) -> None:
        super().__init__("mpu6050", address, 0x80)
        self._motion = motion
        self._ambient = ambient if ambient is not None else (lambda t: 25.0)
        self._random = source = random.Random(f"{seed}/mpu6050")
        self._noise = noise
        size = 1.0 if noise else 0.0
        self._offsets = [
            source.gauss(0, size * (_ACCEL_OFFSET if axis < 3 else _GYRO_OFFSET))
            for axis in range(6)
        ]
        self._codes = [source.randint(8, 24) for _ in range(6)]
        self._power_up()

    def _power_up(self) -> None:
        self.memory[:] = bytes(len(self.memory))
        self.memory[PWR_MGMT_1] = SLEEP
        self.memory[WHO_AM_I] = ADDRESS
        xa, ya, za, xg, yg, zg = self._codes
        self.memory[SELF_TEST : SELF_TEST + 4] = bytes(
            ((xa >> 2) << 5 | xg, (ya >> 2) << 5 | yg, (za >> 2) << 5 | zg,
             (xa & 3) << 4 | (ya & 3) << 2 | za & 3)
        )  # fmt: skip
        self._began = 0  # when sampling began
        self._samples = 0
        self._woke = 0

    def fault(self, kind: str) -> None:
        """Inject one of FAULTS; "asleep" resets the registers once."""
        super().fault(kind)
        if kind == "asleep":  # momentary: only the registers stay changed
            self.faults.discard(kind)
            self._power_up()

    def _period_us(self) -> int:
        kilohertz = 8 if self.memory[CONFIG] & 7 in (0, 7) else 1
        return (1 + self.memory[SMPLRT_DIV]) * 1000 // kilohertz

    def _restart(self, now: int) -> None:
        self._began = now
        self._samples = 0

    def catch_up(self, now_us: int) -> None:
        """Store the results of the measurements that were finished by ``now_us``."""
        if self.memory[PWR_MGMT_1] & SLEEP:
            return
        period = self._period_us()
        number = (now_us - self._began) // period
        if number <= self._samples:
            return
        self._samples = number
        self._sample(self._began + number * period)
        if self.memory[INT_ENABLE] & DATA_READY:
            self.memory[INT_STATUS] |= DATA_READY

    def _sample(self, at: int) -> None:
        if "frozen" in self.faults:
            return
        memory = self.memory
        gyro_range, accel_range = memory[GYRO_CONFIG] >> 3 & 3, memory[ACCEL_CONFIG] >> 3 & 3
        values = self._motion(at / 1e6)
        width = math.sqrt(_BANDWIDTH[memory[CONFIG] & 7])
        for axis in range(6):
            is_rate = axis >= 3
            if is_rate:
                value = math.degrees(values[axis])
                scale = 32768 / (250 << gyro_range)
            else:
                value = values[axis] / G
                scale = 32768 / (2 << accel_range)
            value += self._offsets[axis]
            if self._noise:
                value += self._random.gauss(0, width * (_GYRO_NOISE if is_rate else _ACCEL_NOISE))
            if is_rate and at - self._woke < _GYRO_START_US:
                value += 100.0  # degrees a second, while the gyroscope starts
            full_scale = gyro_range if is_rate else accel_range
            raw = counts(value, scale) + self._self_test(axis, full_scale)
            if axis in (0, 3) and "saturated" in self.faults:
                raw = 0x7FFF
            self.put((GYRO - 6 if is_rate else ACCEL) + 2 * axis, raw)
        warm = self._ambient(at / 1e6) + 2.0
        self.put(TEMPERATURE, counts(warm - 36.53, 340))

    def _self_test(self, axis: int, chosen: int) -> int:
        """Return the self-test response of an axis, in counts of the selected range."""
        code = self._codes[axis]
        if axis < 3:
            if not self.memory[ACCEL_CONFIG] & 0x80 >> axis:
                return 0
            value = accel_trim(code) * 4 / (1 << chosen)
        else:
            if not self.memory[GYRO_CONFIG] & 0x80 >> axis - 3:
                return 0
            value = gyro_trim(code) / (1 << chosen) * (-1 if axis == 4 else 1)
        if axis == 2 and "selftest" in self.faults:
            value /= 2
        return round(value)

    def wrote(self, register: int, byte: int) -> None:
        """Store the byte where the register can be written, and carry out commands."""
        now = self.now_us()
        if register == PWR_MGMT_1:
            if byte & RESET:
                self._power_up()
                return
            if self.memory[PWR_MGMT_1] & SLEEP and not byte & SLEEP:
                self._woke = now
                self._restart(now)
        elif register in (SMPLRT_DIV, CONFIG):
            self._restart(now)
        if register not in _READ_ONLY:
            self.memory[register] = byte

    def was_read(self, register: int) -> None:
        """Clear the status bits that this read clears."""
        if register == INT_STATUS:
            self.memory[INT_STATUS] = 0
