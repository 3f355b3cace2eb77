"""Writes a bag: a folder of files with ``metadata.yaml``, as rosbag2 does."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Final, Literal

from ..interfaces import InterfaceError, distro
from . import compression as compressions
from .definitions import definition_text, topic_type_hash
from .errors import BagError, Reported
from .lock import FolderLock, in_use
from .metadata import BagMetadata, FileInformation, TopicMetadata, write_metadata
from .storage import DEFAULT, DEFAULT_CHUNK, SUFFIXES, FileWriter, check_storage

_MAX_TIME: Final = 2**63 - 1
_MAX_TOPICS: Final = 0xFFFF  # MCAP numbers channels with 16 bits
# The least sizes at which rosbag2 splits, in bytes: those of files without messages.
_LEAST_SIZES: Final = {"mcap": 1024, "sqlite3": 86016}


class BagWriter:
    """A bag that is written.

    A file of the bag is finished when the next one begins and at `close`; ``metadata.yaml`` is
    written at `close`. `uros.bag.recover` finishes what a killed process has left, and refuses a
    bag that is still written: its folder is locked.

    Args:
        uri: The folder, which must not exist. Its name is the first part of the files' names.
        storage: ``mcap`` or ``sqlite3``.
        compression: None, ``zstd`` or ``lz4`` for the chunks of MCAP files.
        max_size: The size in bytes at which the next file begins; 0 for one file.
        max_duration_ns: The time from a file's first message after which the next file begins.
        chunk_size: The size of the chunks of MCAP files before compression, in bytes.
        custom_data: Keys and values for the metadata.
        ros_distro: The distribution in the metadata; by default the one in use.

    Raises:
        BagError: The folder exists or cannot be made, or an argument does not fit the storage.
    """

    def __init__(
        self,
        uri: str | os.PathLike[str],
        storage: str = DEFAULT,
        *,
        compression: Literal["zstd", "lz4"] | None = None,
        max_size: int = 0,
        max_duration_ns: int = 0,
        chunk_size: int = DEFAULT_CHUNK,
        custom_data: Mapping[str, str] | None = None,
        ros_distro: str | None = None,
    ) -> None:
        self._folder = Path(uri)
        self._storage = storage or DEFAULT
        self._compression = compression
        self._max_size = max_size
        self._max_duration_ns = max_duration_ns
        self._chunk_size = chunk_size
        self._topics: list[TopicMetadata] = []
        self._counts: list[int] = []
        self._ids: dict[str, int] = {}
        self._closed = False
        self._check(compression)
        if ros_distro is None:
            try:
                ros_distro = distro.chosen()
            except InterfaceError as error:
                raise BagError(str(error)) from error
        self._metadata = BagMetadata(
            storage=self._storage, custom_data=dict(custom_data or {}), ros_distro=ros_distro
        )
        try:
            self._folder.mkdir(parents=True)
        except FileExistsError as error:
            raise BagError(
                f"{uri} exists; choose another name: a bag is never overwritten"
            ) from error
        except OSError as error:
            raise BagError(f"{uri}: {error.strerror}") from error
        try:
            self._lock = FolderLock(self._folder)
        except BlockingIOError as error:  # of a recovery that was just started
            raise BagError(in_use(uri)) from error
        self._path = self._folder
        self._reported = Reported(self._folder)
        try:
            self._file = self._open_file()
        except BaseException:
            self._lock.release()
            raise

    def __enter__(self) -> BagWriter:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    @property
    def folder(self) -> Path:
        """The folder of the bag."""
        return self._folder

    @property
    def storage(self) -> str:
        """The storage: ``mcap`` or ``sqlite3``."""
        return self._storage

    @property
    def message_count(self) -> int:
        """The number of messages that were written."""
        return sum(self._counts)

    @property
    def path(self) -> Path:
        """The file that is written."""
        return self._path

    @property
    def metadata(self) -> BagMetadata:
        """The metadata of what was written so far."""
        metadata = self._metadata
        used = [file for file in metadata.files if file.message_count]
        if used:
            metadata.starting_time_ns = min(file.starting_time_ns for file in used)
            end = max(file.starting_time_ns + file.duration_ns for file in used)
            metadata.duration_ns = end - metadata.starting_time_ns
        metadata.message_count = self.message_count
        metadata.topics = list(zip(self._topics, self._counts, strict=True))
        return metadata

    def add_topic(self, topic: TopicMetadata) -> int:
        """Add a topic, with its definition and hash where uros knows them and they are missing.

        Args:
            topic: The topic. A topic of this name that was added before is not changed.

        Returns:
            The number of the topic, for `write`.

        Raises:
            BagError: A topic of this name has another type, or the file cannot be written.
        """
        if topic.name in self._ids:
            number = self._ids[topic.name]
            known = self._topics[number].type_name
            if known != topic.type_name:
                raise BagError(f"{topic.name} is of the type {known}, and not {topic.type_name}")
            return number
        if len(self._topics) >= _MAX_TOPICS:
            raise BagError(f"{self._folder}: over {_MAX_TOPICS} topics")
        try:
            f"{topic.name}{topic.type_name}".encode()
        except UnicodeEncodeError as error:
            raise BagError(f"{topic.name!a}: a name that is no text cannot be written") from error
        if not topic.definition:
            topic.definition = definition_text(topic.type_name)
        if not topic.type_hash:
            topic.type_hash = topic_type_hash(topic.type_name)
        number = len(self._topics)
        with self._reported:
            self._file.add_topic(number, topic)
        self._topics.append(topic)
        self._counts.append(0)
        self._ids[topic.name] = number
        return number

    def write(self, topic_id: int, cdr: bytes, received_ns: int, sent_ns: int) -> None:
        """Write a message; first begin the next file if the bag is split here.

        Args:
            topic_id: What `add_topic` has returned.
            cdr: The message with its encapsulation header.
            received_ns: When it was received, in nanoseconds since 1970.
            sent_ns: When it was published; SQLite files do not keep that.

        Raises:
            BagError: A time is negative or too large, or the file cannot be written.
        """
        if not 0 <= received_ns <= _MAX_TIME or not 0 <= sent_ns <= _MAX_TIME:
            raise BagError(
                f"a message of the time {received_ns}, sent at {sent_ns}, in nanoseconds"
            )
        file = self._metadata.files[-1]
        if self._is_full(file, received_ns):
            self.split()
            file = self._metadata.files[-1]
        with self._reported:
            self._file.write(topic_id, cdr, received_ns, sent_ns)
        end = max(file.starting_time_ns + file.duration_ns, received_ns)
        if not file.message_count:
            end = received_ns
        file.starting_time_ns = min(file.starting_time_ns, received_ns)
        file.duration_ns = end - file.starting_time_ns
        file.message_count += 1
        self._counts[topic_id] += 1

    def flush(self) -> None:
        """Make all messages that were written readable, also if this process is killed now.

        Raises:
            BagError: The file cannot be written.
        """
        with self._reported:
            self._file.flush()

    def split(self) -> Path:
        """Finish the file and begin the next one.

        Returns:
            The finished file.

        Raises:
            BagError: A file cannot be written.
        """
        finished = self._path
        self._finish_file(self.metadata)
        self._file = self._open_file()
        with self._reported:
            for number, topic in enumerate(self._topics):
                self._file.add_topic(number, topic)
        return finished

    def close(self) -> None:
        """Finish the last file and write ``metadata.yaml``; idempotent.

        Raises:
            BagError: A file cannot be written.
        """
        if self._closed:
            return
        self._closed = True
        metadata = self.metadata
        try:
            self._finish_file(metadata)
            write_metadata(self._folder, metadata)
        finally:
            self._lock.release()

    def _check(self, compression: str | None) -> None:
        check_storage(self._storage)
        if compression is not None and self._storage != "mcap":
            raise BagError(f"files of {self._storage} are not compressed; use -s mcap")
        if compression is not None and (why := compressions.why_missing(compression)):
            raise BagError(why)
        least = _LEAST_SIZES[self._storage]
        if self._max_size and self._max_size < least:
            raise BagError(
                f"files of {self._max_size} bytes are too small; give {least} or more for"
                f" {self._storage}, or 0 for one file"
            )

    def _is_full(self, file: FileInformation, received_ns: int) -> bool:
        if not file.message_count:
            return False
        if self._max_size and self._file.size >= self._max_size:
            return True
        age = received_ns - file.starting_time_ns
        return bool(self._max_duration_ns) and age > self._max_duration_ns

    def _finish_file(self, metadata: BagMetadata) -> None:
        try:
            with self._reported:
                self._file.close(metadata)
        finally:
            if not self._is_there():  # which explains an error of closing, too
                raise BagError(
                    f"{self._path}: another program has replaced or removed this file; what was"
                    " recorded since then is lost"
                )

    def _is_there(self) -> bool:
        """Return whether the path still names the file that is written."""
        try:
            return os.path.samestat(os.stat(self._path), self._status)
        except OSError:
            return False

    def _open_file(self) -> FileWriter:
        number = len(self._metadata.files)
        name = f"{self._folder.resolve().name}_{number}{SUFFIXES[self._storage]}"
        path = self._path = self._folder / name
        self._reported = Reported(path)
        self._metadata.files.append(FileInformation(name))
        with self._reported:
            file: FileWriter
            if self._storage == "mcap":
                from .mcap_writer import McapWriter

                file = McapWriter(path, self._compression, self._chunk_size, self.metadata)
            else:
                from .sqlite_writer import SqliteWriter

                file = SqliteWriter(path, self.metadata)
            self._status = os.stat(path)
        return file
