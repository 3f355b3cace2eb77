"""What a virtual board has, for a program that asks for something else.

The text follows MicroPython's own error text: a real board says no more than that a pin or a UART
does not exist.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Final

from ..shims import _ops as ops

if TYPE_CHECKING:
    from ..hardware.board import VirtualBoard
    from ..hardware.pins import Pin

_SHIMS: Final = Path(__file__).resolve().parents[1] / "shims"
_MISSING_MODULE: Final = re.compile(r"^ImportError: no module named '([\w.]+)'$", re.MULTILINE)
_MOST_PINS: Final = 12  # that are named with their function
_PIN_WIDTH: Final = 4  # of the names of pins; shorter ones are sorted as numbers


def advice(board: VirtualBoard, data: bytes) -> bytes:
    """Return the rest of an error text.

    Args:
        board: The board.
        data: The operation that failed (see ``shims/_ops.py``), and the name that was asked for.

    Raises:
        KeyError: No text exists for this operation.
    """
    return _OF[data[0]](board, data[1:].decode()).encode()


def module_advice(traceback: str) -> str:
    """Return a line about the module that a program did not find; "" for any other traceback."""
    missing = _MISSING_MODULE.search(traceback)
    if not missing:
        return ""
    files = sorted(path.stem for path in _SHIMS.iterdir() if not path.name.startswith("_"))
    return (
        f"a virtual board has no module {missing[1]!r}: it has {', '.join(files)} and MicroPython's"
        f" own modules; a file {missing[1].partition('.')[0]}.py beside main.py can take its place"
    )


def uart_texts(board: VirtualBoard) -> list[str]:
    """Return each UART with its pins, and which is the USB line."""
    texts = []
    for number, uart in sorted(board.uarts.items()):
        pins = f" at {uart.pins}" if uart.pins else ""
        line = " (its USB line)" if uart is board.bridged else ""
        texts.append(f"UART({number}){pins}{line}")
    return texts


def miswiring(board: VirtualBoard, number: int) -> str:
    """Return what happens where a program uses other pins than those of a UART's device.

    Args:
        board: The board.
        number: The UART, with the pins that the program has chosen.

    Returns:
        The text; "" where the pins are right.
    """
    uart = board.uarts[number]
    if uart.pins is None or uart.pins == uart.chosen_pins:
        return ""
    if uart.sends:
        what = "the board receives nothing"
    elif uart.receives:
        what = "nothing that the board sends arrives"
    else:
        what = "nothing arrives at either end"
    swapped = " (swapped)" if uart.pins == uart.chosen_pins[::-1] else ""
    return (
        f"UART({number}) has {uart.chosen_pins}{swapped}, and this virtual board's line is at"
        f" {uart.pins}: {what}, as on a real board"
    )


def _uart(board: VirtualBoard, name: str) -> str:
    texts = uart_texts(board)
    if board.usb_inside:
        texts.append("its own USB, which uros.drivers.port.open_port() opens")
    return (
        f"{_has(texts, 'no UART')}; --plug esp8266:uart={name} adds a Wi-Fi modem on UART({name})"
    )


def _spi(board: VirtualBoard, name: str) -> str:
    texts = [f"SPI({number})" for number in sorted(board.spis)]
    return (
        f"{_has(texts, 'no SPI bus')}; --plug gs2200:spi={name},ready=PIN,cs=PIN adds a Wi-Fi modem"
        f" on SPI({name})"
    )


def _i2c(board: VirtualBoard, name: str) -> str:
    texts = [
        f"I2C({channel}) with {' and '.join(device.name for device in bus.devices.values())}"
        for channel, bus in sorted(board.i2c.items())
    ]
    other = "" if texts else "; 'uros board list' names boards with I2C sensors"
    return _has(texts, "no I2C bus") + other


def _pin(board: VirtualBoard, name: str) -> str:
    used = _functions(pin for pin in board.pins.values() if pin.function)
    among = f", among them {used}" if used else ""
    return f"this virtual board has no pin {name!r}; it has {_ranges(board.pins)}{among}"


def _adc(board: VirtualBoard, name: str) -> str:
    used = _functions(pin for pin in board.pins.values() if pin.analog is not None)
    return f"on this virtual board {used or 'no pin'} has a converter"


def _radio(board: VirtualBoard, name: str) -> str:
    return "this virtual board has no radio; --plug wlan adds one"


_OF: Final[Mapping[int, Callable[[VirtualBoard, str], str]]] = {
    ops.UART_INIT: _uart,
    ops.SPI_INIT: _spi,
    ops.I2C_INIT: _i2c,
    ops.PIN_MODE: _pin,
    ops.ADC_READ: _adc,
    ops.WLAN_STATUS: _radio,
}


def _has(texts: list[str], none: str) -> str:
    return f"this virtual board has {', '.join(texts) or none}"


def _functions(pins: Iterable[Pin]) -> str:
    texts = [f"{pin.name} ({pin.function})" for pin in pins]
    more = ", ..." if len(texts) > _MOST_PINS else ""
    return ", ".join(texts[:_MOST_PINS]) + more


def _ranges(names: Iterable[str]) -> str:
    """Return names in their order; consecutive numbers become a range."""
    runs: list[list[str]] = []
    for name in sorted(names, key=lambda text: (not text.isdecimal(), text.zfill(_PIN_WIDTH))):
        last = runs[-1][-1] if runs else ""
        if name.isdecimal() and last.isdecimal() and int(name) == int(last) + 1:
            runs[-1].append(name)
        else:
            runs.append([name])
    return ", ".join(f"{run[0]} to {run[-1]}" if len(run) > 2 else ", ".join(run) for run in runs)
