"""Messages that are packed and unpacked by a table, for types that are known only at run time.

`dynamic` makes the classes. They encode the same octets as generated classes, but take more time,
and allocate memory for each value. Runs on MicroPython.
"""

from array import array as numbers
from struct import calcsize, pack_into

from .compact import align, get, load_text, put_numbers, room
from .runtime import Message, fault, get_wide, long, octet, put_bytes, short, utf8, wide, wire_bytes

try:
    from typing import Any, Final
except ImportError:  # MicroPython
    pass

MESSAGE: Final = "m"


class Table(Message):
    """Base of the classes; a subclass defines ``__slots__``, ``_TYPE``, ``_FIELDS`` and ``_plan``.

    ``_plan`` has for each field (default, code, array, size, of). The code is that of struct,
    ``?`` for bool, ``s`` for string, ``w`` for wstring, or `MESSAGE`; ``array`` is "" for none,
    "[" for one of a fixed size, "<" for a sequence; ``of`` is the bound of a string, or the class
    of a message. A default of None stands for zeros.
    """

    __slots__ = ()  # type: tuple[str, ...]
    _plan = ()  # type: Any

    def __init__(self, *args: "Any", **values: "Any") -> None:
        at = 0
        for name in self.__slots__:
            default, code, array, size, of = self._plan[at]
            value = args[at] if at < len(args) else values.pop(name, None)
            at += 1
            if value is None:
                if array and default is None:
                    default = [_zero(code, of) for _ in range(size if array == "[" else 0)]
                    if code == "B":
                        default = bytes(default)
                value = _zero(code, of) if default is None else default
                if isinstance(value, list):
                    several = array == "<" and code not in "?swm"
                    value = numbers(code, value) if several else value[:]
            setattr(self, name, value)
        if values or at < len(args):
            raise TypeError("%s has %d fields: %s" % (self._TYPE, at, ", ".join(self.__slots__)))

    def cdr_size(self, o: int = 0) -> int:
        """Return the end offset of the payload when it starts at ``o``."""
        try:
            return _walk(self, None, o, 0)
        except Exception as error:
            return fault(self, error)

    def pack_into(self, buf: "Any", offset: int, start: int) -> int:
        """Write little-endian CDR, aligned from ``start``; returns the end offset."""
        try:
            return _walk(self, buf, offset, start)
        except Exception as error:
            return fault(self, error, len(buf) - offset)

    @classmethod
    def unpack_from(
        cls, buf: "Any", offset: int, start: int, end: int, little: bool = True
    ) -> "tuple[Any, int]":
        """Decode a new message; returns (message, end offset)."""
        message = cls()
        return message, message.unpack_into(buf, offset, start, end, little)

    def unpack_into(
        self, buf: "Any", offset: int, start: int, end: int, little: bool = True
    ) -> int:
        """Decode into this message; a fault in the octets leaves the message unchanged."""
        if end > len(buf):
            raise short(end - offset, offset, len(buf))
        values = []
        o = offset
        for _, code, array, size, of in self._plan:
            if array == "<":
                n, o = _read("I", 0, buf, o, start, end, little)
                if size and n > size:
                    raise long(n, size)
                size = n
            if array:
                value, o = _read_all(code, size, of, buf, o, start, end, little)
            else:
                value, o = _read(code, of, buf, o, start, end, little)
            values.append(value)
        if not values:
            o = room(o, start, 0, 1, end) + 1
        for name in self.__slots__:
            setattr(self, name, values.pop(0))
        return o


def _zero(code: str, of: "Any") -> "Any":
    """Return the default of a type without one in its definition."""
    if code == MESSAGE:
        return of()
    return "" if code in "sw" else False if code == "?" else 0.0 if code in "fd" else 0


def _walk(message: "Table", buf: "Any", o: int, start: int) -> int:
    """Write the message at ``buf[o:]`` unless ``buf`` is None; returns the end offset."""
    at = 0
    for _, code, array, size, of in message._plan:
        value = getattr(message, message.__slots__[at])
        at += 1
        if not array:
            o = write(code, of, value, buf, o, start)
            continue
        if isinstance(value, str):
            raise TypeError
        if code == "B":
            value = wire_bytes(value)
        n = len(value)
        if array == "<":
            o = write("I", 0, n, buf, o, start)
        if size and (n > size or n < size and array == "["):
            raise ValueError
        if code == "B":
            o = put_bytes(buf, o, value) if buf is not None else o + n
        elif code in ("f", "d") and n:
            o = write(code, 0, 0, buf, o, start) - (size := calcsize(code))
            o = put_numbers(buf, o, value, "<" + code) if buf is not None else o + n * size
        else:
            for item in value:
                o = write(code, of, item, buf, o, start)
    return o if at else write("B", 0, 0, buf, o, start)


def write(code: str, of: "Any", value: "Any", buf: "Any", o: int, start: int) -> int:
    """Write one value as `_walk` does."""
    if code == MESSAGE:
        if getattr(value, "_TYPE", None) != of._TYPE:
            raise TypeError
        return value.cdr_size(o) if buf is None else value.pack_into(buf, o, start)  # type: ignore
    if code in "sw":
        data = utf8(value) if code == "s" else wide(value)
        n = len(data) if code == "s" else len(data) >> 2
        if of and n > of:
            raise ValueError
        if code == "s":
            n += 1
            data += b"\0"
        o = write("I", 0, n, buf, o, start)
        return o + len(data) if buf is None else put_bytes(buf, o, data)
    width = 1 if code == "?" else calcsize(code)
    if code not in "fd":
        if isinstance(value, bytes):
            value = octet(value)
        bits = 1 if code == "?" else 8 * width - (code > "Z")
        if not (-1 << bits if code > "Z" else 0) <= value < 1 << bits:
            raise ValueError
    if buf is None:
        return o + (start - o & width - 1) + width
    o = align(buf, o, start, width - 1)
    pack_into("<B" if code == "?" else "<" + code, buf, o, value)
    return o + width


def _read(
    code: str, of: "Any", buf: "Any", o: int, start: int, end: int, little: bool
) -> "tuple[Any, int]":
    """One value, and the end offset."""
    if code == MESSAGE:
        return of.unpack_from(buf, o, start, end, little)  # type: ignore[no-any-return]
    if code in "sw":
        n, o = _read("I", 0, buf, o, start, end, little)
        if code == "s":
            return load_text(buf, o, n, end, "", of), o + n
        return get_wide(buf, o, n, end, little, of), o + 4 * n
    if code == "?":
        value, o = _read("B", 0, buf, o, start, end, little)
        return value != 0, o
    width = calcsize(code)
    o = room(o, start, width - 1, width, end)
    return get("<" + code, buf, o, little)[0], o + width


def _read_all(
    code: str, n: int, of: "Any", buf: "Any", o: int, start: int, end: int, little: bool
) -> "tuple[Any, int]":
    """Read ``n`` values; returns them and the end offset."""
    if n > end - o:  # a value is at least one octet: the loop is no longer than the sample
        raise short(n, o, end)
    if code == "B":
        return bytes(buf[o : o + n]), o + n
    several = code not in "?swm"
    if several and n:
        width = calcsize(code)
        o = room(o, start, width - 1, width * n, end)
        return numbers(code, get("<%d%s" % (n, code), buf, o, little)), o + width * n
    values = []
    for _ in range(n):
        value, o = _read(code, of, buf, o, start, end, little)
        values.append(value)
    return numbers(code, values) if several else values, o
