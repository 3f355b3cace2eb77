"""READ_DATA, and the sample identity of service requests.

WRITE_DATA and DATA are a request (:func:`~uros.wire.session.push_request`)
followed by the sample: plain CDR with no encapsulation header, aligned from
its own first byte, in the byte order of the submessage's flag. A replier's
samples start with a SampleIdentity of 24 octets, a requester's answers with
the request they answer (4 octets).
"""

from .errors import DecodeError, EncodeError

try:
    from typing import Final

    from .cdr import Buffer, Reader, Writer
except ImportError:  # MicroPython
    pass

REQUEST_SIZE: Final = 4
SAMPLE_IDENTITY_SIZE: Final = 24


def push_read_data(
    w: "Writer",
    request_id: int,
    object_id: int,
    stream_id: int,
    data_format: int = 0,
    content_filter: "str | None" = None,
    control: "tuple[int, int, int, int] | None" = None,
) -> None:
    """Write READ_DATA: a request for samples of a datareader, requester or replier.

    ``control`` is (most samples, seconds, bytes a second, ms between samples);
    0xFFFF samples and 0 elsewhere mean no limit, 0 samples stop the reading.
    Without it one sample is asked for.
    """
    w.be16(request_id)
    w.be16(object_id)
    w.u8(stream_id)
    w.u8(data_format)
    w.boolean(content_filter is not None)
    if content_filter is not None:
        w.string(content_filter)
    w.boolean(control is not None)
    if control is not None:
        for value in control:
            w.u16(value)


def pull_read_data(
    r: "Reader",
) -> "tuple[int, int, int, int, str | None, tuple[int, int, int, int] | None]":
    """Read ``(request id, object id, stream id, data format, content filter, control)``."""
    request_id, object_id, stream_id, data_format = r.be16(), r.be16(), r.u8(), r.u8()
    content_filter = r.string() if r.boolean() else None
    control = (r.u16(), r.u16(), r.u16(), r.u16()) if r.boolean() else None
    return request_id, object_id, stream_id, data_format, content_filter, control


def push_sample_identity(buf: bytearray, offset: int, guid: bytes, sequence: int) -> None:
    """Write 16 octets of GUID, then the 64-bit sequence number as high and low words.

    The number may be that of any DDS peer, so a negative one is accepted, too.
    """
    if len(guid) != 16:
        raise EncodeError("a GUID has 16 octets, not %d" % len(guid))
    if not -(1 << 63) <= sequence < 1 << 64:
        raise EncodeError("%d is not a sequence number" % sequence)
    if offset + SAMPLE_IDENTITY_SIZE > len(buf):
        raise EncodeError("the message does not fit %d bytes" % len(buf))
    buf[offset : offset + 16] = guid
    for i in range(4):
        buf[offset + 16 + i] = sequence >> (32 + 8 * i) & 0xFF
        buf[offset + 20 + i] = sequence >> (8 * i) & 0xFF


def pull_sample_identity(
    buf: "Buffer", offset: int, end: int, little: bool = True
) -> "tuple[bytes, int]":
    """Read ``(guid, sequence number)``; ``little`` is the flag of the submessage."""
    if offset + SAMPLE_IDENTITY_SIZE > end:
        raise DecodeError("truncated sample identity")
    high = low = 0
    for i in range(4):
        shift = 8 * i if little else 24 - 8 * i
        high |= buf[offset + 16 + i] << shift
        low |= buf[offset + 20 + i] << shift
    return bytes(buf[offset : offset + 16]), high << 32 | low
