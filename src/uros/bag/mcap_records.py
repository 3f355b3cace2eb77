"""Records of MCAP files: found within limits, parsed by the library ``mcap``.

The library believes the lengths that a file states, and allocates that much. Here each length is
first compared with what the file has, and decompression ends at the size that a chunk states.
"""

from __future__ import annotations

import io
import struct
import zlib
from collections.abc import Iterator
from typing import Any, BinaryIO, Final, NamedTuple

import lz4.frame
import zstandard
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import (
    Channel,
    ChunkIndex,
    Footer,
    MessageIndex,
    Metadata,
    MetadataIndex,
    Schema,
    Statistics,
)

from .errors import BagError

MAGIC: Final = b"\x89MCAP0\r\n"
HEAD: Final = struct.Struct("<BQ")
"""A record's opcode and the length of its body."""
MESSAGE: Final = struct.Struct("<HIQQ")
"""The head of a message: channel, sequence, time received, time sent; its data follow."""
MAX_CHUNK: Final = 256 << 20
"""Largest chunk, in bytes, compressed or not. Attack: a short file that expands into any size."""
MAX_RECORD: Final = 1 << 30
"""Largest other record, in bytes: a message without a chunk. Attack: memory."""
_CHUNK: Final = struct.Struct("<QQQII")
_LENGTH: Final = struct.Struct("<Q")
_STEP: Final = 1 << 20
_PARSERS: Final[dict[int, Any]] = {
    Opcode.SCHEMA: Schema,
    Opcode.CHANNEL: Channel,
    Opcode.STATISTICS: Statistics,
    Opcode.CHUNK_INDEX: ChunkIndex,
    Opcode.MESSAGE_INDEX: MessageIndex,
    Opcode.METADATA: Metadata,
    Opcode.METADATA_INDEX: MetadataIndex,
    Opcode.FOOTER: Footer,
}


class Damage(BagError):
    """A record is cut off or wrong. `offset` is its place in the file, in bytes."""

    def __init__(self, offset: int, fault: str) -> None:
        super().__init__(f"at byte {offset}: {fault}")
        self.offset = offset


class Record(NamedTuple):
    """A record's place in its file: `start` of its head, `body` of what follows, in bytes."""

    opcode: int
    start: int
    body: int
    length: int

    @property
    def end(self) -> int:
        """The place behind the record."""
        return self.body + self.length


class ChunkHead(NamedTuple):
    """The fields of a chunk in front of its records; `data` is where those begin in the file."""

    start_ns: int
    end_ns: int
    size: int
    crc: int
    compression: str
    data: int
    length: int


def walk(file: BinaryIO, start: int, end: int) -> Iterator[Record]:
    """Yield the records between two places of a file.

    Raises:
        Damage: A record would end behind ``end``.
    """
    while start < end:
        head = read_at(file, start, min(HEAD.size, end - start))
        if len(head) < HEAD.size:
            raise Damage(start, "a record is cut off")
        opcode, length = HEAD.unpack(head)
        body = start + HEAD.size
        if not opcode or length > end - body:
            raise Damage(start, "a record is cut off, or this is no record")
        yield Record(opcode, start, body, length)
        start = body + length


def parse(file: BinaryIO, record: Record) -> Any:
    """Return a record of another kind than chunks and messages as the class of ``mcap.records``.

    Raises:
        Damage: The record has a wrong content.
    """
    if record.length > MAX_RECORD:
        raise Damage(record.start, f"a record of {record.length} bytes")
    return parse_body(record.opcode, read_at(file, record.body, record.length), record.start)


def parse_body(opcode: int, body: bytes, offset: int) -> Any:
    """Return a record of which the body is given; ``offset`` is its place, for the error."""
    try:
        return _PARSERS[Opcode(opcode)].read(ReadDataStream(io.BytesIO(body)))
    except (McapError, struct.error, ValueError, OverflowError) as error:
        raise Damage(offset, f"a wrong record of kind {opcode} ({error})") from error


def chunk_head(file: BinaryIO, record: Record) -> ChunkHead:
    """Return the head of a chunk.

    Raises:
        Damage: The head states what cannot be.
    """
    head = read_at(file, record.body, min(record.length, _CHUNK.size))
    if len(head) < _CHUNK.size:
        raise Damage(record.start, "a chunk is too short")
    start_ns, end_ns, size, crc, letters = _CHUNK.unpack(head)
    at = record.body + _CHUNK.size
    if letters > 16 or at + letters + _LENGTH.size > record.end:
        raise Damage(record.start, "a chunk with an unknown compression")
    compression = read_at(file, at, letters)
    at += letters
    (length,) = _LENGTH.unpack(read_at(file, at, _LENGTH.size))
    at += _LENGTH.size
    if at + length > record.end or max(size, length) > MAX_CHUNK:
        raise Damage(record.start, f"a chunk of {length} bytes, {size} before compression")
    return ChunkHead(start_ns, end_ns, size, crc, compression.decode("latin1"), at, length)


def chunk_data(file: BinaryIO, record: Record) -> bytes:
    """Return the records of a chunk, decompressed.

    Raises:
        Damage: The chunk is damaged, too large, or has an unknown compression.
    """
    head = chunk_head(file, record)
    data = read_at(file, head.data, head.length)
    if head.compression:
        data = _decompress(data, head, record.start)
    if len(data) != head.size or (head.crc and zlib.crc32(data) != head.crc):
        raise Damage(record.start, "a damaged chunk: its checksum is wrong")
    return data


def cut_chunk_data(file: BinaryIO, start: int, size: int) -> bytes:
    """Return what is left of the records of a chunk at which the file was cut off.

    Args:
        file: The file.
        start: The place of the chunk's record.
        size: The size of the file, in bytes.

    Raises:
        Damage: This is no chunk, or it is cut off within its head.
    """
    opcode, length = HEAD.unpack(read_at(file, start, min(HEAD.size, size - start)).ljust(9, b"\0"))
    if opcode != Opcode.CHUNK:
        raise Damage(start, "no chunk")
    head = chunk_head(file, Record(opcode, start, start + HEAD.size, length))
    data = read_at(file, head.data, min(size - head.data, head.length))
    parts: list[bytes] = []
    if not head.compression:
        return data
    try:
        parts.extend(_decompressed(data, head, start))
    except _BROKEN:
        pass  # what came before the cut
    return b"".join(parts)


# What the decompressors raise, which lz4 and zstandard have their own classes for in part.
_BROKEN: Final = (zstandard.ZstdError, RuntimeError, EOFError, ValueError, MemoryError)


def _decompress(data: bytes, head: ChunkHead, offset: int) -> bytes:
    try:
        return b"".join(_decompressed(data, head, offset))
    except Damage:
        raise
    except _BROKEN as error:
        raise Damage(offset, f"a damaged chunk ({error})") from error


def _decompressed(data: bytes, head: ChunkHead, offset: int) -> Iterator[bytes]:
    """Yield the data of a chunk in parts; at most a byte more than it states."""
    stream: Any
    if head.compression == "zstd":
        stream = zstandard.ZstdDecompressor().stream_reader(data)
    elif head.compression == "lz4":
        stream = lz4.frame.LZ4FrameFile(io.BytesIO(data))
    else:
        raise Damage(offset, f"the compression {head.compression!r:.20}; uros has zstd and lz4")
    with stream:
        left = head.size + 1
        while left and (part := stream.read(min(left, _STEP))):
            yield part
            left -= len(part)


def read_at(file: BinaryIO, at: int, length: int) -> bytes:
    """Return bytes of a file.

    Raises:
        Damage: The file has fewer.
    """
    file.seek(at)
    data = file.read(length)
    if len(data) < length:
        raise Damage(at, "the file ends")
    return data
