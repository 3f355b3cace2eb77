"""Messages with the four-byte CDR encapsulation header, as DDS and bag files carry them.

Runs on MicroPython.
"""

from .errors import InterfaceError

try:
    from typing import Any
except ImportError:
    pass

HEADER = b"\x00\x01\x00\x00"
"""Encapsulation header of messages that uros writes: plain CDR (XCDR1), little endian."""


def to_cdr(msg: "Any") -> bytes:
    """Return the message as an encapsulation header and little-endian CDR.

    Raises:
        TypeError: If a value has the wrong type; the text names the field.
        InterfaceError: If a value does not fit its field; the text names the field.
    """
    size = msg.cdr_size()
    data = bytearray(4 + size)
    data[0:4] = HEADER
    msg.pack_into(data, 4, 4)
    return bytes(data)


def from_cdr(cls: "Any", data: "Any") -> "Any":
    """Return the message of class ``cls`` that ``data`` holds: encapsulation header, then CDR.

    Either endianness is read. Octets after the message are tolerated: writers pad to four.

    Raises:
        InterfaceError: For any other fault in ``data``.
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
