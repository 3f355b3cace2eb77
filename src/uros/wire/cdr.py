"""Primitive values in CDR, as XRCE submessages and representations carry them.

A :class:`Reader` walks over bytes from a peer and never past their end; a
:class:`Writer` fills a fixed buffer. Both align a value to its own size,
counted from where they start (XRCE 8.3.4: the start of the payload).
"""

from struct import pack_into, unpack_from

from .errors import DecodeError, EncodeError, LimitError

try:
    from typing import Final, Union

    Buffer = Union[bytes, bytearray, memoryview]
except ImportError:  # MicroPython
    pass

# Longest string, in bytes. The limit prevents this attack: a string length of 4 GiB. A longer name,
# XML document or reference is a fault, too: eProsima's clients hold at most 512 bytes of one.
MAX_STRING: Final = 65536


class Reader:
    """Reads values from ``buf[start:end]`` in order.

    ``little`` is the byte order of everything wider than an octet. Reading
    past ``end`` raises :class:`~uros.wire.errors.DecodeError`.
    """

    __slots__ = ("buf", "end", "little", "offset", "start")

    def __init__(self, buf: "Buffer", start: int, end: int, little: bool = True) -> None:
        self.buf = buf
        self.start = start
        self.offset = start
        self.end = end
        self.little = little

    def _next(self, size: int, align: int) -> int:
        at = self.offset + (-(self.offset - self.start) & (align - 1))
        if at + size > self.end:
            raise DecodeError("truncated: %d bytes wanted, %d left" % (size, max(0, self.end - at)))
        self.offset = at + size
        return at

    def remaining(self) -> int:
        """Return the number of bytes not read yet."""
        return self.end - self.offset

    def u8(self) -> int:
        """Read an unsigned octet."""
        return self.buf[self._next(1, 1)]

    def boolean(self) -> bool:
        """Read one octet, 0 or 1; raise DecodeError for other values."""
        value = self.u8()
        if value > 1:
            raise DecodeError("a boolean is 0 or 1, not %d" % value)
        return value == 1

    def u16(self) -> int:
        """Read an unsigned 16-bit number."""
        at = self._next(2, 2)
        if self.little:
            return self.buf[at] | self.buf[at + 1] << 8
        return self.buf[at] << 8 | self.buf[at + 1]

    def i16(self) -> int:
        """Read a signed 16-bit number."""
        value = self.u16()
        return value - 0x10000 if value & 0x8000 else value

    def u32(self) -> int:
        """Read an unsigned 32-bit number."""
        at = self._next(4, 4)
        value: int = unpack_from("<I" if self.little else ">I", self.buf, at)[0]
        return value

    def i32(self) -> int:
        """Read a signed 32-bit number."""
        at = self._next(4, 4)
        value: int = unpack_from("<i" if self.little else ">i", self.buf, at)[0]
        return value

    def octets(self, size: int) -> bytes:
        """Read ``size`` octets as a copy, without alignment."""
        at = self._next(size, 1)
        return bytes(self.buf[at : at + size])

    def be16(self) -> int:
        """Read a big-endian 16-bit number, such as an id, without alignment."""
        at = self._next(2, 1)
        return self.buf[at] << 8 | self.buf[at + 1]

    def sequence(self, limit: int = MAX_STRING) -> bytes:
        """Read a sequence of octets: a 32-bit length, then the octets."""
        size = self.u32()
        if size > limit:
            raise LimitError("a sequence of %d bytes is over the limit of %d" % (size, limit))
        return self.octets(size)

    def string(self, limit: int = MAX_STRING) -> str:
        """Read a string: a 32-bit length that counts the closing NUL, then UTF-8."""
        raw = self.sequence(limit)
        end = raw.find(b"\x00")
        if end >= 0:
            raw = raw[:end]
        try:
            return raw.decode()
        except ValueError:  # UnicodeError is one
            raise DecodeError("a string that is not UTF-8")


class Writer:
    """Writes values into ``buf`` from ``offset`` on, little endian.

    A value that does not fit its field or the buffer raises
    :class:`~uros.wire.errors.EncodeError`.
    """

    __slots__ = ("buf", "offset", "start")

    def __init__(self, buf: bytearray, offset: int = 0) -> None:
        self.buf = buf
        self.start = offset
        self.offset = offset

    def _next(self, size: int, align: int) -> int:
        at = self.offset
        pad = -(at - self.start) & (align - 1)
        if at + pad + size > len(self.buf):
            raise EncodeError("the message does not fit %d bytes" % len(self.buf))
        for i in range(at, at + pad):
            self.buf[i] = 0
        self.offset = at + pad + size
        return at + pad

    def u8(self, value: int) -> None:
        """Write an unsigned octet."""
        if not 0 <= value <= 0xFF:
            raise EncodeError("%d does not fit an octet" % value)
        self.buf[self._next(1, 1)] = value

    def boolean(self, value: bool) -> None:
        """Write one octet, 0 or 1."""
        self.buf[self._next(1, 1)] = 1 if value else 0

    def u16(self, value: int) -> None:
        """Write an unsigned 16-bit number."""
        if not 0 <= value <= 0xFFFF:
            raise EncodeError("%d does not fit 16 bits" % value)
        pack_into("<H", self.buf, self._next(2, 2), value)

    def i16(self, value: int) -> None:
        """Write a signed 16-bit number."""
        if not -0x8000 <= value <= 0x7FFF:
            raise EncodeError("%d does not fit 16 signed bits" % value)
        self.u16(value & 0xFFFF)

    def u32(self, value: int) -> None:
        """Write an unsigned 32-bit number."""
        if not 0 <= value <= 0xFFFFFFFF:
            raise EncodeError("%d does not fit 32 bits" % value)
        pack_into("<I", self.buf, self._next(4, 4), value)

    def i32(self, value: int) -> None:
        """Write a signed 32-bit number."""
        if not -0x80000000 <= value <= 0x7FFFFFFF:
            raise EncodeError("%d does not fit 32 signed bits" % value)
        pack_into("<i", self.buf, self._next(4, 4), value)

    def octets(self, value: "Buffer") -> None:
        """Write octets, without alignment and without a length."""
        size = len(value)
        at = self._next(size, 1)
        self.buf[at : at + size] = value

    def array(self, value: "Buffer", size: int) -> None:
        """Write octets, of which there must be exactly ``size``."""
        if len(value) != size:
            raise EncodeError("%d octets where %d belong" % (len(value), size))
        self.octets(value)

    def be16(self, value: int) -> None:
        """Write a big-endian 16-bit number without alignment."""
        if not 0 <= value <= 0xFFFF:
            raise EncodeError("%d does not fit 16 bits" % value)
        pack_into(">H", self.buf, self._next(2, 1), value)

    def sequence(self, value: "Buffer") -> None:
        """Write a 32-bit length, then the octets."""
        self.u32(len(value))
        self.octets(value)

    def string(self, value: str) -> None:
        """Write a 32-bit length that counts the closing NUL, then UTF-8, then NUL."""
        try:
            raw = value.encode()
        except ValueError:  # half of a surrogate pair
            raise EncodeError("a string that UTF-8 cannot carry")
        if 0 in raw:
            raise EncodeError("a string with a NUL in it would end there")
        self.sequence(raw + b"\x00")
