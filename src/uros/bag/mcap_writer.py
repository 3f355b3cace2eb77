"""Writes an MCAP file as rosbag2's storage plugin does: the profile ``ros2``, in chunks."""

from __future__ import annotations

import sys
import zlib
from array import array
from collections import Counter
from pathlib import Path
from typing import Final

from . import compression as compressions
from . import metadata as bag_metadata
from . import qos_profiles, yaml_text
from .errors import BagError
from .mcap_codec import (
    CHUNK,
    HEAD,
    MAGIC,
    MESSAGE,
    U16,
    U64,
    Channel,
    ChunkIndex,
    Footer,
    Metadata,
    MetadataIndex,
    Opcode,
    Parsed,
    Schema,
    Statistics,
    framed,
    group_offset,
    octets,
    pack,
    text,
)
from .mcap_index import METADATA
from .metadata import BagMetadata, TopicMetadata

_LIBRARY: Final = "uros"
_PROFILE: Final = "ros2"
_MAX_TEXT: Final = 2**32 - 1
_DATA_END: Final = framed(Opcode.DATA_END, bytes(4))  # without a checksum of the file
_CRC_SIZE: Final = 4


class _Chunk:
    """A chunk that is not written yet: its records, and their places by channel."""

    def __init__(self) -> None:
        self.records = bytearray()
        self.indexes: dict[int, array[int]] = {}
        self.first_ns = 2**64 - 1
        self.last_ns = 0


class McapWriter:
    """An MCAP file that is written.

    Args:
        path: The file, which must not exist.
        compression: None, ``zstd`` or ``lz4``, of each chunk.
        chunk_size: The size of a chunk before compression, in bytes.
        metadata: What is known when the bag begins.

    Raises:
        BagError: The package of the compression is missing.
        OSError: The file cannot be created.
    """

    def __init__(
        self, path: Path, compression: str | None, chunk_size: int, metadata: BagMetadata
    ) -> None:
        self._compress = compressions.compressor(compression)
        self._compression = compression or ""
        self._chunk_size = chunk_size
        self._file = open(path, "xb")
        self._size = 0
        self._chunk = _Chunk()
        self._schemas: list[Schema] = []
        self._channels: list[Channel] = []
        self._numbers: dict[int, int] = {}
        self._chunks: list[ChunkIndex] = []
        self._metadata: list[MetadataIndex] = []
        self._counts: Counter[int] = Counter()
        self._append(MAGIC + framed(Opcode.HEADER, text(_PROFILE) + text(_LIBRARY)))
        self._write_metadata(metadata)

    @property
    def size(self) -> int:
        """The file's size in bytes; of a chunk that is to be compressed nothing is counted."""
        return self._size + (0 if self._compression else len(self._chunk.records))

    def add_topic(self, topic_id: int, topic: TopicMetadata) -> None:
        """Add a topic under a number of the caller's."""
        schema = next((one for one in self._schemas if one.name == topic.type_name), None)
        if schema is None:
            encoding = topic.definition_encoding if topic.definition else ""
            definition = topic.definition.encode()
            schema = Schema(len(self._schemas) + 1, topic.type_name, encoding, definition)
            self._schemas.append(schema)
            self._chunk.records += pack(schema)
        channel = Channel(
            len(self._channels) + 1,
            schema.id,
            topic.name,
            topic.serialization_format,
            {
                "offered_qos_profiles": qos_profiles.to_text(topic.offered_qos),
                "topic_type_hash": topic.type_hash,
            },
        )
        self._channels.append(channel)
        self._numbers[topic_id] = channel.id
        self._chunk.records += pack(channel)

    def write(self, topic_id: int, cdr: bytes, received_ns: int, sent_ns: int) -> None:
        """Write a message."""
        chunk, number = self._chunk, self._numbers[topic_id]
        records = chunk.records
        index = chunk.indexes.get(number)
        if index is None:
            index = chunk.indexes[number] = array("Q")
        index.append(received_ns)
        index.append(len(records))
        if received_ns < chunk.first_ns:
            chunk.first_ns = received_ns
        if received_ns > chunk.last_ns:
            chunk.last_ns = received_ns
        records += HEAD.pack(Opcode.MESSAGE, MESSAGE.size + len(cdr))
        records += MESSAGE.pack(number, 0, received_ns, sent_ns)
        records += cdr
        if len(records) > self._chunk_size:
            self._end_chunk()

    def flush(self) -> None:
        """End the chunk and give it to the operating system."""
        self._end_chunk()
        self._file.flush()

    def close(self, metadata: BagMetadata) -> None:
        """Write the metadata and the summary."""
        try:
            self._end_chunk()
            self._write_metadata(metadata)
            self._append(_DATA_END)
            self._write_summary()
            self._append(MAGIC)
            self._file.flush()
        finally:
            self._file.close()

    def _append(self, data: bytes | bytearray) -> None:
        self._file.write(data)
        self._size += len(data)

    def _end_chunk(self) -> None:
        """Write the chunk and its indexes, if there is a message in it."""
        chunk = self._chunk
        if not chunk.indexes:
            return
        self._chunk = _Chunk()
        records = bytes(chunk.records)
        data = self._compress(records)
        head = CHUNK.pack(chunk.first_ns, chunk.last_ns, len(records), zlib.crc32(records))
        head += text(self._compression) + U64.pack(len(data))
        start = self._size
        self._append(HEAD.pack(Opcode.CHUNK, len(head) + len(data)) + head)
        self._append(data)
        length = self._size - start
        starts = {}
        for number, index in chunk.indexes.items():
            starts[number] = self._size
            self._counts[number] += len(index) // 2
            self._append(framed(Opcode.MESSAGE_INDEX, U16.pack(number) + octets(_little(index))))
        self._chunks.append(
            ChunkIndex(
                chunk.first_ns,
                chunk.last_ns,
                start,
                length,
                starts,
                self._size - start - length,
                self._compression,
                len(data),
                len(records),
            )
        )

    def _write_metadata(self, metadata: BagMetadata) -> None:
        stored = yaml_text.dump(bag_metadata.to_mapping(metadata))
        if len(stored) > _MAX_TEXT:
            raise BagError(f"{self._file.name}: too many topics and files for one record")
        record = pack(Metadata(METADATA, {"serialized_metadata": stored}))
        self._metadata.append(MetadataIndex(self._size, len(record), METADATA))
        self._append(record)

    def _write_summary(self) -> None:
        """Write schemas, channels, statistics and indexes, where each group is, and the footer."""
        start = self._size
        statistics = Statistics(
            sum(self._counts.values()),
            len(self._schemas),
            len(self._channels),
            0,
            len(self._metadata),
            len(self._chunks),
            min((chunk.first_ns for chunk in self._chunks), default=0),
            max((chunk.last_ns for chunk in self._chunks), default=0),
            self._counts,
        )
        groups: list[tuple[Opcode, list[Parsed]]] = [
            (Opcode.SCHEMA, [*self._schemas]),
            (Opcode.CHANNEL, [*self._channels]),
            (Opcode.STATISTICS, [statistics]),
            (Opcode.CHUNK_INDEX, [*self._chunks]),
            (Opcode.METADATA_INDEX, [*self._metadata]),
        ]
        crc, offsets = 0, b""
        for opcode, records in groups:
            data = b"".join(map(pack, records))
            if data:
                offsets += group_offset(opcode, self._size, len(data))
                crc = zlib.crc32(data, crc)
                self._append(data)
        crc = zlib.crc32(offsets, crc)
        footer = pack(Footer(start, self._size, 0))
        crc = zlib.crc32(footer[:-_CRC_SIZE], crc)
        self._append(offsets + pack(Footer(start, self._size, crc)))


def _little(numbers: array[int]) -> bytes:
    """Return numbers in little endian, whatever this machine has."""
    if sys.byteorder == "big":
        numbers = array("Q", numbers)
        numbers.byteswap()
    return numbers.tobytes()
