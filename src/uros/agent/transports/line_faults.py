"""Explains bytes of a line among which no frame is."""

from __future__ import annotations

from typing import Final

# Usual baud rates of boards, the likeliest first.
RATES: Final = (
    115200, 921600, 9600, 57600, 460800, 230400, 1000000, 2000000, 1500000, 500000, 38400, 19200,
)  # fmt: skip
# How many of them a message names.
_NAMED: Final = 4
# The least number of bytes to judge text by, and the most that are shown.
_ENOUGH: Final = 12
_SHOWN: Final = 40
# The least percentage of printable bytes in text; noise has about forty.
_PRINTABLE: Final = 90


def is_text(data: bytes) -> bool:
    """Return whether bytes are text, such as a board's console, rather than noise."""
    printable = sum(32 <= octet < 127 or octet in b"\r\n\t\x1b" for octet in data)
    return len(data) >= _ENOUGH and printable * 100 >= len(data) * _PRINTABLE


def explain(data: bytes, device: str, baud: int | None) -> str:
    """Say why bytes have no frame, and what to do.

    Args:
        data: Some of the bytes.
        device: The line's device.
        baud: The agent's rate; None if the line has none.
    """
    if is_text(data):
        shown = data[:_SHOWN].decode("ascii", "replace")
        return (
            f"text, such as {shown!r}: the board's console, or firmware without micro-ROS on this"
            " port"
        )
    if baud is None:
        return "another program than a micro-ROS client?"
    rates = [str(rate) for rate in RATES if rate != baud][:_NAMED]
    return (
        f"the board's rate is probably not {baud} baud: try --baudrate {', '.join(rates[:-1])} or"
        f" {rates[-1]}; or stop this agent, and 'uros doctor --dev {device}' finds the rate"
    )
