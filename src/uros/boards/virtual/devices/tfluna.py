"""The TF-Luna lidar in I2C mode: distance, little-endian registers.

It measures the distance in cm, the amplitude of the returned light and its own temperature in
0.01 °C; a tick in milliseconds tells one measurement from the next. It measures 100 times a second,
or once for each trigger. With an amplitude below 100 the distance is 0; ambient light makes the
amplitude larger than 32768, and 65535 when the sensor is saturated.

In continuous mode a read may fall into an update and return bytes of two measurements, as the
manual warns; that depends on the time of each byte on the bus.

Left out: the data-ready pin, other rates, limits, UART mode; their registers keep what is written.
"""

from __future__ import annotations

import math
import random
from collections.abc import Callable
from typing import ClassVar, Final

from ..hardware.i2c import FAULTS
from ..hardware.registers import Registers, counts

ADDRESS: Final = 0x10

DISTANCE: Final = 0x00
AMPLITUDE: Final = 0x02
TEMPERATURE: Final = 0x04
TICK: Final = 0x06
ERROR: Final = 0x08
VERSION: Final = 0x0A
SAVE: Final = 0x20
REBOOT: Final = 0x21
ADDRESS_REGISTER: Final = 0x22
MODE: Final = 0x23
TRIGGER: Final = 0x24
ENABLE: Final = 0x25
RATE: Final = 0x26
THRESHOLD: Final = 0x2A
DUMMY: Final = 0x2C
SIGNATURE: Final = 0x3C

_PERIOD_US: Final = 10_000
_TRIGGERED_US: Final = 4_000
_LIGHT: Final = 30_000.0  # amplitude of a white target at 0.2 m
_BLINDED: Final = 0xFFFF


class TfLuna(Registers):
    """A TF-Luna.

    Args:
        target: Returns the distance of the target in m (infinite: none) and its reflectivity (0 to
            1) at a time in seconds since power-on.
        ambient: Returns the ambient temperature in °C at a time; by default 25 °C.
        address: The I2C address.
        seed: The seed of the noise.
        noise: Whether there is noise; without, results are only rounded.
    """

    FAULTS: ClassVar[dict[str, str]] = {
        **FAULTS,
        "frozen": "it no longer measures: its tick does not advance",
        "dirty": "its window is dirty: too little light returns",
        "sun": "the sun shines into it",
    }

    def __init__(
        self,
        target: Callable[[float], tuple[float, float]],
        ambient: Callable[[float], float] | None = None,
        address: int = ADDRESS,
        seed: int = 0,
        noise: bool = True,
    ) -> None:
        super().__init__("tfluna", address, 0x40)
        self._target = target
        self._ambient = ambient if ambient is not None else (lambda t: 25.0)
        self._random = random.Random(f"{seed}/tfluna")
        self._noise = noise
        self._power_up(0)

    def _power_up(self, now: int) -> None:
        self.memory[:] = bytes(len(self.memory))
        self.memory[VERSION : VERSION + 3] = bytes((4, 3, 3))
        self.memory[0x10:0x1E] = b"LUNA0000000001"
        self.memory[ADDRESS_REGISTER] = self.address
        self.memory[ENABLE] = 1
        self.memory[RATE] = 100
        self.memory[THRESHOLD] = 100
        self.memory[SIGNATURE:] = b"LUNA"
        self._began = now
        self._samples = 0
        self._due: int | None = None  # when the triggered measurement is complete

    def read(self) -> int:
        """Return the next byte for the controller."""
        self.catch_up(self.now_us())
        return super().read()

    def catch_up(self, now_us: int) -> None:
        """Store the results of the measurements that were finished by ``now_us``."""
        if "frozen" in self.faults or not self.memory[ENABLE]:
            return
        if self.memory[MODE]:
            if self._due is not None and now_us >= self._due:
                self._sample(self._due)
                self._due = None
            return
        number = (now_us - self._began) // _PERIOD_US
        if number > self._samples:
            self._samples = number
            self._sample(self._began + number * _PERIOD_US)

    def _sample(self, at: int) -> None:
        metres, reflects = self._target(at / 1e6)
        metres = max(metres, 0.0)
        amplitude = 0.0
        if math.isfinite(metres):
            # Falls by an exponent below 2, as the sensor raises its own light with the distance.
            amplitude = min(_LIGHT * reflects * (0.2 / max(metres, 0.2)) ** 1.4, 32_000.0)
        if "dirty" in self.faults:
            amplitude *= 0.001
        if self._noise and amplitude:
            amplitude *= 1 + self._random.gauss(0, 0.01)
            metres += self._random.gauss(0, 0.01)
        if "sun" in self.faults:
            amplitude = _BLINDED
        weak = amplitude < int.from_bytes(self.memory[THRESHOLD : THRESHOLD + 2], "little")
        dummy = int.from_bytes(self.memory[DUMMY : DUMMY + 2], "little")
        centimetres = dummy if weak or amplitude == _BLINDED else min(counts(metres, 100), 1200)
        self._word(DISTANCE, centimetres)
        self._word(AMPLITUDE, round(amplitude))
        self._word(TEMPERATURE, counts(self._ambient(at / 1e6) + 12, 100))
        self._word(TICK, at // 1000 % 0x10000)

    def _word(self, register: int, value: int) -> None:
        self.memory[register : register + 2] = (value & 0xFFFF).to_bytes(2, "little")

    def wrote(self, register: int, byte: int) -> None:
        """Store the byte where the register can be written, and carry out commands."""
        now = self.now_us()
        if register == TRIGGER:
            if byte == 1 and self.memory[MODE]:
                self._due = now + _TRIGGERED_US
        elif register == REBOOT:
            if byte == 2:
                self._power_up(now)
        elif register == MODE:
            self.memory[MODE] = byte & 1
            self._began, self._samples, self._due = now, 0, None
        elif ADDRESS_REGISTER <= register < SIGNATURE:
            self.memory[register] = byte
