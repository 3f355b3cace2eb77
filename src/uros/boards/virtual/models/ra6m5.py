"""An EK-RA6M5: three I2C sensors in a room, native USB."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from ..devices.mcp9600 import Mcp9600
from ..devices.sht3x import Sht3x
from ..devices.vcnl4010 import Vcnl4010
from ..hardware.i2c import I2CBus
from ..hardware.pins import Led, Pin

if TYPE_CHECKING:
    from ..hardware.board import VirtualBoard

I2C_CHANNEL: Final = 2


def wire(board: VirtualBoard) -> None:
    """Add the parts and pins to the board."""
    room, seed = board.room, board.seed
    bus = I2CBus(clock=board.clock, seed=seed)
    board.add_bus(I2C_CHANNEL, bus)
    for device in (
        Sht3x(room.air, seed=seed), Mcp9600(room.junctions, seed=seed),
        Vcnl4010(room.scene, seed=seed),
    ):  # fmt: skip
        bus.attach(device)
        board.parts.add(device)
    board.unique_id = b"RA6M5" + board.number(11)
    board.own_usb()
    board.add_pin(Pin("P414", "I2C2 SDA", lambda: bus.sda))
    # A program recovers a stuck bus by driving the clock: rising edges count as clock pulses.
    board.add_pin(
        Pin("P415", "I2C2 SCL", lambda: bus.scl, lambda level: bus.pulse() if level else None)
    )
    for name, colour in (("P006", "blue"), ("P007", "green"), ("P008", "red")):
        board.add_led(name, Led(f"led_{colour}", board.changed), f"{colour} LED")
    board.add_pin(Pin("P005", "button S1"))
    board.add_pin(Pin("P004", "button S2"))
