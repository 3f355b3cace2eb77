"""The board in place of a Spresense, carried outdoors: six I2C sensors and a GNSS receiver.

The sensors are on I2C channel 0, the receiver at UART 2. The receiver reports this host's time. The
light is always that of ten in the morning, so that a seed gives the same measurements at every
hour.
"""

from __future__ import annotations

import time
from typing import TYPE_CHECKING, Final

from ..devices.bh1750 import Bh1750
from ..devices.gnss import Gnss
from ..devices.lis3mdl import Lis3mdl
from ..devices.max17048 import Max17048
from ..devices.mpu6050 import Mpu6050
from ..devices.sht3x import Sht3x
from ..devices.tfluna import TfLuna
from ..hardware.i2c import I2CBus
from ..hardware.peripherals import Uart, UartPins
from ..hardware.pins import Pin
from ..world.outdoors import Outdoors
from . import spresense

if TYPE_CHECKING:
    from ..hardware.board import VirtualBoard

_CHANNEL: Final = 0
_SDA: Final = "1"
_SCL: Final = "2"
_GNSS_UART: Final = 2
_GNSS_BAUD: Final = 9600
_GNSS_PINS: Final = UartPins("47", "48")
_DEFAULT_PINS: Final = UartPins("17", "16")  # MicroPython's of UART 2


def wire(board: VirtualBoard) -> None:
    """Add the parts and pins to the board."""
    spresense.wire(board)
    seed = board.seed
    world = Outdoors(seed)
    bus = I2CBus(clock=board.clock, seed=seed)
    board.add_bus(_CHANNEL, bus)
    for device in (
        Mpu6050(world.motion, world.temperature, seed=seed),
        Lis3mdl(world.field, world.temperature, seed=seed),
        Bh1750(world.light, seed=seed),
        Max17048(world.cell, seed=seed),
        TfLuna(world.target, world.temperature, seed=seed),
        Sht3x(world.air, seed=seed),
    ):
        bus.attach(device)
        board.parts.add(device)
    board.add_pin(Pin(_SDA, "I2C0 SDA", lambda: bus.sda))
    board.add_pin(
        Pin(_SCL, "I2C0 SCL", lambda: bus.scl, lambda level: bus.pulse() if level else None)
    )
    power_on = time.time() - board.clock.world_us() / 1e6
    gnss = Gnss(world.place, power_on, seed=seed, baud=_GNSS_BAUD)
    board.parts.add(gnss)
    board.uarts[_GNSS_UART] = Uart(
        gnss, _GNSS_BAUD, board.clock, pins=_GNSS_PINS, default_pins=_DEFAULT_PINS
    )
