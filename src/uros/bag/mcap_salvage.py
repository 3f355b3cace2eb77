"""Finds what can still be read of an MCAP file that was cut off or damaged.

Records are followed as long as each leads to another one. Behind a damaged place the next chunk is
searched, which its head proves: its lengths agree with each other.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import BinaryIO, Final, NamedTuple

from .errors import BagError
from .mcap_codec import HEAD, MAGIC, MESSAGE, Opcode
from .mcap_index import McapIndex, read_index, records_in
from .mcap_records import (
    MAX_RECORD,
    Damage,
    Record,
    chunk_data,
    chunk_head,
    cut_chunk_data,
    parse,
    parse_body,
    read_at,
)

_KNOWN: Final = frozenset(map(int, Opcode))
_MAX_TIME: Final = 2**63 - 1
# A chunk, or a message without one: the opcode and a length below a tebibyte.
_LIKELY: Final = re.compile(rb"[\x05\x06].{5}\0\0\0", re.DOTALL)
_LENGTHS: Final[dict[int, int]] = {Opcode.DATA_END: 4, Opcode.FOOTER: 20}
_WINDOW: Final = 1 << 20
# The sizes of a message index' head and of an entry, in bytes.
_INDEX_HEAD: Final = 6
_INDEX_ENTRY: Final = 16


class Loss(NamedTuple):
    """What cannot be read: `size` bytes from `start` on, and the messages known to be in there."""

    start: int
    size: int
    messages: int


class SalvagedMessage(NamedTuple):
    """A message with its channel's number."""

    channel: int
    cdr: bytes
    received_ns: int
    sent_ns: int


class McapSalvage:
    """The readable part of a file.

    Args:
        file: The file.
        size: Its size in bytes.

    Attributes:
        index: Schemas, channels and metadata as far as they were found.
        losses: What was lost, when `messages` has ended.
        compression: The compression of the first whole chunk, None without one.
    """

    def __init__(self, file: BinaryIO, size: int) -> None:
        self.index = McapIndex()
        self.losses: list[Loss] = []
        self.compression: str | None = None
        self._file = file
        self._size = size
        self._unknown = 0  # messages of channels that were lost

    def messages(self) -> Iterator[SalvagedMessage]:
        """Yield the messages in the order of the file; their channels are then in `index`."""
        self._take_summary()
        at = anchor = min(len(MAGIC), self._size)  # what lies before the anchor is certain
        while at < self._size:
            record = self._record(at)
            if record is not None and record.end <= self._size:
                if record.opcode in (Opcode.DATA_END, Opcode.FOOTER):
                    break
                yield from self._of_record(record)
                certain = record.opcode in (Opcode.CHUNK, Opcode.MESSAGE, Opcode.MESSAGE_INDEX)
                anchor = record.end if certain else record.start
                at = record.end
                continue
            if record is not None and record.opcode == Opcode.CHUNK:
                yield from self._of_cut_chunk(record)
                break
            found = self._find(anchor if anchor < at else at + 1)
            if found is None:
                self.losses.append(Loss(at, self._size - at, 0))
                break
            self.losses.append(Loss(min(at, found), abs(found - at), 0))
            at = anchor = found
        if self._unknown:
            self.losses.append(Loss(self._size, 0, self._unknown))

    def _take_summary(self) -> None:
        """Take the channels of the summary, if there is one: those of a damaged chunk are there."""
        try:
            known = read_index(self._file)
        except (BagError, OSError):
            return
        self.index.schemas.update(known.schemas)
        self.index.channels.update(known.channels)
        self.index.stored = known.stored

    def _record(self, at: int) -> Record | None:
        """Return the record at a place; None if there is none. A chunk may end behind the file."""
        if self._size - at < HEAD.size:
            return None
        opcode, length = HEAD.unpack(read_at(self._file, at, HEAD.size))
        record = Record(opcode, at, at + HEAD.size, length)
        if opcode == Opcode.CHUNK:
            try:
                head = chunk_head(self._file, record)
            except Damage:
                return None
            return record if head.data + head.length == record.end else None
        if record.end > self._size or opcode not in _KNOWN or length > MAX_RECORD:
            return None
        if opcode == Opcode.MESSAGE:
            return record if self._is_message(record) else None
        return record if _LENGTHS.get(opcode, length) == length else None

    def _is_message(self, record: Record) -> bool:
        """Whether a message is of a known channel, and followed by a record or the end."""
        if record.length < MESSAGE.size:
            return False
        channel, _, received, _ = MESSAGE.unpack(read_at(self._file, record.body, MESSAGE.size))
        if channel not in self.index.channels or received > _MAX_TIME:
            return False
        return record.end == self._size or read_at(self._file, record.end, 1)[0] in _KNOWN

    def _of_record(self, record: Record) -> Iterator[SalvagedMessage]:
        if record.opcode == Opcode.CHUNK:
            try:
                data = chunk_data(self._file, record)
                list(records_in(data, record.start))
            except Damage:
                self.losses.append(Loss(record.start, record.end - record.start, 0))
                return
            if self.compression is None:
                self.compression = chunk_head(self._file, record).compression or None
            yield from self._of_data(data, record.start)
        elif record.opcode == Opcode.MESSAGE:
            length = record.end - record.start
            yield from self._of_data(read_at(self._file, record.start, length), record.start)
        elif record.opcode == Opcode.MESSAGE_INDEX:
            self._count_lost(record)
        elif record.opcode in (Opcode.SCHEMA, Opcode.CHANNEL, Opcode.METADATA):
            try:
                self.index.define(parse(self._file, record))
            except Damage:
                self.losses.append(Loss(record.start, record.end - record.start, 0))

    def _of_cut_chunk(self, record: Record) -> Iterator[SalvagedMessage]:
        """Yield the whole messages of the chunk within which the file ends."""
        self.losses.append(Loss(record.start, self._size - record.start, 0))
        try:
            yield from self._of_data(
                cut_chunk_data(self._file, record.start, self._size), record.start
            )
        except Damage:
            return  # where the chunk is cut off

    def _of_data(self, data: bytes, offset: int) -> Iterator[SalvagedMessage]:
        for opcode, body, length in records_in(data, offset):
            if opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
                self.index.define(parse_body(opcode, data[body : body + length], offset))
            elif opcode == Opcode.MESSAGE and length >= MESSAGE.size:
                channel, _, received, sent = MESSAGE.unpack_from(data, body)
                if channel not in self.index.channels or received > _MAX_TIME:
                    self._unknown += 1
                    continue
                cdr = data[body + MESSAGE.size : body + length]
                yield SalvagedMessage(channel, cdr, received, min(sent, _MAX_TIME))

    def _count_lost(self, index: Record) -> None:
        """Count the messages of a damaged chunk by its index, which follows."""
        if not self.losses:
            return
        start, size, messages = self.losses[-1]
        if start + size == index.start:
            count = (index.length - _INDEX_HEAD) // _INDEX_ENTRY
            self.losses[-1] = Loss(start, size + index.end - index.start, messages + count)

    def _find(self, start: int) -> int | None:
        """Return the place of the next record that is certain."""
        overlap = HEAD.size
        while start < self._size:
            data = read_at(self._file, start, min(_WINDOW + overlap, self._size - start))
            for match in _LIKELY.finditer(data):
                record = self._record(start + match.start())
                if record is not None and record.end <= self._size:
                    return record.start
            start += _WINDOW
        return None
