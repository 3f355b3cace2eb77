"""Messages without generated classes, for the client's own services and topics.

A generated class for each type is faster and easier to use. But those of the parameter services
alone would take 25 kB of a board's heap; here one codec serves all types. A type is described by
its name and a string of letters, one for each field, with nested messages inline::

    ?  bool     B  uint8, byte     i  int32     I  uint32     q  int64     Q  uint64
    d  float64  s  string          [...]  a sequence of what is inside

A message is the list of its values. The items of a sequence of one letter are plain values, of more
letters lists; ``[B]`` is bytes.
"""

from struct import pack_into, unpack_from

try:
    from typing import Any
except ImportError:  # MicroPython
    pass

_WIDTHS = {"B": 1, "?": 1, "i": 4, "I": 4, "q": 8, "Q": 8, "d": 8}


class Shape:
    """A message type; calling it with a list of values creates a message."""

    def __init__(self, type_name: str, letters: str) -> None:
        self._TYPE = type_name
        self.letters = letters

    @property
    def _DDS_TYPE(self) -> str:
        package, kind, name = self._TYPE.split("/")
        return "%s::%s::dds_::%s_" % (package, kind, name)

    def __call__(self, values: "Any" = ()) -> "Shaped":
        """Return a message with these values."""
        return Shaped(self, values)

    def unpack_from(
        self, buf: "Any", offset: int, start: int, end: int, little: bool = True
    ) -> "tuple[Shaped, int]":
        """Decode the message at ``buf[offset:end]``, aligned from ``start``.

        Trailing bytes count as part of the message: rmw_serialize leaves room for more if sequences
        of wide numbers are empty.

        Returns:
            The message, and ``end``.

        Raises:
            ValueError: The bytes are malformed.
        """
        values, _ = _get(self.letters, buf, offset, start, end, "<" if little else ">")
        return Shaped(self, values), end


class Shaped:
    """A message with ``values`` and the methods of a generated class that the client calls."""

    def __init__(self, shape: Shape, values: "Any") -> None:
        self._TYPE = shape._TYPE
        self._letters = shape.letters
        self.values = values

    def cdr_size(self, o: int = 0) -> int:
        """Return the offset behind the message if it begins at offset ``o``."""
        return _put(self._letters, self.values, None, o, 0)

    def pack_into(self, buf: "Any", offset: int, start: int) -> int:
        """Encode the message at ``buf[offset:]``, aligned from ``start``; return where it ends."""
        return _put(self._letters, self.values, buf, offset, start)


class ShapedService:
    """A service type: ``package/srv/Name``, and the letters of request and response."""

    def __init__(self, name: str, request: str, response: str) -> None:
        self.Request = Shape(name + "_Request", request)
        self.Response = Shape(name + "_Response", response)


def _close(letters: str, at: int) -> int:
    """Return the index of the bracket that ends the sequence whose content begins at ``at``."""
    depth = 1
    while depth:
        if letters[at] == "[":
            depth += 1
        elif letters[at] == "]":
            depth -= 1
        at += 1
    return at - 1


def _put(letters: str, values: "Any", buf: "Any", o: int, start: int) -> int:
    """Encode the values at ``buf[o:]``, or only measure them if ``buf`` is None; return the end."""
    at = 0
    for value in values:
        code = letters[at]
        at += 1
        if code == "[":
            stop = _close(letters, at)
            inner = letters[at:stop]
            at = stop + 1
            o = _put_number("I", len(value), buf, o, start)
            if inner == "B":
                o = _put_octets(bytes(value), buf, o)
            else:
                for item in value:
                    o = _put(inner, (item,) if len(inner) == 1 else item, buf, o, start)
        elif code == "s":
            octets = value.encode()
            o = _put_number("I", len(octets) + 1, buf, o, start)
            o = _put_octets(octets + b"\x00", buf, o)
        else:
            o = _put_number(code, value, buf, o, start)
    return o


def _put_octets(octets: bytes, buf: "Any", o: int) -> int:
    end = o + len(octets)
    if buf is not None:
        buf[o:end] = octets
    return end


def _put_number(code: str, value: "Any", buf: "Any", o: int, start: int) -> int:
    width = _WIDTHS[code]
    pad = (start - o) & (width - 1)
    if buf is not None:
        for i in range(o, o + pad):
            buf[i] = 0
        # MicroPython has no "?".
        pack_into("<" + ("B" if code == "?" else code), buf, o + pad, value)
    return o + pad + width


def _get(
    letters: str, buf: "Any", o: int, start: int, end: int, order: str
) -> "tuple[list[Any], int]":
    """Decode the values of ``letters``; return them and where they end."""
    values: "list[Any]" = []
    at = 0
    while at < len(letters):
        code = letters[at]
        at += 1
        if code == "[":
            stop = _close(letters, at)
            inner = letters[at:stop]
            at = stop + 1
            count, o = _get_number("I", buf, o, start, end, order)
            # An item has at least one octet. This prevents an attack by a count of four billion.
            if count > end - o:
                raise ValueError("%d items in %d octets" % (count, end - o))
            value: "Any" = []
            if inner == "B":
                value = bytes(buf[o : o + count])
                o += count
            else:
                for _ in range(count):
                    item, o = _get(inner, buf, o, start, end, order)
                    value.append(item[0] if len(inner) == 1 else item)
        elif code == "s":
            count, o = _get_number("I", buf, o, start, end, order)
            if count > end - o:
                raise ValueError("a string of %d octets where %d are" % (count, end - o))
            octets = bytes(buf[o : o + count])
            o += count
            nul = octets.find(b"\x00")
            value = (octets if nul < 0 else octets[:nul]).decode()
        else:
            value, o = _get_number(code, buf, o, start, end, order)
        values.append(value)
    return values, o


def _get_number(
    code: str, buf: "Any", o: int, start: int, end: int, order: str
) -> "tuple[Any, int]":
    width = _WIDTHS[code]
    o += (start - o) & (width - 1)
    if o + width > end:
        raise ValueError("%d octets at %d of %d" % (width, o, end))
    value = unpack_from(order + ("B" if code == "?" else code), buf, o)[0]
    return value != 0 if code == "?" else value, o + width
