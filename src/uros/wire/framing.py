"""Frames: where one message ends on a line that is only a stream of bytes.

Serial lines (eProsima's stream framing, after HDLC)::

    7E  source  destination  length (2, little endian)  payload  CRC (2, little endian)

Every byte after the 7E that is 7E or 7D goes out as 7D and itself xor 20. The
CRC is CRC-16/ARC (reflected 0x8005, start 0) of the payload. Anything between
frames, such as a board's ``printf``, is skipped.

TCP: a 16-bit little-endian length before each message.
"""

try:
    from typing import Final

    from .cdr import Buffer
except ImportError:  # MicroPython
    pass

FLAG: Final = 0x7E
ESCAPE: Final = 0x7D
XOR: Final = 0x20



def _table() -> "list[int]":
    out = []
    for i in range(256):
        for _ in range(8):
            i = i >> 1 ^ (0xA001 if i & 1 else 0)
        out.append(i)
    return out


_CRC = _table()


def crc16(data: "Buffer", start: int, stop: int, crc: int = 0) -> int:
    """CRC-16/ARC of ``data[start:stop]`` ("123456789" gives 0xBB3D)."""
    table = _CRC
    for i in range(start, stop):
        crc = crc >> 8 ^ table[(crc ^ data[i]) & 0xFF]
    return crc


def frame_size(payload: "Buffer") -> int:
    """Upper bound of a framed payload's length: every byte escaped."""
    return 1 + 2 * (len(payload) + 6)


def frame(payload: "Buffer", source: int, destination: int, out: bytearray) -> int:
    """Frame ``payload`` into ``out`` (at least :func:`frame_size` long); the
    framed length. Boards are 1 and up, the agent is 0."""
    size = len(payload)
    crc = crc16(payload, 0, size)
    out[0] = FLAG
    at = 1
    for i in range(-4, size + 2):
        if i >= size:
            byte = crc & 0xFF if i == size else crc >> 8
        elif i >= 0:
            byte = payload[i]
        elif i == -4:
            byte = source
        elif i == -3:
            byte = destination
        elif i == -2:
            byte = size & 0xFF
        else:
            byte = size >> 8
        if byte == FLAG or byte == ESCAPE:
            out[at] = ESCAPE
            at += 1
            byte ^= XOR
        out[at] = byte
        at += 1
    return at


class Deframer:
    """Finds frames for one address in a stream of bytes, skipping all else.

    Feed it what arrives, in any pieces; take messages out until there are
    none. It never raises: a broken frame is counted in ``crc_errors`` or
    ``skipped`` (bytes) and the search goes on at the next flag.
    """

    __slots__ = (
        "_body",
        "_crc",
        "_escaped",
        "_header",
        "_length",
        "address",
        "crc_errors",
        "foreign",
        "skipped",
        "source",
    )

    def __init__(self, address: int) -> None:
        self.address = address
        self.source = 0  # who sent the last message
        self.crc_errors = 0
        self.foreign = 0  # sound frames for somebody else
        self.skipped = 0  # bytes outside of sound frames
        self._header = -1  # -1: no frame open; else octets after the flag
        self._escaped = False
        self._length = 0
        self._crc = 0
        self._body = bytearray()

    def feed(self, data: "Buffer") -> "list[bytes]":
        """The messages that ``data`` completes, in order."""
        out = []
        for byte in data:
            if byte == FLAG:
                if self._header > 0:  # a frame was cut off
                    self.skipped += self._header + 1
                self._open()
                continue
            if self._header < 0:
                self.skipped += 1
                continue
            if byte == ESCAPE:
                self._escaped = True
                continue
            if self._escaped:
                byte ^= XOR
                self._escaped = False
            at = self._header
            self._header = at + 1
            if at == 0:
                self._crc = byte  # source, kept here until the header is whole
            elif at == 1:
                self._length = byte << 16  # destination, likewise
            elif at == 2:
                self._length |= byte
            elif at == 3:
                self._length |= byte << 8
            elif at < 4 + (self._length & 0xFFFF):
                self._body.append(byte)
            elif at == 4 + (self._length & 0xFFFF):
                self._crc |= byte << 8
            else:
                message = self._close(byte)
                if message is not None:
                    out.append(message)
        return out

    def _open(self) -> None:
        self._header = 0
        self._escaped = False
        self._body = bytearray()

    def _close(self, byte: int) -> "bytes | None":
        size = self._length & 0xFFFF
        source = self._crc & 0xFF
        self._header = -1
        if crc16(self._body, 0, size) != (self._crc >> 8 | byte << 8):
            self.crc_errors += 1
            self.skipped += size + 7
            return None
        if self._length >> 16 != self.address:
            self.foreign += 1
            return None
        self.source = source
        return bytes(self._body)


class LengthDeframer:
    """Finds the messages of a TCP stream: a 16-bit length, then the message."""

    __slots__ = ("_buf",)

    def __init__(self) -> None:
        self._buf = bytearray()

    def feed(self, data: "Buffer") -> "list[bytes]":
        """The messages that ``data`` completes, in order; empty ones are left out."""
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
