"""Framing: message boundaries on byte streams.

Serial lines (eProsima's stream framing, after HDLC)::

    7E  source  destination  length (2, little endian)  payload  CRC (2, little endian)

After the 7E, a byte 7E or 7D is sent as 7D followed by the byte xor 20. The
CRC is CRC-16/ARC (reflected 0x8005, start 0) of the payload. Anything between
frames, such as a board's ``printf``, is skipped.

TCP: a 16-bit little-endian length before each message.
"""

from array import array

from .errors import EncodeError

try:
    from typing import Final

    from .cdr import Buffer
except ImportError:  # MicroPython
    pass

FLAG: Final = 0x7E
ESCAPE: Final = 0x7D
XOR: Final = 0x20

# Octets of a frame between its flag and the payload: two addresses and the length.
_HEADER: Final = 4
# The same with the CRC behind the payload.
_OVERHEAD: Final = 6


# An array takes a quarter of the memory of a list on a board.
_CRC = array("H", bytes(512))
for _i in range(256):
    _crc = _i
    for _ in range(8):
        _crc = _crc >> 1 ^ (0xA001 if _crc & 1 else 0)
    _CRC[_i] = _crc


def crc16(data: "Buffer", start: int, stop: int, crc: int = 0) -> int:
    """Return CRC-16/ARC of ``data[start:stop]`` ("123456789" gives 0xBB3D)."""
    table = _CRC
    for i in range(start, stop):
        crc = crc >> 8 ^ table[(crc ^ data[i]) & 0xFF]
    return crc


def frame_size(payload: "Buffer | int") -> int:
    """Return the largest framed length of a payload, which is given itself or by its length."""
    size = payload if isinstance(payload, int) else len(payload)
    return 1 + 2 * (size + _OVERHEAD)


def frame(payload: "Buffer", source: int, destination: int, out: bytearray, size: int = -1) -> int:
    """Write a frame of ``payload``, or of its first ``size`` bytes.

    Args:
        payload: The message.
        source: Address of the sender: boards are 1 and up, the agent is 0.
        destination: Address of the receiver.
        out: The buffer, at least :func:`frame_size` long.
        size: Length of the message; all of ``payload`` by default.

    Returns:
        The framed length.

    Raises:
        EncodeError: The payload is over 65535 bytes, or ``out`` is too short.
    """
    if size < 0:
        size = len(payload)
    if size > 0xFFFF or not (0 <= source <= 0xFF and 0 <= destination <= 0xFF):
        raise EncodeError("no frame for %d bytes from %d to %d" % (size, source, destination))
    if len(out) < 1 + 2 * (size + _OVERHEAD):
        raise EncodeError("a frame may not fit %d bytes" % len(out))
    crc = crc16(payload, 0, size)
    out[0] = FLAG
    at = _escape(out, 1, source)
    at = _escape(out, at, destination)
    at = _escape(out, at, size & 0xFF)
    at = _escape(out, at, size >> 8)
    for i in range(size):
        byte = payload[i]
        if byte == FLAG or byte == ESCAPE:
            out[at] = ESCAPE
            at += 1
            byte ^= XOR
        out[at] = byte
        at += 1
    at = _escape(out, at, crc & 0xFF)
    return _escape(out, at, crc >> 8)


def _escape(out: bytearray, at: int, byte: int) -> int:
    if byte == FLAG or byte == ESCAPE:
        out[at] = ESCAPE
        at += 1
        byte ^= XOR
    out[at] = byte
    return at + 1


class Deframer:
    """Parser of frames for one address in a byte stream; all else is skipped.

    Feed it received bytes, in any pieces. It never raises and holds at most one
    frame (64 kB). A flag byte never occurs within a frame, so the parser
    finds the next valid frame after any input.

    Every byte fed is either part of a valid frame, or of the incomplete one, or
    counted in ``skipped``; a whole frame that is skipped because of
    its CRC also counts in ``crc_errors``, a valid one for another address in
    ``foreign``.
    """

    __slots__ = (
        "_escaped",
        "_octets",
        "_size",
        "_wanted",
        "address",
        "crc_errors",
        "foreign",
        "skipped",
        "source",
    )

    def __init__(self, address: int) -> None:
        self.address = address
        self.source = 0  # address of the sender of the last message
        self.crc_errors = 0
        self.foreign = 0  # valid frames for another address
        self.skipped = 0  # bytes outside of valid frames
        self._octets = bytearray()  # the open frame after its flag, unescaped
        self._wanted = 0  # length of _octets at which it is evaluated; 0: no frame is open
        self._escaped = False  # the last byte was an escape
        self._size = 0  # bytes of the open frame as received, escapes and flag included

    def feed(self, data: "Buffer") -> "list[bytes]":
        """Return the messages that ``data`` completes, in order."""
        data = bytes(data)  # other buffers do not have find() on every port
        out: "list[bytes]" = []
        at = 0
        end = len(data)
        while at < end:
            flag = data.find(b"\x7e", at)
            stop = flag if flag >= 0 else end
            if self._wanted:
                at = self._fill(data, at, stop, out)
            self.skipped += stop - at
            at = stop
            if flag >= 0:
                self.skipped += self._size  # a frame that was cut off
                self._octets = bytearray()
                self._wanted = _HEADER
                self._escaped = False
                self._size = 1
                at += 1
        return out

    def _fill(self, data: bytes, at: int, stop: int, out: "list[bytes]") -> int:
        """Add ``data[at:stop]``, which contains no flag, to the open frame.

        Returns:
            The offset behind the bytes added; less than ``stop`` if the frame ends before.
        """
        octets = self._octets
        while at < stop:
            if self._escaped:
                octets.append(data[at] ^ XOR)
                self._escaped = False
                size = 1
            elif data[at] == ESCAPE:
                self._escaped = True
                size = 1
            else:
                size = data.find(b"\x7d", at, min(stop, at + self._wanted - len(octets))) - at
                if size < 0:
                    size = min(stop - at, self._wanted - len(octets))
                octets.extend(data[at : at + size])
            at += size
            self._size += size
            if len(octets) == self._wanted:
                if self._wanted > _HEADER:
                    self._close(out)
                    break
                self._wanted = _OVERHEAD + (octets[2] | octets[3] << 8)
        return at

    def _close(self, out: "list[bytes]") -> None:
        octets = self._octets
        stop = self._wanted - 2
        if crc16(octets, _HEADER, stop) != octets[stop] | octets[stop + 1] << 8:
            self.crc_errors += 1
            self.skipped += self._size
        elif octets[1] != self.address:
            self.foreign += 1
        else:
            self.source = octets[0]
            out.append(bytes(memoryview(octets)[_HEADER:stop]))
        self._octets = bytearray()
        self._wanted = 0
        self._escaped = False
        self._size = 0


class LengthDeframer:
    """Parser of a TCP stream of messages, each after its 16-bit length.

    It holds at most one incomplete message. All input is read as lengths and
    messages: a TCP stream has no point to resynchronize at.
    """

    __slots__ = ("_buf",)

    def __init__(self) -> None:
        self._buf = bytearray()

    def feed(self, data: "Buffer") -> "list[bytes]":
        """Return the messages that ``data`` completes, in order, without empty ones."""
        buf = self._buf
        buf.extend(data)
        out = []
        at = 0
        while len(buf) - at >= 2:
            size = buf[at] | buf[at + 1] << 8
            if len(buf) - at - 2 < size:
                break
            if size:
                out.append(bytes(memoryview(buf)[at + 2 : at + 2 + size]))
            at += 2 + size
        if at:
            self._buf = bytearray(memoryview(buf)[at:])
        return out
