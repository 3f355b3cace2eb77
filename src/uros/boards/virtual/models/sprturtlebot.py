"""SprTurtleBot: a rover with motor driver, encoders and camera.

Its board takes the place of a Spresense, as in `uros.boards.virtual.models.spresense`.
"""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING, Final

from ..devices.camera import Camera
from ..hardware.pins import Pin
from ..world.renderer import Scene
from ..world.rover import Rover
from . import spresense

if TYPE_CHECKING:
    from ..devices.encoder import Encoder
    from ..hardware.board import VirtualBoard

# The driver's inputs AIN1, AIN2 (right), BIN1, BIN2 (left).
_DRIVER: Final = ("1", "2", "42", "47")
_INPUTS: Final = ("AIN1", "AIN2", "BIN1", "BIN2")
_POWER: Final = "48"
_ENCODERS: Final = (("right encoder", "3"), ("left encoder", "46"))


def wire(board: VirtualBoard) -> None:
    """Add the parts and pins to the board."""
    spresense.wire(board)
    rover = Rover("rover", board.seed)
    board.parts.add(rover)
    for channel, (number, name) in enumerate(zip(_DRIVER, _INPUTS, strict=True)):
        board.add_pin(Pin(number, f"driver {name}", on_duty=partial(rover.set_duty, channel)))
    board.add_pin(Pin(_POWER, "motor power", on_duty=lambda duty: rover.power(bool(duty))))
    for encoder, (name, number) in zip(rover.encoders, _ENCODERS, strict=True):
        encoder.on_edge = board.add_pin(Pin(number, name, partial(_level, encoder))).edge
    scene = Scene(rover.arena)

    def where() -> tuple[float, float, float]:
        with board.lock:
            return rover.x, rover.y, rover.theta

    camera = Camera("camera", scene, where, board.seed)
    board.add_camera(camera)


def _level(encoder: Encoder) -> int:
    return encoder.level
