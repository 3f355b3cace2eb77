"""Messages with the four-byte CDR encapsulation header, as DDS and bag files carry them.

Runs on MicroPython.
"""

from .errors import InterfaceError

try:
    from typing import Any
except ImportError:
    pass

HEADER = b"\x00\x01\x00\x00"
"""Encapsulation of what we write: plain CDR (XCDR1), little endian."""


def to_cdr(msg: "Any") -> bytes:
    """The message as CDR, little endian, behind its encapsulation header.

    A value that does not fit its field raises TypeError or InterfaceError with the field's name.
    """
    size = msg.cdr_size()
    data = bytearray(4 + size)
    data[0:4] = HEADER
    msg.pack_into(data, 4, 4)
    return bytes(data)


def from_cdr(cls: "Any", data: "Any") -> "Any":
    """The message of class ``cls`` in ``data``: encapsulation header, then CDR, either endianness.

    Octets behind the message are tolerated: writers pad to four. Any other fault raises
    InterfaceError.
    """
    if len(data) < 4:
        raise InterfaceError("%s: %d octets are no CDR message" % (cls._TYPE, len(data)))
    if data[0] != 0 or data[1] > 1:
        raise InterfaceError(
            "%s: encapsulation %02x %02x is not supported, only plain CDR (00 00, 00 01)"
            % (cls._TYPE, data[0], data[1])
        )
    try:
        return cls.unpack_from(memoryview(data), 4, 4, len(data), data[1] == 1)[0]
    except InterfaceError as error:
        raise InterfaceError("%s: %s" % (cls._TYPE, error))
