"""Reads a bag: a folder with ``metadata.yaml``, or a single file."""

from __future__ import annotations

import heapq
import os
from collections.abc import Collection, Iterator
from pathlib import Path
from typing import Final

from .errors import BagError
from .metadata import NO_TIME, BagMetadata, FileInformation, TopicMetadata, read_metadata
from .packed import FORMAT, MESSAGE, PackedFile, PackedMessages, is_packed, why_unreadable
from .storage import PACKED_SUFFIX, BagMessage, FileReader, check_storage, storage_of

_AHEAD: Final = -1  # the time of a file of which none is known: it is opened at once


class BagReader:
    """A bag that is read.

    Args:
        uri: The folder of a bag, or one of its files.
        storage: ``mcap`` or ``sqlite3``; by default what the bag says.

    Raises:
        BagError: There is no bag, or it cannot be read.
    """

    def __init__(self, uri: str | os.PathLike[str], storage: str = "") -> None:
        path = Path(uri)
        self._files: list[Path]
        self._topics: list[TopicMetadata] | None = None
        if path.is_dir():
            self._metadata = read_metadata(path)
            self._storage = storage or self._metadata.storage
            check_storage(self._storage)
            self._files = [_within(path, file.path) for file in self._metadata.files]
        elif path.exists():
            self._storage = storage or storage_of(path)
            reader = open_reader(path, self._storage)
            try:
                self._metadata = reader.metadata
                if is_packed(reader):
                    self._metadata.compression_mode = MESSAGE
                    self._metadata.compression_format = FORMAT
            finally:
                reader.close()
            self._files = [path]
        else:
            raise BagError(f"{uri}: no such folder or file")
        if why := why_unreadable(self._metadata):
            raise BagError(f"{uri}: {why}")

    @property
    def metadata(self) -> BagMetadata:
        """The metadata of the bag."""
        return self._metadata

    @property
    def files(self) -> list[Path]:
        """The files of the bag."""
        return self._files

    @property
    def topics(self) -> list[TopicMetadata]:
        """The topics, with their definitions as far as the files have them.

        Raises:
            BagError: A file cannot be read.
        """
        if self._topics is None:
            self._topics = [topic for topic, _ in self._metadata.topics]
            for path in self._files:
                missing = {topic.name: topic for topic in self._topics if not topic.definition}
                if not missing:
                    break
                reader = self._open(path)
                try:
                    for topic, _ in reader.metadata.topics:
                        if topic.name in missing:
                            known = missing[topic.name]
                            known.definition = topic.definition
                            known.definition_encoding = topic.definition_encoding
                            known.type_hash = known.type_hash or topic.type_hash
                finally:
                    reader.close()
        return self._topics

    def messages(
        self,
        topics: Collection[str] | None = None,
        start_ns: int | None = None,
        stop_ns: int | None = None,
    ) -> Iterator[BagMessage]:
        """Yield messages in the order of the time at which they were received.

        Memory is bounded: a file is open from its first message to its last.

        Args:
            topics: The names of the topics; None for all.
            start_ns: The first time that is wanted, in nanoseconds since 1970.
            stop_ns: The first time that is not wanted any more.

        Raises:
            BagError: A file is missing, damaged, or cannot be read.
        """
        if topics is not None:
            topics = frozenset(topics)
        waiting = sorted(
            (_first_time(file), number) for number, file in enumerate(self._metadata.files)
        )
        if stop_ns is not None:
            waiting = [entry for entry in waiting if entry[0] < stop_ns]
        waiting.reverse()
        heap: list[tuple[int, int, BagMessage, Iterator[BagMessage]]] = []
        opened: dict[int, FileReader] = {}
        try:
            while waiting or heap:
                while waiting and (not heap or waiting[-1][0] <= heap[0][0]):
                    _, number = waiting.pop()
                    opened[number] = self._open(self._files[number])
                    rest = opened[number].messages(topics, start_ns, stop_ns)
                    first = next(rest, None)
                    if first is None:
                        opened.pop(number).close()
                    else:
                        heapq.heappush(heap, (first.received_ns, number, first, rest))
                if not heap:
                    continue
                _, number, message, rest = heapq.heappop(heap)
                until = min(
                    waiting[-1][0] if waiting else NO_TIME + 1, heap[0][0] if heap else NO_TIME + 1
                )
                yield message
                for message in rest:
                    if message.received_ns >= until:
                        heapq.heappush(heap, (message.received_ns, number, message, rest))
                        break
                    yield message
                else:
                    opened.pop(number).close()
        finally:
            for reader in opened.values():
                reader.close()

    def _open(self, path: Path) -> FileReader:
        reader = open_reader(path, self._storage)
        if self._metadata.compression_mode == MESSAGE:
            return PackedMessages(path, reader)
        return reader


def _first_time(file: FileInformation) -> int:
    """Return the time before which a file is not needed."""
    return _AHEAD if file.starting_time_ns == NO_TIME else file.starting_time_ns


def _within(folder: Path, name: str) -> Path:
    """Return a file of the metadata: in the folder, whatever path an older rosbag2 has written."""
    return folder / name.replace("\\", "/").rpartition("/")[2]


def open_reader(path: str | os.PathLike[str], storage: str) -> FileReader:
    """Open one file of a bag, which rosbag2 may have compressed as a whole.

    Raises:
        BagError: The file cannot be read, is cut off, or its storage is unknown.
    """
    check_storage(storage)
    if str(path).lower().endswith(PACKED_SUFFIX):
        return PackedFile(Path(path), lambda unpacked: open_reader(unpacked, storage))
    if storage == "mcap":
        from .mcap_reader import McapReader

        return McapReader(path)
    from .sqlite_reader import SqliteReader

    return SqliteReader(path)
