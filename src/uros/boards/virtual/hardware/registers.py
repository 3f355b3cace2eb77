"""An I2C device with 8-bit registers behind a pointer.

The first byte written sets the pointer, the following ones are written to the register it points
to; each byte advances it. A burst reads values of one moment: the registers are updated when the
device is addressed.
"""

from __future__ import annotations

from .i2c import Device


class Registers(Device):
    """An I2C device with ``memory`` as its registers.

    Subclasses define how registers change with time (`catch_up`), the effect of a write (`wrote`)
    and the side effects of a read (`was_read`).
    """

    def __init__(self, name: str, address: int, size: int = 0x100) -> None:
        super().__init__(name, address)
        self.memory = bytearray(size)
        self.pointer = 0
        self._pointed = False

    def catch_up(self, now_us: int) -> None:
        """Update the registers to this moment."""

    def wrote(self, register: int, byte: int) -> None:
        """Handle a write of the controller to a register; ignored unless a subclass stores it."""

    def was_read(self, register: int) -> None:
        """Handle that the controller has read a register."""

    def following(self, register: int) -> int:
        """Return the register to which the pointer advances."""
        return register + 1

    def start(self, read: bool) -> bool:
        """Update the registers and acknowledge."""
        self._pointed = False
        self.catch_up(self.now_us())
        return True

    def write(self, byte: int) -> bool:
        """Set the pointer with the first byte, write the others to registers."""
        if not self._pointed:
            self.pointer = byte
            self._pointed = True
            return True
        self.wrote(self.pointer % len(self.memory), byte)
        self.pointer = self.following(self.pointer) % 0x100
        return True

    def read(self) -> int:
        """Return the register at the pointer and advance it."""
        register = self.pointer % len(self.memory)
        byte = self.memory[register]
        self.was_read(register)
        self.pointer = self.following(self.pointer) % 0x100
        return byte

    def put(self, register: int, value: int, little: bool = False) -> None:
        """Store a signed 16-bit number, clamped to its range, in two registers."""
        value = min(max(value, -0x8000), 0x7FFF)
        self.memory[register : register + 2] = value.to_bytes(
            2, "little" if little else "big", signed=True
        )


def counts(value: float, per_unit: float) -> int:
    """Convert a value to counts of an ADC, clamped to 1e9 either way; NaN is 0."""
    value *= per_unit
    if value != value:
        return 0
    return round(min(max(value, -1e9), 1e9))
