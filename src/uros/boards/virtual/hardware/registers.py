"""An I2C device that is a row of registers of eight bits behind a pointer.

The first byte that is written sets the pointer, the others go where it points to; each byte moves
it on. What a burst reads is of one moment: the registers are brought up to date when the device is
addressed.
"""

from __future__ import annotations

from .i2c import Device


class Registers(Device):
    """``memory`` are the registers. Subclasses say what time does to them (`catch_up`), what a
    write does (`wrote`) and what a read does besides (`was_read`).
    """

    def __init__(self, name: str, address: int, size: int = 0x100) -> None:
        super().__init__(name, address)
        self.memory = bytearray(size)
        self.pointer = 0
        self._pointed = False

    def catch_up(self, now_us: int) -> None:
        """Bring the registers to this moment."""

    def wrote(self, register: int, byte: int) -> None:
        """The controller wrote to a register; it is ignored unless this stores it."""

    def was_read(self, register: int) -> None:
        """The controller has got the content of a register."""

    def following(self, register: int) -> int:
        """Where the pointer moves to."""
        return register + 1

    def start(self, read: bool) -> bool:
        self._pointed = False
        self.catch_up(self.now_us())
        return True

    def write(self, byte: int) -> bool:
        if not self._pointed:
            self.pointer = byte
            self._pointed = True
            return True
        self.wrote(self.pointer % len(self.memory), byte)
        self.pointer = self.following(self.pointer) % 0x100
        return True

    def read(self) -> int:
        register = self.pointer % len(self.memory)
        byte = self.memory[register]
        self.was_read(register)
        self.pointer = self.following(self.pointer) % 0x100
        return byte

    def put(self, register: int, value: int, little: bool = False) -> None:
        """A signed number of 16 bits, limited to what fits, into two registers."""
        value = min(max(value, -0x8000), 0x7FFF)
        self.memory[register : register + 2] = value.to_bytes(
            2, "little" if little else "big", signed=True
        )


def counts(value: float, per_unit: float) -> int:
    """What an ADC makes of a value, whatever it is; what is no number is 0."""
    value *= per_unit
    if value != value:
        return 0
    return round(min(max(value, -1e9), 1e9))
