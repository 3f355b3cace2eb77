"""Base class, checks, strings and sequences of generated messages.

Runs on MicroPython. ``put_*`` write at ``buf[o:]`` and return the end offset; ``get_*`` read, check
every length against ``end`` before they allocate, and raise `InterfaceError` only.
"""

import sys
from array import array
from struct import calcsize, pack, pack_into, unpack_from

from .errors import InterfaceError

try:
    from typing import Any, Final
except ImportError:
    pass

# Whether an error names the field, and messages can be printed and compared. A board's build sets
# False, which saves 4 kB; a host names the field.
NAMES_FIELDS: Final = True
_LITTLE_HOST = sys.byteorder == "little"
_CPYTHON = sys.implementation.name != "micropython"

_RANGES = {
    "boolean": (0, 1),
    "octet": (0, 255),
    "int8": (-128, 127),
    "uint8": (0, 255),
    "int16": (-32768, 32767),
    "uint16": (0, 65535),
    "int32": (-2147483648, 2147483647),
    "uint32": (0, 4294967295),
    "int64": (-9223372036854775808, 9223372036854775807),
    "uint64": (0, 18446744073709551615),
}
# A string that a board publishes repeatedly (a frame id) is encoded once.
_CACHED_TEXTS = 8
_CACHED_LENGTH = 64
utf8_of = {}  # type: dict[str, bytes]


class Message:
    """Base of every generated class; fields are plain attributes, checked when packed.

    A class has, besides its fields and constants: ``_TYPE``, ``_DDS_TYPE``, ``_HASH``, ``_FIELDS``
    (pairs of field name and type), and

    ``cdr_size(o=0)`` – the end offset of the payload when it starts at ``o``, so with 0 its size;
    ``pack_into(buf, offset, start)`` – writes little-endian CDR, aligned from ``start``, and
    returns the end offset; TypeError or InterfaceError name the field that does not fit;
    ``unpack_from(buf, offset, start, end, little=True)`` – a classmethod, returns (message, end
    offset), and raises InterfaceError for any fault in the bytes;
    ``unpack_into(buf, offset, start, end, little=True)`` – reads into this message, and returns the
    end offset. On a board nested messages, fixed arrays of float64 and equal strings stay the same
    objects, so that almost nothing is allocated. A fault in the bytes leaves the message valid; on
    a board the fields before the fault may have their new values.

    A field named like one of these methods, like ``self`` or like a Python keyword has an
    underscore appended. The methods of this class call ``_size``, ``_pack`` and ``_load`` of a
    board's class (see `emit_board`); a host's class has its own methods.
    """

    __slots__ = ()  # type: tuple[str, ...]
    _TYPE = ""
    _FIELDS = ()  # type: tuple[tuple[str, str], ...]
    # The fields' attributes, where these are not __slots__.
    _NAMES = ()  # type: tuple[str, ...]

    def cdr_size(self: "Any", o: int = 0) -> int:
        """Return the end offset of the payload when it starts at ``o``."""
        try:
            return self._size(o)  # type: ignore[no-any-return]
        except Exception as error:
            return fault(self, error)

    def pack_into(self: "Any", buf: "Any", offset: int, start: int) -> int:
        """Write little-endian CDR, aligned from ``start``; returns the end offset."""
        try:
            return self._pack(buf, offset, start)  # type: ignore[no-any-return]
        except Exception as error:
            return fault(self, error, len(buf) - offset if NAMES_FIELDS else -1)

    @classmethod
    def unpack_from(
        cls, buf: "Any", offset: int, start: int, end: int, little: bool = True
    ) -> "tuple[Any, int]":
        """Decode a new message; returns (message, end offset)."""
        message = cls()
        return message, message.unpack_into(buf, offset, start, end, little)

    def unpack_into(
        self: "Any", buf: "Any", offset: int, start: int, end: int, little: bool = True
    ) -> int:
        """Decode into this message; returns the end offset."""
        view = memoryview(buf)[:end]
        return self._load(view, offset, start, len(view), little)  # type: ignore[no-any-return]

    @classmethod
    def get_fields_and_field_types(cls) -> "dict[str, str]":
        """The fields with their types, spelled as rclpy spells them."""
        return dict(cls._FIELDS)

    if NAMES_FIELDS:

        def __repr__(self) -> str:
            parts = []
            for name in self._NAMES or self.__slots__:
                value = getattr(self, name)
                if isinstance(value, (array, bytes, bytearray, memoryview)):
                    value = list(value)
                parts.append("%s=%r" % (name, value))
            return "%s(%s)" % (self._TYPE.replace("/", "."), ", ".join(parts))

        def __eq__(self, other: object) -> bool:
            if type(other) is not type(self):
                return False
            for name in self._NAMES or self.__slots__:
                if not _same(getattr(self, name), getattr(other, name)):
                    return False
            return True


def _same(a: "Any", b: "Any") -> bool:
    """Compare two values; a list, an array and bytes of equal elements are equal."""
    whole = (str, bool, int, float, Message)  # on MicroPython a bool is no int
    if isinstance(a, whole) or isinstance(b, whole):
        return bool(a == b)
    if len(a) != len(b):
        return False
    for i in range(len(a)):
        if a[i] != b[i]:
            return False
    return True


def pick(package: str, name: str) -> "Any":
    """Return the class ``name`` of a written package, from its module (see `write_package`)."""
    if "A" <= name[:1] <= "Z":
        try:
            module = __import__(package + "._" + name.lower(), None, None, (name,))
        except ImportError as error:
            raise AttributeError("%s.%s: %s" % (package, name, error))
        return getattr(module, name)
    raise AttributeError(name)


def fault(message: "Any", error: Exception, room: int = -1) -> int:
    """Raise the error to report for an error of packing.

    ``room`` is the number of octets the buffer had for the payload, or -1 without a buffer.
    """
    if NAMES_FIELDS:
        check(message, message._TYPE)
        if room >= 0 and not isinstance(error, MemoryError) and message.cdr_size() > room:
            raise InterfaceError(
                "%s needs %d octets, the buffer has %d" % (message._TYPE, message.cdr_size(), room)
            )
    elif not isinstance(error, MemoryError):
        text = message._TYPE + " does not fit"
        if isinstance(error, (TypeError, AttributeError)):
            raise TypeError(text)
        wrong = InterfaceError(text)
        raise wrong  # a board's build strips the text from a direct `raise Class(text)`
    raise error


def check(message: "Any", where: str) -> None:
    """Check every field, at any depth: TypeError or InterfaceError name the first bad one."""
    names = message._NAMES or message.__slots__
    for i, pair in enumerate(message._FIELDS):
        attribute = names[i]
        place = "%s.%s" % (where, pair[0])
        try:
            value = getattr(message, attribute)
        except AttributeError:
            raise TypeError("%s is not set" % place)
        check_value(value, pair[1], place)


def check_value(value: "Any", kind: str, where: str) -> None:
    """Check one value; ``kind`` is its type as rclpy spells it, ``where`` its place for errors."""
    if kind.startswith("sequence<"):
        inner, _, bound = kind[9:-1].rpartition(", ")
        if inner and not bound.endswith(">"):
            _check_items(value, inner, 0, int(bound), where)
        else:
            _check_items(value, kind[9:-1], 0, 4294967295, where)
    elif kind.endswith("]"):
        inner, _, size = kind[:-1].rpartition("[")
        _check_items(value, inner, int(size), int(size), where)
    elif kind in _RANGES:
        low, high = _RANGES[kind]
        if kind == "octet" and isinstance(value, (bytes, bytearray)) and len(value) == 1:
            return
        try:
            fits = low <= value <= high
            pack("<q" if value < 0 else "<Q", value if fits else 0)
            if isinstance(value, float):
                raise TypeError
        except Exception:
            raise _wrong(value, kind, where)
        if not fits:
            raise InterfaceError("%s: %r is out of range %d to %d" % (where, value, low, high))
    elif kind == "float" or kind == "double":
        try:
            pack("<f" if kind == "float" else "<d", value)
        except OverflowError:
            raise InterfaceError("%s: %r is out of range of a %s" % (where, value, kind))
        except Exception:
            raise _wrong(value, kind, where)
    elif kind.startswith("string") or kind.startswith("wstring"):
        _check_text(value, kind, where)
    elif getattr(value, "_TYPE", "").replace("/msg/", "/").replace("/action/", "/") != kind:
        raise _wrong(value, kind, where)
    else:
        check(value, where)


def _check_items(value: "Any", kind: str, low: int, high: int, where: str) -> None:
    bad = (str, dict, set, Message)  # type: tuple[type, ...]
    if kind not in ("uint8", "octet"):
        bad += (bytes, bytearray)
    try:
        count = -1 if isinstance(value, bad) else len(value)
    except TypeError:
        count = -1
    if count < 0:
        raise _wrong(value, "a sequence of " + kind, where)
    if not low <= count <= high:
        raise InterfaceError(
            "%s: %d elements, %s %d are allowed"
            % (where, count, "only" if low else "at most", high)
        )
    for i, item in enumerate(value):
        check_value(item, kind, "%s[%d]" % (where, i))


def _check_text(value: "Any", kind: str, where: str) -> None:
    if not isinstance(value, str):
        raise _wrong(value, kind, where)
    try:
        length = len(wide(value)) // 4 if kind.startswith("w") else len(utf8(value))
    except ValueError:
        raise InterfaceError("%s: the text has a lone surrogate and cannot be sent" % where)
    if kind.endswith(">"):
        bound = int(kind[kind.find("<") + 1 : -1])
        if length > bound:
            raise InterfaceError("%s: length %d, at most %d are allowed" % (where, length, bound))


def _wrong(value: "Any", kind: str, where: str) -> TypeError:
    name = getattr(value, "_TYPE", type(value).__name__)
    return TypeError("%s: expected %s, got %s" % (where, kind, name))


def utf8(text: "Any") -> bytes:
    """Return the UTF-8 octets of a str."""
    data = utf8_of.get(text)
    if data is None:
        data = str.encode(text)  # TypeError if it is no str
        if len(data) <= _CACHED_LENGTH:
            if len(utf8_of) >= _CACHED_TEXTS:
                utf8_of.clear()
            utf8_of[text] = data
    return data


def wide(text: str) -> bytes:
    """Return the UTF-16 code units of a str as a wstring has them in XCDR1: four octets a unit.

    Both rmw_fastrtps and rmw_cyclonedds write a unit as a uint32, and no terminator.
    """
    out = bytearray()
    for char in text:
        code = ord(char)
        if 0xD800 <= code < 0xE000:
            raise ValueError
        if code > 0xFFFF:
            code -= 0x10000
            out.extend(pack("<II", 0xD800 | code >> 10, 0xDC00 | code & 0x3FF))
        else:
            out.extend(pack("<I", code))
    return bytes(out)


def octet(value: "Any") -> int:
    """Return the int of a ``byte`` field, which may be bytes of length 1 as in rclpy."""
    if isinstance(value, (bytes, bytearray)) and len(value) == 1:
        return value[0]
    return value  # type: ignore[no-any-return]


def octets(value: "Any") -> "bytes | bytearray":
    """Return the elements of a uint8 sequence as bytes; bytes and bytearray are not copied."""
    if isinstance(value, (bytes, bytearray)):
        return value
    if isinstance(value, str):
        raise TypeError
    if isinstance(value, (list, tuple)):
        if value and isinstance(value[0], (bytes, bytearray)):
            value = [octet(item) for item in value]
        if value and not (0 <= min(value) and max(value) <= 255):
            raise ValueError
    return bytes(value)


def wire_bytes(value: "Any") -> "Any":
    """Like `octets`, but a memoryview of octets is not copied."""
    if not isinstance(value, memoryview):
        return octets(value)
    if not _CPYTHON:
        return value
    return value.cast("B") if value.contiguous and value.itemsize == 1 else octets(value)


def put_bytes(buf: "Any", o: int, data: "Any") -> int:
    """Write octets."""
    e = o + len(data)
    if e > len(buf):
        raise ValueError
    buf[o:e] = data
    return e


def put_text(buf: "Any", o: int, data: bytes) -> int:
    """Write the octets of a string and its NUL; the length is written already."""
    e = o + len(data)
    if e >= len(buf):
        raise ValueError
    buf[o:e] = data
    buf[e] = 0
    return e + 1


def put_array(buf: "Any", o: int, values: "Any", code: str, low: int = 0, high: int = 0) -> int:
    """Write numbers of one struct code, none of them outside ``low`` … ``high`` (0, 0: any)."""
    n = len(values)
    if not n:
        return o
    if _CPYTHON and _LITTLE_HOST and isinstance(values, array) and values.typecode == code:
        return put_bytes(buf, o, memoryview(values).cast("B"))
    if isinstance(values, (str, bytes, bytearray, dict)):
        raise TypeError
    if (low or high) and not (low <= min(values) and max(values) <= high):
        raise ValueError
    pack_into("<%d%s" % (n, code), buf, o, *values)
    return o + n * calcsize("<" + code)


def put_texts(buf: "Any", o: int, start: int, values: "Any", bound: int, is_wide: bool) -> int:
    """Write strings one after the other, each with its padding and length."""
    if isinstance(values, str):
        raise TypeError
    for value in values:
        data = wide(value) if is_wide else utf8(value)
        n = len(data) >> 2 if is_wide else len(data)
        if bound and n > bound:
            raise ValueError
        while (o - start) & 3:
            buf[o] = 0
            o += 1
        pack_into("<I", buf, o, n if is_wide else n + 1)
        o = put_bytes(buf, o + 4, data) if is_wide else put_text(buf, o + 4, data)
    return o


def size_texts(o: int, values: "Any", is_wide: bool) -> int:
    """Return the end offset of strings written from ``o`` on."""
    for value in values:
        o = (o + 3 & -4) + 4 + (len(wide(value)) if is_wide else len(utf8(value)) + 1)
    return o


def short(need: int, o: int, end: int) -> InterfaceError:
    """Return the error for bytes that end too early."""
    return InterfaceError("%d octets needed at offset %d, %d are left" % (need, o, end - o))


def long(count: int, bound: int) -> InterfaceError:
    """Return the error for a received length over the type's bound."""
    return InterfaceError("length %d, at most %d are allowed" % (count, bound))


def get_bytes(buf: "Any", o: int, n: int, end: int) -> bytes:
    """Read ``n`` octets."""
    if n > end - o:
        raise short(n, o, end)
    return bytes(buf[o : o + n])


def get_text(buf: "Any", o: int, n: int, end: int, bound: int = 0) -> str:
    """Read a string of ``n`` octets with its NUL; invalid UTF-8 is replaced."""
    if n > end - o:
        raise short(n, o, end)
    if not n:  # some writers send an empty string without its NUL
        return ""
    if buf[o + n - 1]:
        raise InterfaceError("string at offset %d does not end with NUL" % o)
    if bound and n - 1 > bound:
        raise long(n - 1, bound)
    data = bytes(buf[o : o + n - 1])
    try:
        return str(data, "utf-8", "replace")
    except ValueError:  # MicroPython does not support "replace"
        return "".join([chr(c) if c < 128 else "\ufffd" for c in data])


def get_wide(buf: "Any", o: int, n: int, end: int, little: bool, bound: int = 0) -> str:
    """Read ``n`` UTF-16 code units of four octets; lone surrogates and non-units are replaced."""
    if 4 * n > end - o:
        raise short(4 * n, o, end)
    if bound and n > bound:
        raise long(n, bound)
    out = []
    lead = 0
    for code in unpack_from(("<%dI" if little else ">%dI") % n, buf, o):
        if lead and 0xDC00 <= code < 0xE000:
            out.append(chr(0x10000 + ((lead & 0x3FF) << 10 | code & 0x3FF)))
            lead = 0
            continue
        if lead:
            out.append("\ufffd")
        lead = code if 0xD800 <= code < 0xDC00 else 0
        if not lead:
            out.append("\ufffd" if 0xDC00 <= code < 0xE000 or code > 0xFFFF else chr(code))
    if lead:
        out.append("\ufffd")
    return "".join(out)


def get_array(
    buf: "Any", o: int, n: int, end: int, code: str, size: int, little: bool
) -> "array[Any]":
    """Read ``n`` numbers of ``size`` octets into an array of that struct code."""
    if n * size > end - o:
        raise short(n * size, o, end)
    if little == _LITTLE_HOST:
        return array(code, bytes(buf[o : o + n * size]))
    order = "<" if little else ">"
    return array(code, unpack_from("%s%d%s" % (order, n, code), buf, o))


def get_bools(buf: "Any", o: int, n: int, end: int) -> "list[bool]":
    """Read ``n`` bools."""
    return [value != 0 for value in get_bytes(buf, o, n, end)]


def get_texts(
    buf: "Any", o: int, start: int, end: int, n: int, little: bool, bound: int, is_wide: bool
) -> "tuple[list[str], int]":
    """Read ``n`` strings; returns them and the end offset."""
    if n * 4 > end - o:
        raise short(n * 4, o, end)
    out = []
    for _ in range(n):
        o += (start - o) & 3
        if o + 4 > end:
            raise short(4, o, end)
        length = unpack_from("<I" if little else ">I", buf, o)[0]
        o += 4
        if is_wide:
            out.append(get_wide(buf, o, length, end, little, bound))
            o += 4 * length
        else:
            out.append(get_text(buf, o, length, end, bound))
            o += length
    return out, o
