"""An ESP32-DevKitC on a breadboard, with LEDs, a button and a potentiometer.

An LED is at pin 22, a button or a second LED at pin 23, a potentiometer at pin 34. The agent is at
a USB adapter on UART 2 or in the board's own WLAN.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from ..hardware.peripherals import UartPins
from ..hardware.pins import Button, Led, Pin, Potentiometer

if TYPE_CHECKING:
    from ..hardware.board import VirtualBoard

_PINS: Final = (*range(6), *range(12, 20), *range(21, 24), *range(25, 28), *range(32, 40))
_AGENT_UART: Final = 2
_AGENT_PINS: Final = UartPins("17", "16")  # also MicroPython's default of UART 2
_LED: Final = "22"
_SECOND: Final = "23"
_KNOB: Final = "34"
_WITH_BUTTON: Final = "esp32_button_led"


def wire(board: VirtualBoard) -> None:
    """Add the parts and pins to the board."""
    board.unique_id = b"\x24" + board.number(5)
    for number in _PINS:
        board.add_pin(Pin(str(number)))
    board.bridge(_AGENT_UART, _AGENT_PINS)
    knob = Potentiometer("knob", board.seed)
    board.parts.add(knob)
    board.add_pin(Pin(_KNOB, "knob", analog=knob.analog))
    board.add_led(_LED, Led("led", board.changed), "LED")
    if board.name == _WITH_BUTTON:
        button = Button("button", board.seed)
        board.parts.add(button)
        button.pin.name = _SECOND
        board.add_pin(button.pin)
    else:
        board.add_led(_SECOND, Led("error_led", board.changed), "second LED")
