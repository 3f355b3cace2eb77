"""RTPS messages as octets and as submessages (RTPS 9.4).

:func:`read` parses one datagram. What follows a submessage that is not valid is dropped with it
(8.3.4.1); submessages of unknown kinds are skipped. Each ``encode_…`` function returns one
submessage, little endian; :func:`header` begins a message.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterable, Iterator
from typing import Final, NamedTuple

from . import ids, locators
from .kinds import (
    AckNack,
    Data,
    DataFrag,
    Gap,
    Heartbeat,
    HeartbeatFrag,
    InfoDestination,
    InfoReply,
    InfoSource,
    InfoTimestamp,
    NackFrag,
    Submessage,
)
from .locators import Locator

HEADER_SIZE: Final = 20
# Numbers that one bitmap covers (9.4.2.6).
MAX_BITS: Final = 256
# Attack: numbers at the end of 64 bits, beyond which none can be encoded. No writer gets there.
MAX_NUMBER: Final = (1 << 63) - (1 << 20)
_FLAG_LITTLE: Final = 0x01
_FLAG_INLINE_QOS: Final = 0x02  # of DATA and DATA_FRAG
_FLAG_DATA: Final = 0x04  # of DATA
_FLAG_KEY: Final = 0x08  # of DATA
_FLAG_KEY_FRAG: Final = 0x04  # of DATA_FRAG
_FLAG_FINAL: Final = 0x02  # of HEARTBEAT and ACKNACK
_FLAG_LIVELINESS: Final = 0x04  # of HEARTBEAT
_FLAG_INVALIDATE: Final = 0x02  # of INFO_TS
_FLAG_MULTICAST: Final = 0x02  # of INFO_REPLY


class MalformedError(ValueError):
    """A datagram is not RTPS, or a submessage in it is not valid."""


class _Order(NamedTuple):
    """The structs of one byte order."""

    word: struct.Struct
    number: struct.Struct  # high, low
    numbers: struct.Struct  # two of them
    time: struct.Struct
    parameter: struct.Struct  # id, length
    data: struct.Struct  # extra flags, octets to inline QoS, reader, writer, sequence number
    heartbeat: struct.Struct  # reader, writer, first, last, count
    frag: struct.Struct  # first, count, fragment size, sample size
    two_words: struct.Struct


def _order(mark: str) -> _Order:
    forms = ("I", "iI", "iIiI", "II", "HH", "HH4s4siI", "4s4siIiII", "IHHI", "II")
    return _Order(*(struct.Struct(mark + form) for form in forms))


_new = tuple.__new__
_LITTLE: Final = _order("<")
_BIG: Final = _order(">")


def read_header(datagram: memoryview) -> tuple[bytes, bytes, bytes]:
    """Return version, vendor and prefix of a message.

    Raises:
        MalformedError: It is not RTPS 2.
    """
    head = bytes(datagram[:HEADER_SIZE])
    if len(head) < HEADER_SIZE or head[:4] != ids.PROTOCOL or head[4] != 2:
        raise MalformedError("not an RTPS 2 message")
    return head[4:6], head[6:8], head[8:]


def read(datagram: memoryview) -> Iterator[Submessage]:
    """Yield the submessages behind the header.

    Payloads are views of the datagram.

    Raises:
        MalformedError: A submessage is not valid; those before it have been yielded.
    """
    at, end = HEADER_SIZE, len(datagram)
    while at < end:
        if end - at < 4:
            raise MalformedError("octets behind the last submessage")
        kind, flags = datagram[at], datagram[at + 1]
        if flags & _FLAG_LITTLE:
            order, length = _LITTLE, datagram[at + 2] | datagram[at + 3] << 8
        else:
            order, length = _BIG, datagram[at + 2] << 8 | datagram[at + 3]
        at += 4
        stop = at + length
        if not length and kind not in (ids.PAD, ids.INFO_TS):
            stop = end  # the last one may be longer than 65,535 octets (9.4.5.1.3)
        if stop > end:
            raise MalformedError(f"submessage 0x{kind:02x} is longer than its message")
        parse = _PARSERS.get(kind)
        if parse is not None:
            try:
                yield parse(datagram[at:stop], flags, order)
            except (struct.error, IndexError) as error:
                raise MalformedError(f"submessage 0x{kind:02x} is too short") from error
        at = stop


def _sequence(high: int, low: int) -> int:
    number = int((high << 32) + low)
    if number > MAX_NUMBER:
        raise MalformedError(f"sequence number {number}")
    return number


def _bits(body: memoryview, at: int, base: int, order: _Order) -> tuple[int, ...]:
    """The numbers of a bitmap that begins with its length at ``at``."""
    count = order.word.unpack_from(body, at)[0]
    if count > MAX_BITS:
        raise MalformedError("a bitmap of more than 256 bits")
    words = [order.word.unpack_from(body, at + 4 + 4 * i)[0] for i in range((count + 31) // 32)]
    # Padding bits may have any value.
    return tuple(base + i for i in range(count) if words[i >> 5] >> (31 - (i & 31)) & 1)


def _positive(number: int, what: str) -> int:
    if number < 1:
        raise MalformedError(f"{what} {number}")
    return number


def _inline_qos(body: memoryview, at: int, order: _Order) -> tuple[bytes, int]:
    """A parameter list with its sentinel, and where it ends."""
    start = at
    while True:
        pid, length = order.parameter.unpack_from(body, at)
        at += 4
        if pid == ids.PID_SENTINEL:
            return bytes(body[start:at]), at
        if length % 4 or at + length > len(body):
            raise MalformedError("inline QoS is longer than its submessage")
        at += length


def _parse_data(body: memoryview, flags: int, order: _Order) -> Data:
    _, to_qos, reader, writer, high, low = order.data.unpack_from(body)
    number = (high << 32) + low
    if not 0 < number <= MAX_NUMBER:
        raise MalformedError(f"sequence number {number}")
    at = 4 + to_qos
    if to_qos < 16:
        raise MalformedError("inline QoS begins inside the header of DATA")
    qos = None
    if flags & _FLAG_INLINE_QOS:
        qos, at = _inline_qos(body, at, order)
    payload = None
    is_key = bool(flags & _FLAG_KEY)
    if flags & (_FLAG_DATA | _FLAG_KEY):
        if flags & _FLAG_DATA and is_key:
            raise MalformedError("DATA with a sample and a key")
        if at > len(body):
            raise MalformedError("DATA without its payload")
        payload = body[at:]
    # As Data(...), which is a call of Python: for each sample.
    return _new(Data, (reader, writer, number, qos, payload, is_key, order is _LITTLE))


def _parse_data_frag(body: memoryview, flags: int, order: _Order) -> DataFrag:
    _, to_qos, reader, writer, high, low = order.data.unpack_from(body)
    number = _positive(_sequence(high, low), "sequence number")
    first, count, size, total = order.frag.unpack_from(body, 20)
    at = 4 + to_qos
    if to_qos < 28:
        raise MalformedError("inline QoS begins inside the header of DATA_FRAG")
    last = (total + size - 1) // size if size else 0
    if not size or not total or not count or first < 1 or first + count - 1 > last:
        raise MalformedError(f"fragments {first} to {first + count - 1} of {last}")
    qos = None
    if flags & _FLAG_INLINE_QOS:
        qos, at = _inline_qos(body, at, order)
    wanted = min(size * count, total - size * (first - 1))
    if len(body) - at < wanted:
        raise MalformedError("DATA_FRAG is shorter than its fragments")
    return DataFrag(
        reader, writer, number, first, count, size, total, qos,
        body[at : at + wanted], bool(flags & _FLAG_KEY_FRAG), order is _LITTLE,
    )  # fmt: skip


def _parse_heartbeat(body: memoryview, flags: int, order: _Order) -> Heartbeat:
    reader, writer, first_high, first_low, last_high, last_low, count = order.heartbeat.unpack_from(
        body
    )
    first, last = (first_high << 32) + first_low, (last_high << 32) + last_low
    if first < 1 or last < first - 1 or max(first, last) > MAX_NUMBER:
        raise MalformedError(f"a heartbeat of {first} to {last}")
    return Heartbeat(
        reader, writer, first, last, count,
        bool(flags & _FLAG_FINAL), bool(flags & _FLAG_LIVELINESS),
    )  # fmt: skip


def _parse_acknack(body: memoryview, flags: int, order: _Order) -> AckNack:
    # Fast DDS begins with base 0, which the specification does not allow.
    base = _sequence(*order.number.unpack_from(body, 8))
    if base < 0:
        raise MalformedError(f"an acknowledgement of {base}")
    missing = _bits(body, 16, base, order)
    count = order.word.unpack_from(body, 20 + _bitmap_size(body, 16, order))[0]
    return AckNack(
        bytes(body[:4]), bytes(body[4:8]), base, missing, count, bool(flags & _FLAG_FINAL)
    )


def _bitmap_size(body: memoryview, at: int, order: _Order) -> int:
    return int((order.word.unpack_from(body, at)[0] + 31) // 32 * 4)


def _parse_gap(body: memoryview, flags: int, order: _Order) -> Gap:
    words = order.numbers.unpack_from(body, 8)
    start, base = _positive(_sequence(*words[:2]), "a gap from"), _sequence(*words[2:])
    if base < start:
        raise MalformedError(f"a gap from {start} to {base}")
    return Gap(bytes(body[:4]), bytes(body[4:8]), start, base, _bits(body, 24, base, order))


def _parse_nack_frag(body: memoryview, flags: int, order: _Order) -> NackFrag:
    number = _positive(_sequence(*order.number.unpack_from(body, 8)), "sequence number")
    base = _positive(order.word.unpack_from(body, 16)[0], "fragment")
    missing = _bits(body, 20, base, order)
    count = order.word.unpack_from(body, 24 + _bitmap_size(body, 20, order))[0]
    return NackFrag(bytes(body[:4]), bytes(body[4:8]), number, missing, count)


def _parse_heartbeat_frag(body: memoryview, flags: int, order: _Order) -> HeartbeatFrag:
    number = _positive(_sequence(*order.number.unpack_from(body, 8)), "sequence number")
    last = _positive(order.word.unpack_from(body, 16)[0], "fragment")
    count = order.word.unpack_from(body, 20)[0]
    return HeartbeatFrag(bytes(body[:4]), bytes(body[4:8]), number, last, count)


def _parse_info_ts(body: memoryview, flags: int, order: _Order) -> InfoTimestamp:
    if flags & _FLAG_INVALIDATE:
        return InfoTimestamp(None)
    seconds, fraction = order.time.unpack_from(body)
    if (seconds, fraction) == (0xFFFFFFFF, 0xFFFFFFFF):  # TIME_INVALID
        return InfoTimestamp(None)
    return _new(InfoTimestamp, (seconds * 1_000_000_000 + (fraction * 1_000_000_000 >> 32),))


def _octets(body: memoryview, start: int, stop: int) -> bytes:
    if len(body) < stop:
        raise MalformedError("a submessage is too short")
    return bytes(body[start:stop])


def _parse_info_dst(body: memoryview, flags: int, order: _Order) -> InfoDestination:
    if len(body) < ids.PREFIX_SIZE:
        raise MalformedError("a submessage is too short")
    return _new(InfoDestination, (bytes(body[: ids.PREFIX_SIZE]),))


def _parse_info_src(body: memoryview, flags: int, order: _Order) -> InfoSource:
    return InfoSource(_octets(body, 4, 6), _octets(body, 6, 8), _octets(body, 8, 20))


def _parse_info_reply(body: memoryview, flags: int, order: _Order) -> InfoReply:
    unicast, at = _locator_list(body, 0, order)
    if flags & _FLAG_MULTICAST:
        _locator_list(body, at, order)
    return InfoReply(unicast)


def _locator_list(body: memoryview, at: int, order: _Order) -> tuple[tuple[Locator, ...], int]:
    count = order.word.unpack_from(body, at)[0]
    at += 4
    if count > (len(body) - at) // locators.SIZE:
        raise MalformedError("more locators than octets for them")
    stop = at + locators.SIZE * count
    little = order is _LITTLE
    found = (
        locators.decode(bytes(body[i : i + locators.SIZE]), little)
        for i in range(at, stop, locators.SIZE)
    )
    return tuple(one for one in found if one is not None and not one.is_multicast), stop


def _parse_info_reply_ip4(body: memoryview, flags: int, order: _Order) -> InfoReply:
    address, port = order.two_words.unpack_from(body)
    if flags & _FLAG_MULTICAST:
        order.two_words.unpack_from(body, 8)
    # As the number that the address is (9.4.5.15); a locator of the other form has its octets.
    raw = struct.pack(">iI12xI", locators.UDPV4, port, address)
    found = locators.decode(raw, False)
    return InfoReply(() if found is None or found.is_multicast else (found,))


_PARSERS: Final[dict[int, Callable[[memoryview, int, _Order], Submessage]]] = {
    ids.DATA: _parse_data,
    ids.DATA_FRAG: _parse_data_frag,
    ids.HEARTBEAT: _parse_heartbeat,
    ids.ACKNACK: _parse_acknack,
    ids.GAP: _parse_gap,
    ids.NACK_FRAG: _parse_nack_frag,
    ids.HEARTBEAT_FRAG: _parse_heartbeat_frag,
    ids.INFO_TS: _parse_info_ts,
    ids.INFO_DST: _parse_info_dst,
    ids.INFO_SRC: _parse_info_src,
    ids.INFO_REPLY: _parse_info_reply,
    ids.INFO_REPLY_IP4: _parse_info_reply_ip4,
}


# --- encoding, little endian ------------------------------------------------------------------

_SUBMESSAGE: Final = struct.Struct("<BBH")
_DATA: Final = struct.Struct("<BBHHH4s4siI")
_DATA_FRAG: Final = struct.Struct("<BBHHH4s4siIIHHI")
_HEARTBEAT: Final = struct.Struct("<BBH4s4siIiII")
_RANGE: Final = struct.Struct("<BBH4s4siIiI")
_BASED: Final = struct.Struct("<BBH4s4siI")
_INFO_TS: Final = struct.Struct("<BBHII")
_TIMED_DATA: Final = struct.Struct(_INFO_TS.format + _DATA.format[1:])
_MAX_LENGTH: Final = 0xFFFF


def header(prefix: bytes) -> bytes:
    """Return the header of a message from the participant with this GUID prefix."""
    return ids.PROTOCOL + ids.VERSION + ids.VENDOR + prefix


def _halves(number: int) -> tuple[int, int]:
    return number >> 32, number & 0xFFFFFFFF


def encode_data(
    reader: bytes, writer: bytes, number: int, payload: bytes | memoryview | None,
    inline_qos: bytes = b"", is_key: bool = False,
) -> bytes:  # fmt: skip
    """Return a DATA submessage.

    Args:
        reader: Entity id of the reader, zeros for all.
        writer: Entity id of the writer.
        number: The sequence number.
        payload: The sample or key with its encapsulation header; None without one.
        inline_qos: A parameter list, little endian, with its sentinel; empty without one.
        is_key: Whether the payload is a key.
    """
    flags = _FLAG_LITTLE
    body: bytes | memoryview = b""
    if payload is not None:
        flags |= _FLAG_KEY if is_key else _FLAG_DATA
        body = payload if len(payload) % 4 == 0 else _padded(bytes(payload))
    if inline_qos:
        flags |= _FLAG_INLINE_QOS
    length = 20 + len(inline_qos) + len(body)
    if length > _MAX_LENGTH:
        length = 0  # reaches to the end of the message
    head = _DATA.pack(
        ids.DATA, flags, length, 0, 16, reader, writer, number >> 32, number & 0xFFFFFFFF
    )
    return head + inline_qos + body


def _padded(payload: bytes) -> bytes:
    """A payload with the octets to a multiple of four; their number is in its options.

    The options are the last two octets of the encapsulation header (XTypes 7.6.3.1.2).
    """
    padding = -len(payload) % 4
    if padding and len(payload) > 3:
        payload = payload[:3] + bytes([payload[3] & ~3 | padding]) + payload[4:]
    return payload + bytes(padding)


def unpadded(payload: bytes) -> bytes:
    """Return a payload without the octets of padding that its options announce."""
    padding = payload[3] & 3 if len(payload) > 3 else 0
    if not padding or len(payload) < 4 + padding:
        return payload
    return payload[:3] + bytes([payload[3] & ~3]) + payload[4:-padding]


def encode_data_frag(
    reader: bytes, writer: bytes, number: int, first: int, fragment_size: int, sample_size: int,
    payload: bytes | memoryview, inline_qos: bytes = b"",
) -> bytes:  # fmt: skip
    """Return a DATA_FRAG submessage with the fragment ``first``.

    Args:
        reader: Entity id of the reader, zeros for all.
        writer: Entity id of the writer.
        number: The sequence number of the sample.
        first: The number of the fragment, from 1.
        fragment_size: Octets of each fragment but the last.
        sample_size: Octets of the whole sample.
        payload: The fragment.
        inline_qos: A parameter list, little endian, with its sentinel; empty without one.
    """
    flags = _FLAG_LITTLE | (_FLAG_INLINE_QOS if inline_qos else 0)
    body = bytes(payload)
    body += bytes(-len(body) % 4)
    return (
        _DATA_FRAG.pack(
            ids.DATA_FRAG, flags, 32 + len(inline_qos) + len(body), 0, 28, reader, writer,
            *_halves(number), first, 1, fragment_size, sample_size,
        )
        + inline_qos
        + body
    )  # fmt: skip


def encode_heartbeat(
    reader: bytes, writer: bytes, first: int, last: int, count: int, final: bool = False,
    liveliness: bool = False,
) -> bytes:  # fmt: skip
    """Return a HEARTBEAT submessage; ``last`` is ``first - 1`` where the writer has nothing."""
    flags = _FLAG_LITTLE | (_FLAG_FINAL if final else 0) | (_FLAG_LIVELINESS if liveliness else 0)
    return _HEARTBEAT.pack(
        ids.HEARTBEAT, flags, 28, reader, writer, *_halves(first), *_halves(last), count
    )


def _bitmap(base: int, numbers: Iterable[int]) -> tuple[int, bytes]:
    """The number of bits and the words for numbers from ``base`` to below ``base + 256``."""
    bits = 0
    words = [0] * (MAX_BITS // 32)
    for number in numbers:
        offset = number - base
        if not 0 <= offset < MAX_BITS:
            raise ValueError(f"{number} is not within {MAX_BITS} of {base}")
        words[offset >> 5] |= 1 << (31 - (offset & 31))
        bits = max(bits, offset + 1)
    return bits, struct.pack(f"<{(bits + 31) // 32}I", *words[: (bits + 31) // 32])


def encode_acknack(
    reader: bytes, writer: bytes, base: int, missing: Iterable[int], count: int, final: bool = False
) -> bytes:
    """Return an ACKNACK submessage: all below ``base`` is there, ``missing`` is not.

    Raises:
        ValueError: A missing number is below ``base``, or 256 or more above it.
    """
    bits, words = _bitmap(base, missing)
    return (
        _BASED.pack(
            ids.ACKNACK, _FLAG_LITTLE | (_FLAG_FINAL if final else 0), 24 + len(words),
            reader, writer, *_halves(base),
        )
        + struct.pack("<I", bits) + words + struct.pack("<I", count)
    )  # fmt: skip


def encode_gap(
    reader: bytes, writer: bytes, start: int, base: int, irrelevant: Iterable[int] = ()
) -> bytes:
    """Return a GAP submessage: ``start`` to below ``base``, and ``irrelevant``, are left out.

    Raises:
        ValueError: A number is below ``base``, or 256 or more above it.
    """
    bits, words = _bitmap(base, irrelevant)
    return (
        _RANGE.pack(
            ids.GAP, _FLAG_LITTLE, 28 + len(words), reader, writer,
            *_halves(start), *_halves(base),
        )
        + struct.pack("<I", bits) + words
    )  # fmt: skip


def encode_nack_frag(
    reader: bytes, writer: bytes, number: int, missing: Iterable[int], count: int
) -> bytes:
    """Return a NACK_FRAG submessage for fragments within 256 of the first missing one.

    Raises:
        ValueError: Nothing is missing, or a number is 256 or more above the first.
    """
    missing = sorted(missing)
    if not missing:
        raise ValueError("no fragment is missing")
    bits, words = _bitmap(missing[0], missing)
    return (
        _BASED.pack(
            ids.NACK_FRAG, _FLAG_LITTLE, 28 + len(words), reader, writer, *_halves(number)
        )
        + struct.pack("<II", missing[0], bits) + words + struct.pack("<I", count)
    )  # fmt: skip


def encode_info_ts(time_ns: int | None) -> bytes:
    """Return an INFO_TS submessage; None says that the time is unknown.

    Seconds have 32 bits without a sign (RTPS 2.5, 9.3.2.1): they wrap in 2106, and before 1970.
    """
    if time_ns is None:
        return _SUBMESSAGE.pack(ids.INFO_TS, _FLAG_LITTLE | _FLAG_INVALIDATE, 0)
    seconds, ns = divmod(time_ns, 1_000_000_000)
    # Rounded up, so that reading it gives the same nanosecond.
    fraction = -(-(ns << 32) // 1_000_000_000)
    return _INFO_TS.pack(ids.INFO_TS, _FLAG_LITTLE, 8, seconds & 0xFFFFFFFF, fraction)


def encode_timed_data(writer: bytes, number: int, payload: bytes, time_ns: int) -> bytes:
    """Return INFO_TS and DATA of a sample for all readers, in one step.

    Args:
        writer: Entity id of the writer.
        number: The sequence number.
        payload: The sample with its encapsulation header, below 64 kB.
        time_ns: When it was written, in ns since 1970.
    """
    seconds, ns = divmod(time_ns, 1_000_000_000)
    body = payload if len(payload) % 4 == 0 else _padded(payload)
    return _TIMED_DATA.pack(
        ids.INFO_TS, _FLAG_LITTLE, 8, seconds & 0xFFFFFFFF, -(-(ns << 32) // 1_000_000_000),
        ids.DATA, _FLAG_LITTLE | _FLAG_DATA, 20 + len(body), 0, 16, ids.ENTITY_UNKNOWN, writer,
        number >> 32, number & 0xFFFFFFFF,
    ) + body  # fmt: skip


def encode_info_dst(prefix: bytes) -> bytes:
    """Return an INFO_DST submessage."""
    return _SUBMESSAGE.pack(ids.INFO_DST, _FLAG_LITTLE, ids.PREFIX_SIZE) + prefix
