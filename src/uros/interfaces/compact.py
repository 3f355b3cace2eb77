"""Helpers of the classes generated for boards, beyond `runtime`: little memory, no garbage.

A board's classes (see `emit_board`) store float64 values in the byte order of the wire: a `Doubles`
(Vector3, Point, Quaternion) in one array, a fixed array of float64 in a `Row`. Packing copies the
octets: MicroPython's ``struct`` copies any buffer by the code ``s`` without creating an object.
CPython and big-endian hosts convert each value, with the same octets as the result. `get`, `fill`
and `load_row` read after a length check by `room`; `load_text` checks the length itself.
"""

import sys
from array import array
from struct import calcsize

from .errors import InterfaceError
from .runtime import NAMES_FIELDS, Message, utf8

try:
    from typing import Any
except ImportError:  # MicroPython
    pass

if sys.implementation.name == "micropython" and sys.byteorder == "little":
    from struct import pack_into, unpack_from

    _WIRE_ORDER = True
else:
    _WIRE_ORDER = False

    def pack_into(fmt: str, buf: "Any", o: int, *values: "Any") -> None:  # type: ignore[misc]
        """Pack as struct does; an array for ``s`` holds doubles in the host's byte order."""
        import struct

        if isinstance(buf, array):  # an array of doubles is the target, the value is wire octets
            if calcsize(fmt) > 8 * len(buf):
                raise ValueError
            for i, value in enumerate(unpack_from("<%dd" % len(buf), values[0])):
                buf[i] = value
            return
        plain = [struct.pack("<%dd" % len(v), *v) if isinstance(v, array) else v for v in values]
        struct.pack_into(fmt, buf, o, *plain)

    def unpack_from(fmt: str, buf: "Any", o: int = 0) -> "Any":  # type: ignore[misc]
        """Unpack as struct does, but raise InterfaceError if the data is too short."""
        import struct

        if o + calcsize(fmt) > len(buf):
            raise InterfaceError("%d octets needed, %d are left" % (calcsize(fmt), len(buf) - o))
        return struct.unpack_from(fmt, buf, o)


class Row(array):  # type: ignore[type-arg]
    """A fixed array of float64. `row` creates it and stores its length in ``n``."""

    n: int
    append = extend = None  # type: ignore[assignment]  # the length is constant


class Doubles(Message if NAMES_FIELDS else object):  # type: ignore[misc]
    """Base of messages that are x, y and z as float64, and perhaps w."""

    __slots__ = ("_d",)

    _made = (0, 0, 0)  # type: tuple[float, ...]

    def __init__(self) -> None:
        self._d = array("d", self._made)

    # A board's build drops members whose name is never used, so each value has its own.
    def x(self, value: float) -> None:
        """Set the first value."""
        self._d[0] = value

    x = property(lambda self: self._d[0], x)  # type: ignore[assignment]

    def y(self, value: float) -> None:
        """Set the second value."""
        self._d[1] = value

    y = property(lambda self: self._d[1], y)  # type: ignore[assignment]

    def z(self, value: float) -> None:
        """Set the third value."""
        self._d[2] = value

    z = property(lambda self: self._d[2], z)  # type: ignore[assignment]

    def _w(self, value: float) -> None:
        self._d[3] = value

    _w = property(lambda self: self._d[3], _w)  # type: ignore[assignment]


def row(values: "Any", n: int) -> "Any":
    """Return the values if they are a `Row` of n, else a new `Row` of them, or of zeros if None."""
    if values.__class__ is not Row:
        values = Row("d", bytes(8 * n) if values is None else values)
        values.n = len(values)
    if values.n != n:
        raise InterfaceError("%d elements, only %d are allowed" % (values.n, n))
    return values


def align(buf: "Any", o: int, start: int, mask: int) -> int:
    """Write zeros up to the next multiple of ``mask + 1`` from ``start`` on; returns the offset."""
    while o - start & mask:
        buf[o] = 0
        o += 1
    return o


def put_numbers(buf: "Any", o: int, values: "Any", code: str, low: int = 0, high: int = 0) -> int:
    """Write numbers of one struct code, none of them outside ``low`` … ``high`` (0, 0: any)."""
    if isinstance(values, (str, bytes, bytearray, dict)):
        raise TypeError
    size = calcsize(code)
    for value in values:
        if (low or high) and not low <= value <= high:
            raise ValueError
        pack_into(code, buf, o, value)
        o += size
    return o


def room(o: int, start: int, mask: int, n: int, end: int) -> int:
    """Return the offset aligned as by `align`; raises InterfaceError if n octets are not left."""
    o += start - o & mask
    if o + n > end:
        raise InterfaceError("%d octets needed at offset %d, %d are left" % (n, o, end - o))
    return o


def get(fmt: str, buf: "Any", o: int, little: bool) -> "Any":
    """Unpack data of either byte order by a little-endian format."""
    return unpack_from(fmt if little else ">" + fmt[1:], buf, o)


def fill(doubles: "Any", fmt: str, buf: "Any", o: int, little: bool) -> None:
    """Read into an array of float64; ``fmt`` is the code ``s`` with the number of octets."""
    if _WIRE_ORDER and little:
        pack_into(fmt, doubles, 0, buf[o:])
    else:
        for i in range(len(doubles)):
            doubles[i] = get("<d", buf, o + 8 * i, little)[0]


def load_row(old: "Any", n: int, fmt: str, buf: "Any", o: int, little: bool) -> "Any":
    """Read n float64 into ``old`` if it is a `Row` of n, else into a new `Row`."""
    if type(old) is not Row or old.n != n:
        old = row(None, n)
    if _WIRE_ORDER and little:  # as fill does, without a call
        pack_into(fmt, old, 0, buf[o:])
    else:
        fill(old, fmt, buf, o, little)
    return old


def new_text(buf: "Any", o: int, n: int) -> str:
    """Read a string of n octets with its NUL; with n = 0 there is no NUL."""
    buf = buf[o : o + n]
    if len(buf) < n or any(buf[-1:]):
        raise InterfaceError("string at offset %d does not end with NUL" % o)
    return str(buf[:-1], "utf-8")


def load_text(buf: "Any", o: int, n: int, end: int, old: "Any", bound: int = 0) -> str:
    """Read a string of n octets with its NUL; returns ``old`` itself if the text is equal."""
    if not n:  # some writers send an empty string without its NUL
        return ""
    end = room(o, o, 0, n, end) + n - 1
    if buf[end]:
        raise InterfaceError("string at offset %d does not end with NUL" % o)
    if bound and end - o > bound:
        raise InterfaceError("length %d, at most %d are allowed" % (end - o, bound))
    octets = buf[o:end]
    if octets == utf8(old):
        return old  # type: ignore[no-any-return]
    if NAMES_FIELDS:
        try:
            return str(octets, "utf-8", "replace")
        except ValueError:  # MicroPython does not support "replace"
            return "".join([chr(c) if c < 128 else "\ufffd" for c in octets])
    else:
        return str(octets, "utf-8")  # invalid UTF-8 is malformed data: ValueError
