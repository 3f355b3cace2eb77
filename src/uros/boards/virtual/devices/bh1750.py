"""The BH1750 ambient light sensor: illuminance in lux, one-byte commands.

A measurement at 1 lx resolution takes 120 ms typically and 180 ms at most, with the measurement
time register (MTreg) at 69. The 16-bit result is lux * 1.2 at that setting, and proportional to
MTreg. After a one-time measurement the sensor is in power-down mode. Until a measurement is
complete, a read returns the result before it.
"""

from __future__ import annotations

import random
from collections.abc import Callable
from typing import ClassVar, Final

from ..hardware.i2c import FAULTS, Device
from ..hardware.registers import counts

ADDRESS: Final = 0x23

_OFF: Final = 0x00
_ON: Final = 0x01
_RESET: Final = 0x07
_TIME: Final = 69  # MTreg after power-on
_SHORTEST: Final = 31
_LONGEST: Final = 254
# By the lower two bits of a command: µs at the default measurement time, and counts per lux.
_MODES: Final = {0: (120_000, 1.2), 1: (120_000, 2.4), 3: (16_000, 1.2)}
_LOW_RESOLUTION: Final = 3
_ACCURACY: Final = 0.05  # one sigma; the data sheet gives 0.96 to 1.44 counts per lux


class Bh1750(Device):
    """A BH1750.

    Args:
        light: Returns the illuminance in lux at a time in seconds since power-on.
        address: The I2C address.
        seed: The seed of noise and gain error.
        noise: Whether there is noise and a gain error; without, results are only rounded.
    """

    FAULTS: ClassVar[dict[str, str]] = {
        **FAULTS,
        "frozen": "its result no longer changes",
        "saturated": "a lamp shines straight into it: the result is at full scale",
    }

    def __init__(
        self,
        light: Callable[[float], float],
        address: int = ADDRESS,
        seed: int = 0,
        noise: bool = True,
    ) -> None:
        super().__init__("bh1750", address)
        self._light = light
        self._random = random.Random(f"{seed}/bh1750")
        self._noise = noise
        self._gain = 1 + self._random.gauss(0, _ACCURACY) if noise else 1.0
        self._on = False
        self._time = _TIME
        self._mode = 0
        self._continuous = False  # whether it measures continuously
        self._done_at: int | None = None
        self._result = 0
        self._out = b""

    def start(self, read: bool) -> bool:
        """Latch the result for a read; always acknowledge."""
        self._update()
        self._out = self._result.to_bytes(2, "big")
        return True

    def write(self, byte: int) -> bool:
        """Run a command; return whether there is such a command."""
        if byte == _OFF:
            self._on = False
            self._done_at = None
        elif byte == _ON:
            self._on = True
        elif byte == _RESET:
            if self._on:
                self._result = 0
        elif byte >> 3 == 0b01000:
            self._set_time(self._time & 0x1F | (byte & 7) << 5)
        elif byte >> 5 == 0b011:
            self._set_time(self._time & 0xE0 | byte & 0x1F)
        elif byte >> 4 in (1, 2) and byte & 0x0F in _MODES:
            self._on = True
            self._continuous = byte >> 4 == 1
            self._mode = byte & 3
            self._done_at = self.now_us() + self._duration_us()
        else:
            return False
        return True

    def read(self) -> int:
        """Return the next byte for the controller."""
        byte, self._out = self._out[:1], self._out[1:]
        return byte[0] if byte else 0xFF

    def _set_time(self, value: int) -> None:
        self._time = value

    @property
    def _proportion(self) -> float:
        # The low-resolution mode does not depend on MTreg.
        if self._mode == _LOW_RESOLUTION:
            return 1.0
        return min(max(self._time, _SHORTEST), _LONGEST) / _TIME

    def _duration_us(self) -> int:
        return round(_MODES[self._mode][0] * self._proportion)

    def _update(self) -> None:
        now = self.now_us()
        if self._done_at is None or now < self._done_at:
            return
        at = self._done_at
        if self._continuous:
            duration = self._duration_us()
            at = now - (now - at) % duration
            self._done_at = at + duration
        else:
            self._done_at = None
            self._on = False
        if "frozen" in self.faults:
            return
        lux = self._light(at / 1e6) * self._gain
        if self._noise:
            lux += self._random.gauss(0, 0.5 + 0.002 * abs(lux))
        if "saturated" in self.faults:
            lux = 1e9
        steps = counts(lux, _MODES[self._mode][1] * self._proportion)
        if self._mode == _LOW_RESOLUTION:
            steps &= ~3  # 4 lx
        self._result = min(max(steps, 0), 0xFFFF)
