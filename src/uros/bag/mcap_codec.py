"""The records of MCAP that bags need, to and from bytes (specification: mcap.dev/spec).

Chunks and messages are not among them: `mcap_records` and `mcap_writer` handle these in place.
"""

from __future__ import annotations

import struct
from collections.abc import Mapping
from enum import IntEnum
from typing import Any, Final, NamedTuple

MAGIC: Final = b"\x89MCAP0\r\n"
HEAD: Final = struct.Struct("<BQ")
"""A record's opcode and the length of its body."""
MESSAGE: Final = struct.Struct("<HIQQ")
"""The head of a message: channel, sequence, time received, time sent; its data follow."""
CHUNK: Final = struct.Struct("<QQQI")
"""The head of a chunk: first and last time, size and checksum before compression."""
U16: Final = struct.Struct("<H")
U32: Final = struct.Struct("<I")
U64: Final = struct.Struct("<Q")
INDEX_ENTRY: Final = struct.Struct("<QQ")
"""An entry of a message index: the time, and the place in the chunk's records."""
_CHUNK_INDEX: Final = struct.Struct("<QQQQ")
_STATISTICS: Final = struct.Struct("<QHIIIIQQ")
_FOOTER: Final = struct.Struct("<QQI")
_COUNT: Final = struct.Struct("<HQ")
_GROUP: Final = struct.Struct("<BQQ")


class Opcode(IntEnum):
    """The kinds of records."""

    HEADER = 1
    FOOTER = 2
    SCHEMA = 3
    CHANNEL = 4
    MESSAGE = 5
    CHUNK = 6
    MESSAGE_INDEX = 7
    CHUNK_INDEX = 8
    ATTACHMENT = 9
    ATTACHMENT_INDEX = 10
    STATISTICS = 11
    METADATA = 12
    METADATA_INDEX = 13
    SUMMARY_OFFSET = 14
    DATA_END = 15


class Schema(NamedTuple):
    """The definition of a type."""

    id: int
    name: str
    encoding: str
    data: bytes


class Channel(NamedTuple):
    """A topic."""

    id: int
    schema_id: int
    topic: str
    message_encoding: str
    metadata: Mapping[str, str]


class Statistics(NamedTuple):
    """Numbers of records, and the times of the first and the last message."""

    message_count: int
    schema_count: int
    channel_count: int
    attachment_count: int
    metadata_count: int
    chunk_count: int
    first_ns: int
    last_ns: int
    channel_counts: Mapping[int, int]


class ChunkIndex(NamedTuple):
    """Where a chunk is, its times, and where its message indexes are, by channel."""

    first_ns: int
    last_ns: int
    start: int
    length: int
    index_starts: Mapping[int, int]
    index_length: int
    compression: str
    compressed_size: int
    size: int


class Metadata(NamedTuple):
    """Keys and values with a name."""

    name: str
    metadata: Mapping[str, str]


class MetadataIndex(NamedTuple):
    """Where a metadata record is."""

    offset: int
    length: int
    name: str


class Footer(NamedTuple):
    """Where the summary and the offsets of its groups begin; 0 without them."""

    summary_start: int
    offsets_start: int
    crc: int


Parsed = Schema | Channel | Statistics | ChunkIndex | Metadata | MetadataIndex | Footer


def unpack(opcode: int, body: bytes) -> Parsed:
    """Return a record from its body.

    Raises:
        ValueError: The body is too short, has wrong text, or is of another kind of record.
    """
    take = _Taker(body)
    if opcode == Opcode.SCHEMA:
        return Schema(take.one(U16), take.text(), take.text(), take.octets())
    if opcode == Opcode.CHANNEL:
        return Channel(take.one(U16), take.one(U16), take.text(), take.text(), take.pairs())
    if opcode == Opcode.STATISTICS:
        return Statistics._make((*take.all(_STATISTICS), take.counts()))
    if opcode == Opcode.CHUNK_INDEX:
        front = (*take.all(_CHUNK_INDEX), take.counts(), take.one(U64), take.text())
        return ChunkIndex._make((*front, *take.all(INDEX_ENTRY)))
    if opcode == Opcode.METADATA:
        return Metadata(take.text(), take.pairs())
    if opcode == Opcode.METADATA_INDEX:
        return MetadataIndex._make((*take.all(INDEX_ENTRY), take.text()))
    if opcode == Opcode.FOOTER:
        return Footer(*take.all(_FOOTER))
    raise ValueError(f"a record of kind {opcode}")


def pack(record: Parsed) -> bytes:
    """Return a record with its head."""
    if isinstance(record, Schema):
        body = U16.pack(record.id) + text(record.name) + text(record.encoding) + octets(record.data)
        return framed(Opcode.SCHEMA, body)
    if isinstance(record, Channel):
        head = U16.pack(record.id) + U16.pack(record.schema_id) + text(record.topic)
        return framed(
            Opcode.CHANNEL, head + text(record.message_encoding) + _pairs(record.metadata)
        )
    if isinstance(record, Statistics):
        body = _STATISTICS.pack(*record[:-1]) + _counts(record.channel_counts)
        return framed(Opcode.STATISTICS, body)
    if isinstance(record, ChunkIndex):
        body = _CHUNK_INDEX.pack(*record[:4]) + _counts(record.index_starts)
        body += U64.pack(record.index_length) + text(record.compression)
        body += INDEX_ENTRY.pack(record.compressed_size, record.size)
        return framed(Opcode.CHUNK_INDEX, body)
    if isinstance(record, Metadata):
        return framed(Opcode.METADATA, text(record.name) + _pairs(record.metadata))
    if isinstance(record, MetadataIndex):
        body = INDEX_ENTRY.pack(record.offset, record.length) + text(record.name)
        return framed(Opcode.METADATA_INDEX, body)
    return framed(Opcode.FOOTER, _FOOTER.pack(*record))


def framed(opcode: int, body: bytes) -> bytes:
    """Return a record of its body."""
    return HEAD.pack(opcode, len(body)) + body


def text(value: str) -> bytes:
    """Return text behind its length."""
    return octets(value.encode())


def octets(value: bytes) -> bytes:
    """Return bytes behind their length."""
    return U32.pack(len(value)) + value


def group_offset(opcode: int, start: int, length: int) -> bytes:
    """Return the record that says where a group of the summary is."""
    return framed(Opcode.SUMMARY_OFFSET, _GROUP.pack(opcode, start, length))


def _pairs(pairs: Mapping[str, str]) -> bytes:
    return octets(b"".join(text(key) + text(value) for key, value in pairs.items()))


def _counts(counts: Mapping[int, int]) -> bytes:
    return octets(b"".join(_COUNT.pack(key, value) for key, value in counts.items()))


class _Taker:
    """Takes values from the front of a body; each length is held against what the body has."""

    def __init__(self, body: bytes) -> None:
        self._body = body
        self._at = 0

    def all(self, form: struct.Struct) -> tuple[Any, ...]:
        at = self._advance(form.size)
        return form.unpack_from(self._body, at)

    def one(self, form: struct.Struct) -> int:
        (value,) = self.all(form)
        return int(value)

    def octets(self) -> bytes:
        length = self.one(U32)
        at = self._advance(length)
        return self._body[at : at + length]

    def text(self) -> str:
        return self.octets().decode()

    def pairs(self) -> dict[str, str]:
        take = _Taker(self.octets())
        found = {}
        while take._at < len(take._body):
            key = take.text()
            found[key] = take.text()
        return found

    def counts(self) -> dict[int, int]:
        body = self.octets()
        if len(body) % _COUNT.size:
            raise ValueError("a table ends within an entry")
        return dict(_COUNT.iter_unpack(body))

    def _advance(self, length: int) -> int:
        at = self._at
        if length > len(self._body) - at:
            raise ValueError("a record is too short for its content")
        self._at = at + length
        return at
