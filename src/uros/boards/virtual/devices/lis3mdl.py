"""The LIS3MDL magnetometer: magnetic field on three axes.

After power-on it is in power-down mode. In continuous mode it takes a sample at the output data
rate of CTRL_REG1 and sets ZYXDA, which reading the output registers clears; a sample that was not
read in time sets ZYXOR. Outputs are little-endian, 6842 counts per gauss at ±4 gauss. The register
pointer moves on only with its most significant bit set.

Left out: low power and FAST_ODR, interrupts, big-endian outputs, self-test. After a single
conversion the idle state is entered.
"""

from __future__ import annotations

import random
from collections.abc import Callable
from typing import ClassVar, Final

from ..hardware.i2c import FAULTS
from ..hardware.registers import Registers, counts

ADDRESS: Final = 0x1C

WHO_AM_I: Final = 0x0F
CTRL_REG1: Final = 0x20
CTRL_REG2: Final = 0x21
CTRL_REG3: Final = 0x22
CTRL_REG4: Final = 0x23
CTRL_REG5: Final = 0x24
STATUS: Final = 0x27
OUT: Final = 0x28
TEMPERATURE: Final = 0x2E

READY: Final = 0x08
OVERRUN: Final = 0x80

_IDENTITY: Final = 0x3D
_POWER_DOWN: Final = 2
_SINGLE: Final = 1
_SENSITIVITY: Final = (6842, 3421, 2281, 1711)  # counts per gauss
_FULL: Final = (4, 8, 12, 16)  # gauss
_NOISE: Final = (0.0032, 0.0032, 0.0041)  # gauss, in its best mode
# Gauss. The data sheet allows ±1 gauss; this is a part that was calibrated once.
_OFFSET: Final = 0.01
_TESLA: Final = 1e-4  # per gauss


class Lis3mdl(Registers):
    """A LIS3MDL.

    Args:
        field: Returns the magnetic field x y z in tesla at a time in seconds since power-on.
        ambient: Returns the ambient temperature in °C at a time; by default 25 °C.
        address: The I2C address.
        seed: The seed of noise and offsets.
        noise: Whether there are noise and offsets.
    """

    FAULTS: ClassVar[dict[str, str]] = {
        **FAULTS,
        "asleep": "lost its supply for a moment: its registers are as after power-on",
        "frozen": "takes samples that are all the same",
        "saturated": "a magnet is near: every axis is at full scale",
    }

    def __init__(
        self,
        field: Callable[[float], tuple[float, float, float]],
        ambient: Callable[[float], float] | None = None,
        address: int = ADDRESS,
        seed: int = 0,
        noise: bool = True,
    ) -> None:
        super().__init__("lis3mdl", address, 0x80)
        self._field = field
        self._ambient = ambient if ambient is not None else (lambda t: 25.0)
        self._random = random.Random(f"{seed}/lis3mdl")
        self._noise = noise
        self._offsets = [self._random.gauss(0, _OFFSET if noise else 0.0) for _ in range(3)]
        self._power_up()

    def _power_up(self) -> None:
        self.memory[:] = bytes(len(self.memory))
        self.memory[WHO_AM_I] = _IDENTITY
        self.memory[CTRL_REG1] = 0x10
        self.memory[CTRL_REG3] = 0x03
        self._began = 0
        self._samples = 0

    def fault(self, kind: str) -> None:
        """Inject one of FAULTS; "asleep" resets the registers once."""
        super().fault(kind)
        if kind == "asleep":
            self.faults.discard(kind)
            self._power_up()

    def following(self, register: int) -> int:
        """Return where the pointer moves to: on by one only with its uppermost bit set."""
        return register & 0x80 | register + 1 & 0x7F if register & 0x80 else register

    def _period_us(self) -> int:
        return 1_600_000 >> (self.memory[CTRL_REG1] >> 2 & 7)

    def catch_up(self, now_us: int) -> None:
        """Store the results of the measurements that were finished by ``now_us``."""
        mode = self.memory[CTRL_REG3] & 3
        if mode >= _POWER_DOWN:
            return
        period = self._period_us()
        number = (now_us - self._began) // period
        if mode == _SINGLE:
            number = min(number, 1)
        if number <= self._samples:
            return
        late = number - self._samples > 1 or self.memory[STATUS] & READY
        self._samples = number
        self._sample(self._began + number * period)
        self.memory[STATUS] |= 0xFF if late else 0x0F
        if mode == _SINGLE:
            self.memory[CTRL_REG3] |= 3

    def _sample(self, at: int) -> None:
        if "frozen" in self.faults:
            return
        chosen = self.memory[CTRL_REG2] >> 5 & 3
        for axis, tesla in enumerate(self._field(at / 1e6)):
            gauss = tesla / _TESLA + self._offsets[axis]
            if self._noise:
                gauss += self._random.gauss(0, _NOISE[axis])
            if "saturated" in self.faults:
                gauss = 1e3
            full = counts(_FULL[chosen], _SENSITIVITY[chosen])
            raw = counts(gauss, _SENSITIVITY[chosen])
            if abs(raw) > full:
                raw = 0x7FFF if raw > 0 else -0x8000
            self.put(OUT + 2 * axis, raw, True)
        if self.memory[CTRL_REG1] & 0x80:
            self.put(TEMPERATURE, counts(self._ambient(at / 1e6) - 25, 8), True)

    def wrote(self, register: int, byte: int) -> None:
        """Store the byte where the register can be written, and carry out commands."""
        if register == CTRL_REG2 and byte & 0x0C:  # REBOOT or SOFT_RST
            self._power_up()
            return
        if CTRL_REG1 <= register <= CTRL_REG5 or 0x30 <= register <= 0x33:
            self.memory[register] = byte
            if register in (CTRL_REG1, CTRL_REG3):
                self._began = self.now_us()
                self._samples = 0

    def was_read(self, register: int) -> None:
        """Clear the status bits that this read clears."""
        if register == OUT + 5:
            self.memory[STATUS] = 0
