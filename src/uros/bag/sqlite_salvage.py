"""Finds what can still be read of an SQLite file that was cut off or damaged.

Rows are read in the order of their numbers. Where the table is damaged, the next readable row is
searched with growing steps. Messages are numbered without gaps, so that gaps are what was lost.
"""

from __future__ import annotations

import sqlite3
from collections.abc import Iterator
from pathlib import Path
from typing import Final

from .errors import BagError
from .metadata import BagMetadata, TopicMetadata
from .sqlite_reader import SqliteReader

_MAX_TIME: Final = 2**63 - 1
_MAX_ROW: Final = 2**62


class SqliteSalvage:
    """The readable part of a file.

    Args:
        path: The file.

    Attributes:
        topics: The topics by their numbers.
        metadata: The metadata as far as they can be read.
        lost: The messages that are known to be lost, when `messages` has ended.

    Raises:
        BagError: Not even the topics can be read.
    """

    def __init__(self, path: Path) -> None:
        self._reader = SqliteReader(path, is_damaged=True)
        self._path = path
        self.topics: dict[int, TopicMetadata] = self._reader.topics
        self.lost = 0
        try:
            self.metadata = self._reader.metadata
        except BagError:
            self.metadata = BagMetadata(storage="sqlite3")

    def close(self) -> None:
        """Close the file."""
        self._reader.close()

    def messages(self) -> Iterator[tuple[int, bytes, int]]:
        """Yield topic, message and time of the messages in the order in which they were written."""
        last = 0
        start: int | None = 1
        while start is not None:
            try:
                for row, topic, received, data in self._rows(start):
                    if row <= last:
                        raise sqlite3.DatabaseError("a row comes twice")
                    self.lost += row - last - 1
                    last = row
                    is_time = isinstance(received, int) and 0 <= received <= _MAX_TIME
                    if topic in self.topics and isinstance(data, bytes) and is_time:
                        yield topic, data, received
                    else:
                        self.lost += 1
                return
            except (sqlite3.Error, ValueError, OverflowError):
                start = self._next_readable(last + 1)
        self.lost = max(self.lost, 1)  # the end of the table

    def _rows(self, start: int) -> Iterator[tuple[int, int, int, object]]:
        return self._reader.database.execute(
            "SELECT id, topic_id, timestamp, data FROM messages WHERE id >= ? ORDER BY id", (start,)
        )

    def _next_readable(self, start: int) -> int | None:
        """Return the number of a row behind a damaged place; None if there is none."""
        step = 1
        while start + step < _MAX_ROW:
            try:
                row = next(self._rows(start + step), None)
            except (sqlite3.Error, ValueError, OverflowError):
                step *= 2
                continue
            return row[0] if row else None
        return None
