"""Records of MCAP files, found within limits.

The lengths that a file states are compared with what it has before anything is allocated, and
decompression ends at the size that a chunk states.
"""

from __future__ import annotations

import zlib
from collections.abc import Iterator
from typing import Any, BinaryIO, Final, NamedTuple

from . import compression
from .errors import BagError
from .mcap_codec import CHUNK, HEAD, U32, U64, Opcode, unpack

MAX_CHUNK: Final = 256 << 20
"""Largest chunk, in bytes, compressed or not. Attack: a short file that expands into any size."""
MAX_RECORD: Final = 1 << 30
"""Largest other record, in bytes: a message without a chunk. Attack: memory."""
_MAX_NAME: Final = 16  # letters of a compression


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
        return unpack(opcode, body)
    except ValueError as error:
        raise Damage(offset, f"a wrong record of kind {opcode} ({error})") from error


def chunk_head(file: BinaryIO, record: Record) -> ChunkHead:
    """Return the head of a chunk.

    Raises:
        Damage: The head states what cannot be.
    """
    fields = CHUNK.size + U32.size
    head = read_at(file, record.body, min(record.length, fields))
    if len(head) < fields:
        raise Damage(record.start, "a chunk is too short")
    start_ns, end_ns, size, crc = CHUNK.unpack_from(head)
    (letters,) = U32.unpack_from(head, CHUNK.size)
    at = record.body + fields
    if letters > _MAX_NAME or at + letters + U64.size > record.end:
        raise Damage(record.start, "a chunk with an unknown compression")
    name = read_at(file, at, letters)
    at += letters
    (length,) = U64.unpack(read_at(file, at, U64.size))
    at += U64.size
    if at + length > record.end or max(size, length) > MAX_CHUNK:
        raise Damage(record.start, f"a chunk of {length} bytes, {size} before compression")
    return ChunkHead(start_ns, end_ns, size, crc, name.decode("latin1"), at, length)


def chunk_data(file: BinaryIO, record: Record) -> bytes:
    """Return the records of a chunk, decompressed.

    Raises:
        Damage: The chunk is damaged, too large, or has an unknown compression.
    """
    head = chunk_head(file, record)
    data = read_at(file, head.data, head.length)
    if head.compression:
        try:
            data = b"".join(compression.decompressed(head.compression, data, head.size + 1))
        except compression.Broken as error:
            raise Damage(record.start, f"a damaged chunk ({error})") from error
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
    opcode, length = HEAD.unpack(
        read_at(file, start, min(HEAD.size, size - start)).ljust(HEAD.size, b"\0")
    )
    if opcode != Opcode.CHUNK:
        raise Damage(start, "no chunk")
    head = chunk_head(file, Record(opcode, start, start + HEAD.size, length))
    data = read_at(file, head.data, min(size - head.data, head.length))
    parts: list[bytes] = []
    if not head.compression:
        return data
    try:
        for part in compression.decompressed(head.compression, data, head.size):
            parts.append(part)
    except compression.Broken:
        pass  # here the file was cut off
    return b"".join(parts)


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
