"""The MCP9600 thermocouple converter: hot and cold junction temperature.

A write sets the register pointer and then the register; a read returns the register's bytes, and
0xFF after them. Temperatures are big-endian int16 in 0.0625 °C. Conversions are continuous, 320 ms
each at 18 bits; reads stretch the clock for 60 µs.

Left out: the digital filter, burst mode's averaging (it converts as in normal mode) and the
outputs of the alerts; their registers keep what is written.
"""

from __future__ import annotations

import random
from collections.abc import Callable
from typing import ClassVar, Final

from ..hardware.i2c import FAULTS, IDLE, Device

ADDRESS: Final = 0x67

HOT: Final = 0x00
DELTA: Final = 0x01
COLD: Final = 0x02
RAW: Final = 0x03
STATUS: Final = 0x04
THERMOCOUPLE: Final = 0x05
CONFIG: Final = 0x06
DEVICE_ID: Final = 0x20

# Bits of the status register.
BURST_DONE: Final = 0x80
UPDATED: Final = 0x40
OUT_OF_RANGE: Final = 0x10

_SIZES: Final = {
    HOT: 2, DELTA: 2, COLD: 2, RAW: 3, STATUS: 1, THERMOCOUPLE: 1, CONFIG: 1,
    0x08: 1, 0x09: 1, 0x0A: 1, 0x0B: 1,  # alerts: configuration,
    0x0C: 1, 0x0D: 1, 0x0E: 1, 0x0F: 1,  # hysteresis,
    0x10: 2, 0x11: 2, 0x12: 2, 0x13: 2,  # limit
    DEVICE_ID: 2,
}  # fmt: skip
_READ_ONLY: Final = (HOT, DELTA, COLD, RAW, DEVICE_ID)
_IDENTITY: Final = b"\x40\x14"

# Of the thermocouple types K J T N S E B R: the range in °C, and about how many µV per °C at room
# temperature.
_TYPES: Final = (
    (-200, 1372, 40.6), (-150, 1200, 51.7), (-200, 400, 40.7), (-150, 1300, 26.5),
    (50, 1664, 6.0), (-200, 1000, 60.9), (250, 1800, 0.2), (50, 1664, 6.0),
)  # fmt: skip
# µs for a conversion by the ADC resolution in CONFIG, and µV per count at 18 bits.
_CONVERSION_US: Final = (320_000, 80_000, 20_000, 5_000)
_MICROVOLTS: Final = 2.0
_STRETCH_US: Final = 60
_SHUTDOWN: Final = 1


class Mcp9600(Device):
    """An MCP9600.

    Args:
        junctions: Returns the temperatures of the hot and the cold junction in °C at a time in
            seconds since power-on.
        address: The I2C address.
        seed: The seed of the noise.
        noise: Whether there is noise; without, results are only rounded.
    """

    FAULTS: ClassVar[dict[str, str]] = {
        **FAULTS,
        # The data sheet does not specify the reading; this is the worst case.
        "open": "the thermocouple is broken: it reads the end of its range, with the status bit",
    }

    def __init__(
        self,
        junctions: Callable[[float], tuple[float, float]],
        address: int = ADDRESS,
        seed: int = 0,
        noise: bool = True,
    ) -> None:
        super().__init__("mcp9600", address)
        self._junctions = junctions
        self._random = random.Random(f"{seed}/mcp9600")
        self._noise = noise
        self.registers = {number: bytes(size) for number, size in _SIZES.items()}
        self.registers[DEVICE_ID] = _IDENTITY
        self._pointer = HOT
        self._written: bytearray | None = None  # after the pointer
        self._out = b""
        self._at = 0
        self._hold = 0
        self._began = 0  # when the first conversion with this configuration began
        self._conversions = 0  # since then

    def start(self, read: bool) -> bool:
        """Latch the register for a read; always acknowledge."""
        self._written = None
        self._at = 0
        self._hold = 0
        self._convert()
        if read:
            self._hold = _STRETCH_US
            self._out = self.registers.get(self._pointer, b"")
        return True

    def hold_us(self) -> int:
        """Return for how long the clock is stretched, in µs."""
        held, self._hold = self._hold, 0
        return held

    def write(self, byte: int) -> bool:
        """Take a byte from the controller; return whether it is acknowledged."""
        if self._written is None:
            self._pointer = byte
            self._written = bytearray()
            return True
        size = _SIZES.get(self._pointer, 0)
        if self._pointer in _READ_ONLY or len(self._written) >= size:
            return False
        self._written.append(byte)
        if len(self._written) == size:
            self._set(bytes(self._written))
        return True

    def read(self) -> int:
        """Return the next byte for the controller."""
        if self._at >= len(self._out):
            return IDLE
        self._at += 1
        return self._out[self._at - 1]

    def _set(self, data: bytes) -> None:
        if self._pointer == STATUS:
            # Only these two status bits can be cleared, by writing 0.
            data = bytes((self.registers[STATUS][0] & (data[0] | ~(BURST_DONE | UPDATED)),))
        elif self._pointer in (THERMOCOUPLE, CONFIG):
            self._began = self.now_us()
            self._conversions = 0
        self.registers[self._pointer] = data

    def _convert(self) -> None:
        """Store the result of the last conversion that is complete."""
        config = self.registers[CONFIG][0]
        if config & 3 == _SHUTDOWN:
            return
        period = _CONVERSION_US[config >> 5 & 3]
        number = (self.now_us() - self._began) // period
        if number <= self._conversions:
            return
        self._conversions = number
        hot, cold = self._junctions((self._began + number * period) / 1e6)
        if self._noise:
            hot += self._random.gauss(0, 0.05)
            cold += self._random.gauss(0, 0.03)
        lowest, highest, microvolts = _TYPES[self.registers[THERMOCOUPLE][0] >> 4 & 7]
        status = self.registers[STATUS][0] & ~OUT_OF_RANGE | UPDATED | BURST_DONE
        if "open" in self.faults:
            hot = highest + 1
        if not lowest <= hot <= highest:
            status |= OUT_OF_RANGE
            hot = min(max(hot, lowest), highest)
        step = 4 if config & 0x80 else 1  # cold junction resolution: 0.25 or 0.0625 °C
        cold_counts = round(cold * 16 / step) * step
        hot_counts = round(hot * 16)
        self.registers[HOT] = _int(hot_counts, 2)
        self.registers[COLD] = _int(cold_counts, 2)
        self.registers[DELTA] = _int(hot_counts - cold_counts, 2)
        raw = round((hot - cold) * microvolts / _MICROVOLTS)
        bits = 18 - 2 * (config >> 5 & 3)
        self.registers[RAW] = _int(raw >> (18 - bits) << (18 - bits), 3)
        self.registers[STATUS] = bytes((status,))


def _int(value: int, size: int) -> bytes:
    limit = 1 << (8 * size - 1)
    return min(max(value, -limit), limit - 1).to_bytes(size, "big", signed=True)
