# mypy: disable-error-code="no-any-return"
"""System calls on MicroPython: a device file of the engine (``engine/micropython.mjs``).

A write is the operation's octet and its data; the first read carries it out. The response is an
error number or 0, u32 number or length, octets. The engine answers for the ticks itself where it
can, without the file: programs read them at each turn.
"""

from _ops import TICKS_MS, TICKS_US  # type: ignore[import-not-found]
from _ticks import ticks as _ticks  # type: ignore[import-not-found]

_line = open("/dev/board", "r+b", 0)
_head = bytearray(5)
_op = bytearray(1)


def _ask(op: int, data: bytes) -> int:
    _op[0] = op
    _line.write(_op)
    if len(data):
        _line.write(data)
    _line.readinto(_head)
    if _head[0]:
        raise OSError(_head[0])
    return _head[1] | _head[2] << 8 | _head[3] << 16 | _head[4] << 24


def call(op: int, data: bytes = b"") -> bytes:
    """Carry out an operation and return its data; see ``_board``."""
    length = _ask(op, data)
    if not length:
        return b""
    return _line.read(length)


def number(op: int, data: bytes = b"") -> int:
    """Carry out an operation and return its number, which is in the place of the length."""
    if op == TICKS_MS or op == TICKS_US:
        ticks = _ticks(op)
        if ticks >= 0:
            return ticks
    return _ask(op, data)
