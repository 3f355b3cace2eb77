"""Reads an SQLite file of rosbag2, with tables of version 1 to 4."""

from __future__ import annotations

import os
import sqlite3
from collections.abc import Collection, Iterator
from pathlib import Path
from typing import Any, Final
from urllib.parse import quote

from . import metadata as bag_metadata
from . import qos_profiles, yaml_text
from .errors import BagError
from .metadata import BagMetadata, FileInformation, TopicMetadata
from .storage import BagMessage

_MAGIC: Final = b"SQLite format 3\0"
_MAX_TIME: Final = 2**63 - 1
_TABLES: Final = {"topics", "messages"}
_READ: Final = {*_TABLES, "schema", "metadata", "message_definitions"}


class SqliteReader:
    """An SQLite file of a bag.

    Args:
        path: The file.
        is_damaged: Whether to open a file that is shorter than it states.

    Attributes:
        database: The connection, which cannot write.
        topics: The topics by their numbers.

    Raises:
        BagError: The file cannot be read, or has no messages of a bag.
    """

    def __init__(self, path: str | os.PathLike[str], is_damaged: bool = False) -> None:
        self._path = Path(path)
        self._is_damaged = is_damaged
        try:
            with open(self._path, "rb") as file:
                if file.read(len(_MAGIC)) != _MAGIC:
                    raise BagError(f"{path}: this is no SQLite file")
            self._size = self._path.stat().st_size
        except OSError as error:
            raise BagError(f"{path}: {error.strerror}") from error
        uri = f"file:{quote(str(self._path.resolve()))}?mode=ro"
        try:
            self.database = sqlite3.connect(uri, uri=True, check_same_thread=False)
        except sqlite3.Error as error:
            raise self._fault(error) from error
        try:
            self._open()
        except (sqlite3.Error, ValueError, OverflowError) as error:
            self.database.close()
            raise self._fault(error) from error
        except BaseException:
            self.database.close()
            raise

    @property
    def metadata(self) -> BagMetadata:
        """What the file says of itself, with its own path as the only file."""
        try:
            return self._read_metadata()
        except (sqlite3.Error, ValueError, OverflowError) as error:
            raise self._fault(error) from error

    def close(self) -> None:
        """Close the file."""
        self.database.close()

    def messages(
        self, topics: Collection[str] | None, start_ns: int | None, stop_ns: int | None
    ) -> Iterator[BagMessage]:
        """Yield the messages in the order of their time; ``stop_ns`` is the first not wanted."""
        names = {
            number: topic.name
            for number, topic in self.topics.items()
            if topics is None or topic.name in topics
        }
        chosen = "" if topics is None else f" AND topic_id IN ({','.join(map(str, names))})"
        start = 0 if start_ns is None else max(start_ns, 0)
        last = _MAX_TIME if stop_ns is None else min(stop_ns - 1, _MAX_TIME)
        if start > last:
            return
        left = self._size  # attack: a damaged tree that leads back to itself has no end
        try:
            for number, received, data in self.database.execute(
                "SELECT topic_id, timestamp, data FROM messages WHERE timestamp BETWEEN ? AND ?"
                f"{chosen} ORDER BY timestamp, id",
                (start, last),
            ):
                left -= 1
                if left < 0 or number not in names or not isinstance(data, bytes):
                    raise sqlite3.DatabaseError("the table of messages is damaged")
                if not isinstance(received, int) or received < start:
                    raise sqlite3.DatabaseError("the index of the times is damaged")
                start = received
                yield BagMessage(names[number], data, received, received)
        except (sqlite3.Error, ValueError, OverflowError) as error:
            raise self._fault(error) from error

    def _open(self) -> None:
        self.database.execute("PRAGMA trusted_schema=OFF")
        self.database.execute("PRAGMA cell_size_check=ON")
        if self._is_damaged:
            self.database.execute("PRAGMA writable_schema=ON")  # which ends that check
        self._tables = self._find_tables()
        if not self._tables >= _TABLES:
            raise BagError(f"{self._path}: no tables of a bag in this SQLite file")
        self._definitions = self._read_definitions()
        self.topics = dict(self._read_topics())

    def _find_tables(self) -> set[str]:
        """Return which tables there are. Attack: a view of that name, which never ends."""
        return {
            name
            for name, text in self._rows("SELECT name, sql FROM sqlite_master WHERE type='table'")
            if name in _READ and str(text).upper().startswith("CREATE TABLE")
        }

    def _rows(self, query: str) -> Iterator[tuple[Any, ...]]:
        left = self._size
        for row in self.database.execute(query):
            left -= 1
            if left < 0:
                raise sqlite3.DatabaseError("a table is damaged")
            yield row

    def _read_definitions(self) -> dict[str, tuple[str, str]]:
        if "message_definitions" not in self._tables:
            return {}
        query = "SELECT topic_type, encoding, encoded_message_definition FROM message_definitions"
        return {str(name): (str(enc), str(text)) for name, enc, text in self._rows(query)}

    def _read_topics(self) -> Iterator[tuple[int, TopicMetadata]]:
        columns = {row[1] for row in self._rows("PRAGMA table_info(topics)")}
        offered = "offered_qos_profiles" if "offered_qos_profiles" in columns else "''"
        hashes = "type_description_hash" if "type_description_hash" in columns else "''"
        query = f"SELECT id, name, type, serialization_format, {offered}, {hashes} FROM topics"
        for number, name, type_name, form, profiles, hash_ in self._rows(query):
            encoding, text = self._definitions.get(type_name, ("ros2msg", ""))
            where = f"{self._path}: topic {name}"
            yield (
                number,
                TopicMetadata(
                    str(name),
                    str(type_name),
                    qos_profiles.from_yaml(str(profiles or ""), where),
                    str(hash_ or ""),
                    text,
                    encoding,
                    str(form),
                ),
            )

    def _read_metadata(self) -> BagMetadata:
        counts: dict[int, int] = {}
        first, last = bag_metadata.NO_TIME, 0
        query = "SELECT topic_id, count(*), min(timestamp), max(timestamp) FROM messages GROUP BY 1"
        for number, count, start, end in self._rows(query):
            are_times = isinstance(start, int) and isinstance(end, int) and 0 <= start <= end
            if number not in self.topics or not are_times:
                raise sqlite3.DatabaseError("the table of messages is damaged")
            counts[number] = count
            first, last = min(first, start), max(last, end)
        total = sum(counts.values())
        duration = last - first if total else 0
        metadata = BagMetadata(
            storage="sqlite3",
            starting_time_ns=first,
            duration_ns=duration,
            message_count=total,
            topics=[(topic, counts.get(number, 0)) for number, topic in self.topics.items()],
            files=[FileInformation(self._path.name, first, duration, total)],
        )
        if "metadata" in self._tables:
            for (text,) in self._rows("SELECT metadata FROM metadata ORDER BY id DESC LIMIT 1"):
                where = f"{self._path}: metadata"
                stored = bag_metadata.from_mapping(yaml_text.load(str(text), where), where)
                metadata.custom_data = stored.custom_data
                metadata.ros_distro = stored.ros_distro
        if "schema" in self._tables and not metadata.ros_distro:
            for (name,) in self._rows("SELECT ros_distro FROM schema"):
                metadata.ros_distro = str(name)
        return metadata

    def _fault(self, error: Exception) -> BagError:
        return BagError(
            f"{self._path}: {error}; 'uros bag recover {self._path}' keeps what can be read"
        )
