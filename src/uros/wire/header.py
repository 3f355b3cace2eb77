"""Message and submessage headers (XRCE 8.3.2 and 8.3.4)."""

from .cdr import Writer
from .errors import DecodeError, EncodeError

try:
    from typing import Final

    from .cdr import Buffer
except ImportError:  # MicroPython
    pass

SUBHEADER_SIZE: Final = 4
MAX_HEADER_SIZE: Final = 8


def header_size(session_id: int) -> int:
    """Return 4 bytes, or 8 if the session id is below 0x80: the header then has the key."""
    return 4 if session_id & 0x80 else MAX_HEADER_SIZE


def push_header(
    buf: bytearray, session_id: int, stream_id: int, sequence: int, key: int = 0
) -> int:
    """Write a message header at the start of ``buf``; return the offset after it.

    ``key`` is the 32-bit client key, whose highest octet is sent first; it is
    sent only with session ids below 0x80.
    """
    if not (0 <= session_id <= 0xFF and 0 <= stream_id <= 0xFF and 0 <= sequence <= 0xFFFF):
        raise EncodeError("not a header: %d, %d, %d" % (session_id, stream_id, sequence))
    if len(buf) < (4 if session_id & 0x80 else MAX_HEADER_SIZE):
        raise EncodeError("the message does not fit %d bytes" % len(buf))
    buf[0] = session_id
    buf[1] = stream_id
    buf[2] = sequence & 0xFF
    buf[3] = sequence >> 8
    if session_id & 0x80:
        return 4
    if not 0 <= key <= 0xFFFFFFFF:
        raise EncodeError("%d is not a client key" % key)
    buf[4] = key >> 24
    buf[5] = key >> 16 & 0xFF
    buf[6] = key >> 8 & 0xFF
    buf[7] = key & 0xFF
    return 8


def pull_header(buf: "Buffer", end: int) -> "tuple[int, int, int, int | None, int]":
    """Read ``(session id, stream id, sequence, client key or None, offset after it)``.

    Raises:
        DecodeError: ``buf[:end]`` is too short for a message: a header and one submessage header.
    """
    if end < 4 or end < header_size(buf[0]) + SUBHEADER_SIZE:
        raise DecodeError("%d bytes are too few for a message" % end)
    sequence = buf[2] | buf[3] << 8
    if buf[0] & 0x80:
        return buf[0], buf[1], sequence, None, 4
    key = buf[4] << 24 | buf[5] << 16 | buf[6] << 8 | buf[7]
    return buf[0], buf[1], sequence, key, 8


def push_subheader(buf: bytearray, offset: int, kind: int, flags: int, length: int) -> int:
    """Write a submessage header at ``offset`` (a multiple of 4); return the end.

    The length is always little endian. Of one over 65535 the low 16 bits are written,
    as by C clients and agents; the payload then extends to the end of the message.
    """
    if offset + SUBHEADER_SIZE > len(buf):
        raise EncodeError("the message does not fit %d bytes" % len(buf))
    if not (0 <= kind <= 0xFF and 0 <= flags <= 0xFF and length >= 0):
        raise EncodeError("not a submessage header: %d, %d, %d" % (kind, flags, length))
    buf[offset] = kind
    buf[offset + 1] = flags
    buf[offset + 2] = length & 0xFF
    buf[offset + 3] = length >> 8 & 0xFF
    return offset + SUBHEADER_SIZE


def pull_subheader(buf: "Buffer", offset: int, end: int) -> "tuple[int, int, int, int]":
    """Read ``(kind, flags, start, stop)`` of the submessage at ``offset``.

    ``buf[start:stop]`` is its payload. If more than 64 kB follow the header, the
    16-bit length is invalid, and the payload extends to ``end``.

    Raises:
        DecodeError: The header or the payload is incomplete.
    """
    start = offset + SUBHEADER_SIZE
    if start > end:
        raise DecodeError("truncated submessage header")
    stop = start + (buf[offset + 2] | buf[offset + 3] << 8)
    if end - start > 0xFFFF:
        stop = end
    elif stop > end:
        raise DecodeError(
            "submessage %d announces %d bytes, %d are there"
            % (buf[offset], stop - start, end - start)
        )
    return buf[offset], buf[offset + 1], start, stop


class MessageWriter(Writer):
    """Builds one message: a header, then submessages, each aligned to 4.

    ::

        w = MessageWriter(bytearray(512), 0x81, STREAM_NONE, 0)
        w.begin(GET_INFO)
        push_get_info(w, 1, OBJECT_AGENT, INFO_ACTIVITY)
        datagram = w.finish()
    """

    __slots__ = ("_body",)

    def __init__(
        self, buf: bytearray, session_id: int, stream_id: int, sequence: int, key: int = 0
    ) -> None:
        super().__init__(buf, push_header(buf, session_id, stream_id, sequence, key))
        self._body = 0  # where the payload of the open submessage starts; 0: none open

    def begin(self, kind: int, flags: int = 1) -> None:
        """Start a submessage; the values that follow are its payload."""
        self._close()
        # Message and submessage headers are multiples of 4 long, so what is aligned to 4 from the
        # start of the last payload is aligned from the start of the message.
        at = self._next(0, 4)
        self._body = self.start = self.offset = push_subheader(self.buf, at, kind, flags, 0)

    def _close(self) -> None:
        if self._body:
            length = self.offset - self._body
            self.buf[self._body - 2] = length & 0xFF
            self.buf[self._body - 1] = length >> 8 & 0xFF
            self._body = 0

    def finish(self) -> bytes:
        """Return the whole message."""
        self._close()
        return bytes(memoryview(self.buf)[: self.offset])
