"""Writes an MCAP file as rosbag2's storage plugin does: the profile ``ros2``, in chunks."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any, Final

from mcap.writer import CompressionType, Writer

from . import metadata as bag_metadata
from . import qos_profiles, yaml_text
from .errors import BagError
from .mcap_index import METADATA
from .metadata import BagMetadata, TopicMetadata

_COMPRESSIONS: Final = {
    None: CompressionType.NONE,
    "zstd": CompressionType.ZSTD,
    "lz4": CompressionType.LZ4,
}
_HEAD: Final = 31  # bytes of a message record in front of its data
_MAX_TEXT: Final = 2**32 - 1


class McapWriter:
    """An MCAP file that is written.

    Args:
        path: The file, which must not exist.
        compression: None, ``zstd`` or ``lz4``, of each chunk.
        chunk_size: The size of a chunk before compression, in bytes.
        metadata: What is known when the bag begins.

    Raises:
        OSError: The file cannot be created.
    """

    def __init__(
        self, path: Path, compression: str | None, chunk_size: int, metadata: BagMetadata
    ) -> None:
        self._file = open(path, "xb")
        self._compressed = compression is not None
        self._chunk_size = chunk_size
        self._writer: Any = Writer(
            self._file, chunk_size=chunk_size, compression=_COMPRESSIONS[compression]
        )
        self._schemas: dict[str, int] = {}
        self._channels: dict[int, int] = {}
        self._pending = 0
        self._writer.start("ros2", "uros")
        self._write_metadata(metadata)

    @property
    def size(self) -> int:
        """The file's size in bytes; of a chunk that is not compressed yet nothing is counted."""
        return self._file.tell() + (0 if self._compressed else self._pending)

    def add_topic(self, topic_id: int, topic: TopicMetadata) -> None:
        """Add a topic under a number of the caller's."""
        schema = self._schemas.get(topic.type_name)
        if schema is None:
            encoding = topic.definition_encoding if topic.definition else ""
            schema = self._writer.register_schema(
                topic.type_name, encoding, topic.definition.encode()
            )
            self._schemas[topic.type_name] = schema
        self._channels[topic_id] = self._writer.register_channel(
            topic.name,
            topic.serialization_format,
            schema,
            {
                "offered_qos_profiles": qos_profiles.to_text(topic.offered_qos),
                "topic_type_hash": topic.type_hash,
            },
        )

    def write(self, topic_id: int, cdr: bytes, received_ns: int, sent_ns: int) -> None:
        """Write a message."""
        self._writer.add_message(self._channels[topic_id], received_ns, cdr, sent_ns)
        self._pending += _HEAD + len(cdr)
        if self._pending > self._chunk_size:
            self._pending = 0

    def flush(self) -> None:
        """End the chunk and give it to the operating system."""
        self._writer.flush()
        self._pending = 0

    def sync(self) -> None:
        """Wait until what was flushed is on the disk."""
        os.fsync(self._file.fileno())

    def close(self, metadata: BagMetadata) -> None:
        """Write the metadata and the summary."""
        try:
            self._write_metadata(metadata)
            self._writer.finish()
            self._file.flush()
        finally:
            self._file.close()

    def _write_metadata(self, metadata: BagMetadata) -> None:
        text = yaml_text.dump(bag_metadata.to_mapping(metadata))
        if len(text) > _MAX_TEXT:
            raise BagError(f"{self._file.name}: too many topics and files for one record")
        self._writer.add_metadata(METADATA, {"serialized_metadata": text})
