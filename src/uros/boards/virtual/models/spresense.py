"""An ESP32-S3-DevKitC-1 in place of a Sony Spresense, which has no MicroPython.

It has the Spresense's four LEDs, the line to the agent at UART 1, and a camera where the program
needs one.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from ..devices.camera import Camera
from ..hardware.peripherals import UartPins
from ..hardware.pins import Led, Pin
from ..world.arena import Arena
from ..world.renderer import Scene

if TYPE_CHECKING:
    from ..hardware.board import VirtualBoard

_PINS: Final = (*range(22), *range(33, 49))
_AGENT_UART: Final = 1
_AGENT_PINS: Final = UartPins("43", "44")
_DEFAULT_PINS: Final = UartPins("10", "9")  # MicroPython's of UART 1
_BAUD: Final = 115_200
LEDS: Final = ("38", "39", "40", "41")

_WITH_CAMERA: Final = "spresense_camera"
# 20,000 octets a second of pictures are more than 115,200 baud can carry.
_CAMERA_BAUD: Final = 921_600


def wire(board: VirtualBoard) -> None:
    """Add the parts and pins to the board."""
    camera = board.name == _WITH_CAMERA
    board.unique_id = b"\x34" + board.number(5)
    for number in _PINS:
        board.add_pin(Pin(str(number)))
    baud = _CAMERA_BAUD if camera else _BAUD
    board.bridge(_AGENT_UART, _AGENT_PINS, _DEFAULT_PINS, baud)
    for index, pin in enumerate(LEDS):
        board.add_led(pin, Led(f"led{index}", board.changed), f"LED{index}")
    if camera:
        scene = Scene(Arena(board.seed), ball=True)
        board.add_camera(Camera("camera", scene, seed=board.seed))
