"""The MAX17048 fuel gauge: cell voltage and state of charge, 16-bit big-endian registers.

It converts four times a second: VCELL in 78.125 µV, SOC in 1/256 %, CRATE in 0.208 % an hour. The
first result is there 1 s after power-on.

Left out: its model of the cell (the state of charge is given to it), alerts, hibernation and sleep;
their registers keep what is written.
"""

from __future__ import annotations

import random
from collections.abc import Callable
from typing import ClassVar, Final

from ..hardware.i2c import FAULTS
from ..hardware.registers import Registers, counts

ADDRESS: Final = 0x36

VCELL: Final = 0x02
SOC: Final = 0x04
MODE: Final = 0x06
VERSION: Final = 0x08
HIBRT: Final = 0x0A
CONFIG: Final = 0x0C
VALRT: Final = 0x14
CRATE: Final = 0x16
VRESET: Final = 0x18
STATUS: Final = 0x1A
COMMAND: Final = 0xFE

RESET_SEEN: Final = 0x01  # in the upper byte of STATUS
_POWER_ON: Final = 0x5400
_DEFAULTS: Final = {
    VERSION: 0x0012, HIBRT: 0x8030, CONFIG: 0x971C, VALRT: 0x00FF, VRESET: 0x960C, STATUS: 0x0100,
    COMMAND: 0xFFFF,
}  # fmt: skip
_WRITABLE: Final = frozenset(
    byte for low in (MODE, HIBRT, CONFIG, VALRT, VRESET, STATUS, COMMAND) for byte in (low, low + 1)
)
_PERIOD_US: Final = 250_000
_FIRST_US: Final = 1_000_000
_HOUR: Final = 3600.0
_ACCURACY: Final = 0.0025  # V: one sigma of ±7.5 mV


class Max17048(Registers):
    """A MAX17048.

    Args:
        cell: Returns the cell's voltage in V and state of charge (0 to 1) at a time in seconds
            since power-on.
        address: The I2C address.
        seed: The seed of noise and offset.
        noise: Whether there are noise and offset; without, results are only rounded.
    """

    FAULTS: ClassVar[dict[str, str]] = {
        **FAULTS,
        "open": "the cell is disconnected: it measures nearly 0 V",
        "frozen": "its results no longer change",
        "low": "the cell is nearly empty: 3.2 V, 3 %",
    }

    def __init__(
        self,
        cell: Callable[[float], tuple[float, float]],
        address: int = ADDRESS,
        seed: int = 0,
        noise: bool = True,
    ) -> None:
        super().__init__("max17048", address)
        self._cell = cell
        self._random = random.Random(f"{seed}/max17048")
        self._offset = self._random.gauss(0, _ACCURACY if noise else 0.0)
        self._noise = noise
        self._power_up(0)

    def _power_up(self, now: int) -> None:
        self.memory[:] = bytes(len(self.memory))
        for register, value in _DEFAULTS.items():
            self.memory[register : register + 2] = value.to_bytes(2, "big")
        self._first = now + _FIRST_US
        self._measured = -1

    def catch_up(self, now_us: int) -> None:
        """Store the results of the measurements that were finished by ``now_us``."""
        number = (now_us - self._first) // _PERIOD_US
        if number <= self._measured or number < 0:
            return
        self._measured = number
        if "frozen" in self.faults:
            return
        t = (self._first + number * _PERIOD_US) / 1e6
        volts, full = self._cell(t)
        earlier = self._cell(max(t - 60, 0.0))[1]
        rate = (full - earlier) / (t - max(t - 60, 0.0)) * _HOUR
        if self._noise:
            volts += self._offset + self._random.gauss(0, 0.0005)
        if "open" in self.faults:
            volts, full = 0.04, 0.0
        elif "low" in self.faults:
            volts, full = 3.2, 0.03
        self._word(VCELL, counts(volts, 1e6 / 78.125))
        self._word(SOC, counts(full, 100 * 256))
        self.put(CRATE, counts(rate, 100 / 0.208))

    def _word(self, register: int, value: int) -> None:
        self.memory[register : register + 2] = min(max(value, 0), 0xFFFF).to_bytes(2, "big")

    def wrote(self, register: int, byte: int) -> None:
        """Store the byte where the register can be written, and carry out commands."""
        if register not in _WRITABLE:
            return
        self.memory[register] = byte
        if register == COMMAND + 1:
            command = int.from_bytes(self.memory[COMMAND:], "big")
            if command == _POWER_ON:
                self._power_up(self.now_us())
            self.memory[COMMAND:] = b"\xff\xff"
