"""What an MCAP file has: schemas, channels, counts, and the blocks with messages.

A *block* is a chunk, or in a file without chunks a run of messages of about a mebibyte. All this is
in the summary at the end of the file, or found by reading the whole file.
"""

from __future__ import annotations

import os
from array import array
from collections import Counter
from collections.abc import Iterator, Mapping
from typing import Any, BinaryIO, Final, NamedTuple

from .errors import BagError
from .mcap_codec import HEAD, MAGIC, MESSAGE, Channel, ChunkIndex, Metadata, Opcode, Schema
from .mcap_records import (
    MAX_RECORD,
    Damage,
    Record,
    chunk_data,
    parse,
    parse_body,
    read_at,
    walk,
)

METADATA: Final = "rosbag2"
"""The name of the metadata record that rosbag2 writes."""
MAX_TIME: Final = 2**63 - 1
_RUN: Final = 1 << 20
_FOOTER: Final = HEAD.size + 20


class Block(NamedTuple):
    """A chunk, or a run of messages without one; the times of its first and last message."""

    start_ns: int
    end_ns: int
    record: Record
    is_chunk: bool


class McapIndex:
    """What is known of a file.

    Attributes:
        schemas: Schemas by their numbers.
        channels: Channels by their numbers.
        counts: Numbers of messages by channel.
        blocks: The blocks in the order of the file.
        first_ns: The time of the earliest message, 0 if there is none.
        last_ns: The time of the latest message.
        stored: The last metadata record of rosbag2, or None.
    """

    def __init__(self) -> None:
        self.schemas: dict[int, Schema] = {}
        self.channels: dict[int, Channel] = {}
        self.counts: Counter[int] = Counter()
        self.blocks: list[Block] = []
        self.first_ns = 0
        self.last_ns = 0
        self.stored: Mapping[str, str] | None = None

    def define(self, record: Any) -> None:
        """Take a schema, a channel or rosbag2's metadata; ignore others.

        Args:
            record: A record of `mcap_codec`.
        """
        if isinstance(record, Schema):
            self.schemas.setdefault(record.id, record)
        elif isinstance(record, Channel):
            self.channels.setdefault(record.id, record)
        elif isinstance(record, Metadata) and record.name == METADATA:
            self.stored = record.metadata

    def add_block(self, record: Record, is_chunk: bool, data: bytes) -> int:
        """Take what a block defines, and its messages.

        Args:
            record: The chunk, or the place of the run.
            is_chunk: Whether it is a chunk.
            data: Its records.

        Returns:
            The number of its messages.

        Raises:
            Damage: One of its records is wrong.
        """
        for opcode, place, length in records_in(data, record.start):
            if opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
                self.define(parse_body(opcode, data[place : place + length], record.start))
        counts: Counter[int] = Counter()
        times = array("Q")
        for channel, received, _ in messages_in(data, record.start):
            counts[channel] += 1
            times.append(received)
        if not times:
            return 0
        block = Block(min(times), max(times), record, is_chunk)
        if not self.counts:
            self.first_ns, self.last_ns = block.start_ns, block.end_ns
        self.first_ns = min(self.first_ns, block.start_ns)
        self.last_ns = max(self.last_ns, block.end_ns)
        self.counts.update(counts)
        self.blocks.append(block)
        return len(times)


def read_index(file: BinaryIO) -> McapIndex:
    """Read what a whole file has.

    Raises:
        Damage: The file is cut off or damaged.
        BagError: This is no MCAP file.
    """
    size = os.fstat(file.fileno()).st_size
    if read_at(file, 0, min(size, len(MAGIC))) != MAGIC:
        raise BagError("this is no MCAP file")
    end = size - len(MAGIC) - _FOOTER
    if end < len(MAGIC) or read_at(file, size - len(MAGIC), len(MAGIC)) != MAGIC:
        raise Damage(size, "the file is cut off")
    record = next(walk(file, end, size - len(MAGIC)))
    if record.opcode != Opcode.FOOTER:
        raise Damage(end, "no footer")
    footer = parse(file, record)
    if footer.summary_start:
        if not len(MAGIC) <= footer.summary_start <= end:
            raise Damage(end, "a wrong footer")
        index = _read_summary(file, footer.summary_start, end)
        if index is not None:
            return index
    return _scan(file, end)


def _read_summary(file: BinaryIO, start: int, end: int) -> McapIndex | None:
    """Return what the summary says; None if it has not all that is needed."""
    index = McapIndex()
    statistics = None
    for record in walk(file, start, end):
        if record.opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
            index.define(parse(file, record))
        elif record.opcode == Opcode.STATISTICS:
            statistics = parse(file, record)
        elif record.opcode == Opcode.METADATA_INDEX:
            entry = parse(file, record)
            if entry.name == METADATA and entry.offset < start:
                index.define(parse(file, next(walk(file, entry.offset, start))))
        elif record.opcode == Opcode.CHUNK_INDEX:
            index.blocks.append(_indexed(file, parse(file, record), record.start, start))
    if (
        statistics is None
        or len(index.channels) < statistics.channel_count
        or len(index.blocks) != statistics.chunk_count
        or (statistics.message_count and not statistics.chunk_count)
        or sum(statistics.channel_counts.values()) != statistics.message_count
    ):
        return None
    index.counts.update(statistics.channel_counts)
    index.first_ns, index.last_ns = statistics.first_ns, statistics.last_ns
    if not index.first_ns <= index.last_ns <= MAX_TIME:
        raise Damage(start, "wrong times in the statistics")
    return index


def _indexed(file: BinaryIO, entry: ChunkIndex, offset: int, end: int) -> Block:
    at = entry.start
    if at + entry.length <= end:
        record = next(walk(file, at, at + entry.length), None)
        if record is not None and record.opcode == Opcode.CHUNK:
            return Block(entry.first_ns, entry.last_ns, record, True)
    raise Damage(offset, "an index of a chunk that is not there")


def _scan(file: BinaryIO, end: int) -> McapIndex:
    """Read the whole file."""
    index = McapIndex()
    run: list[Record] = []

    def end_run() -> None:
        if run:
            start, stop = run[0].start, run[-1].end
            run.clear()
            index.add_block(run_record(start, stop), False, read_at(file, start, stop - start))

    for record in walk(file, len(MAGIC), end):
        if record.opcode == Opcode.DATA_END:
            break
        if record.opcode == Opcode.MESSAGE:
            if record.length > MAX_RECORD:
                raise Damage(record.start, f"a message of {record.length} bytes")
            run.append(record)
            if record.end - run[0].start >= _RUN:
                end_run()
            continue
        end_run()
        if record.opcode == Opcode.CHUNK:
            index.add_block(record, True, chunk_data(file, record))
        elif record.opcode in (Opcode.SCHEMA, Opcode.CHANNEL, Opcode.METADATA):
            index.define(parse(file, record))
    end_run()
    return index


def run_record(start: int, end: int) -> Record:
    """Return the place of a run of messages: all from ``start`` to ``end``, in bytes."""
    return Record(Opcode.MESSAGE, start, start, end - start)


def records_in(data: bytes, offset: int) -> Iterator[tuple[int, int, int]]:
    """Yield kind, place of the body and length of the records in a block.

    Args:
        data: The block.
        offset: Its place in the file, for the error.

    Raises:
        Damage: A record would end behind the block.
    """
    at, end = 0, len(data)
    while at < end:
        if at + HEAD.size > end:
            raise Damage(offset, "a chunk ends within a record")
        opcode, length = HEAD.unpack_from(data, at)
        at += HEAD.size
        if length > end - at:
            raise Damage(offset, "a chunk ends within a record")
        yield opcode, at, length
        at += length


def messages_in(data: bytes, offset: int) -> Iterator[tuple[int, int, int]]:
    """Yield channel, time and place of the record of the messages in a block.

    Raises:
        Damage: A record would end behind the block, or a message is too short.
    """
    for opcode, body, length in records_in(data, offset):
        if opcode == Opcode.MESSAGE:
            if length < MESSAGE.size:
                raise Damage(offset, "a message is too short")
            channel, _, received, _ = MESSAGE.unpack_from(data, body)
            if received > MAX_TIME:
                raise Damage(offset, f"a message of the time {received}")
            yield channel, received, body - HEAD.size
