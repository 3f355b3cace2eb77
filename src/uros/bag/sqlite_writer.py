"""Writes an SQLite file with the tables of rosbag2's storage plugin, version 4."""

from __future__ import annotations

import sqlite3
from pathlib import Path
from typing import Final

from . import metadata as bag_metadata
from . import qos_profiles, yaml_text
from .metadata import BagMetadata, TopicMetadata

_TABLES: Final = """
CREATE TABLE schema(schema_version INTEGER PRIMARY KEY, ros_distro TEXT NOT NULL);
CREATE TABLE metadata(
  id INTEGER PRIMARY KEY, metadata_version INTEGER NOT NULL, metadata TEXT NOT NULL);
CREATE TABLE topics(
  id INTEGER PRIMARY KEY, name TEXT NOT NULL, type TEXT NOT NULL,
  serialization_format TEXT NOT NULL, offered_qos_profiles TEXT NOT NULL,
  type_description_hash TEXT NOT NULL);
CREATE TABLE message_definitions(
  id INTEGER PRIMARY KEY, topic_type TEXT NOT NULL, encoding TEXT NOT NULL,
  encoded_message_definition TEXT NOT NULL, type_description_hash TEXT NOT NULL);
CREATE TABLE messages(
  id INTEGER PRIMARY KEY, topic_id INTEGER NOT NULL, timestamp INTEGER NOT NULL,
  data BLOB NOT NULL);
CREATE INDEX timestamp_idx ON messages (timestamp ASC);
"""
_SCHEMA_VERSION: Final = 4
_ROW: Final = 40  # about the bytes of a message beside its data, with its place in the index
_COMMIT: Final = 4 << 20  # bytes of messages between two commits


class SqliteWriter:
    """An SQLite file that is written.

    A write-ahead log makes each commit whole, also if the process is killed within it. It is gone
    when the file is closed, so that readers of any kind can open the file.

    Args:
        path: The file, which must not exist.
        metadata: What is known when the bag begins.

    Raises:
        OSError, sqlite3.Error: The file cannot be created.
    """

    def __init__(self, path: Path, metadata: BagMetadata) -> None:
        open(path, "xb").close()
        self._database = sqlite3.connect(path, isolation_level=None, check_same_thread=False)
        self._database.execute("PRAGMA journal_mode=WAL")
        self._database.execute("PRAGMA synchronous=NORMAL")
        self._database.executescript(f"BEGIN;{_TABLES}COMMIT;")
        self._database.execute(
            "INSERT INTO schema VALUES (?, ?)", (_SCHEMA_VERSION, metadata.ros_distro)
        )
        self._types: set[str] = set()
        self._committed = path.stat().st_size
        self._pending = 0
        self._write_metadata(metadata)

    @property
    def size(self) -> int:
        """About the file's size in bytes."""
        return self._committed + self._pending

    def add_topic(self, topic_id: int, topic: TopicMetadata) -> None:
        """Add a topic under a number of the caller's."""
        self._begin()
        self._database.execute(
            "INSERT INTO topics VALUES (?, ?, ?, ?, ?, ?)",
            (
                topic_id + 1,
                topic.name,
                topic.type_name,
                topic.serialization_format,
                qos_profiles.to_text(topic.offered_qos),
                topic.type_hash,
            ),
        )
        if topic.definition and topic.type_name not in self._types:
            self._types.add(topic.type_name)
            self._database.execute(
                "INSERT INTO message_definitions (topic_type, encoding, encoded_message_definition,"
                " type_description_hash) VALUES (?, ?, ?, ?)",
                (topic.type_name, topic.definition_encoding, topic.definition, topic.type_hash),
            )
        self.flush()

    def write(self, topic_id: int, cdr: bytes, received_ns: int, sent_ns: int) -> None:
        """Write a message; its time of publication is not kept."""
        self._begin()
        self._database.execute(
            "INSERT INTO messages (topic_id, timestamp, data) VALUES (?, ?, ?)",
            (topic_id + 1, received_ns, memoryview(cdr)),
        )
        self._pending += _ROW + len(cdr)
        if self._pending >= _COMMIT:
            self.flush()

    def flush(self) -> None:
        """Commit what was written."""
        if self._database.in_transaction:
            self._database.execute("COMMIT")
            self._committed += self._pending
            self._pending = 0

    def close(self, metadata: BagMetadata) -> None:
        """Write the metadata and end the write-ahead log."""
        try:
            self.flush()
            self._write_metadata(metadata)
            self._database.execute("PRAGMA journal_mode=DELETE")
        finally:
            self._database.close()

    def _begin(self) -> None:
        if not self._database.in_transaction:
            self._database.execute("BEGIN")

    def _write_metadata(self, metadata: BagMetadata) -> None:
        text = yaml_text.dump(bag_metadata.to_mapping(metadata))
        self._database.execute(
            "INSERT INTO metadata (metadata_version, metadata) VALUES (?, ?)",
            (metadata.version, text),
        )
