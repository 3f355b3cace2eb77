"""The storages of bags, by the name that rosbag2 has for each, and the contracts of their files."""

from __future__ import annotations

import os
from collections.abc import Collection, Iterator
from pathlib import Path
from typing import Final, NamedTuple, Protocol

from .errors import BagError
from .metadata import BagMetadata, TopicMetadata

SUFFIXES: Final = {"mcap": ".mcap", "sqlite3": ".db3"}
"""The storages, with the suffix of their files."""
PACKED_SUFFIX: Final = ".zstd"
"""The suffix behind that of the storage, of files that rosbag2 has compressed as a whole."""
DEFAULT: Final = "mcap"
"""The storage of a bag for which none was asked."""
DEFAULT_CHUNK: Final = 768 << 10
"""The size of a chunk of an MCAP file before compression, in bytes, as MCAP's writer in C++ has."""


class BagMessage(NamedTuple):
    """A message of a bag.

    Attributes:
        topic: The name of its topic.
        cdr: The message with its encapsulation header.
        received_ns: When it was received, in nanoseconds since 1970.
        sent_ns: When it was published; `received_ns` where the storage does not have that.
    """

    topic: str
    cdr: bytes
    received_ns: int
    sent_ns: int


class FileWriter(Protocol):
    """Writes one file of a bag."""

    @property
    def size(self) -> int:
        """The file's size in bytes, with what is not flushed."""

    def add_topic(self, topic_id: int, topic: TopicMetadata) -> None:
        """Add a topic under a number of the caller's."""

    def write(self, topic_id: int, cdr: bytes, received_ns: int, sent_ns: int) -> None:
        """Write a message."""

    def flush(self) -> None:
        """Make what was written readable for others, also after this process was killed."""

    def close(self, metadata: BagMetadata) -> None:
        """Write the metadata into the file and finish it."""


class FileReader(Protocol):
    """Reads one file of a bag."""

    @property
    def metadata(self) -> BagMetadata:
        """What the file says of itself, with its own path as the only file."""

    def messages(
        self, topics: Collection[str] | None, start_ns: int | None, stop_ns: int | None
    ) -> Iterator[BagMessage]:
        """Yield the messages in the order of their time; ``stop_ns`` is the first not wanted."""

    def close(self) -> None:
        """Close the file."""


def check_storage(storage: str) -> None:
    """Check the name of a storage.

    Raises:
        BagError: There is no such storage.
    """
    if storage not in SUFFIXES:
        raise BagError(f"there is no storage {storage!r}; give {' or '.join(SUFFIXES)}")


def storage_of(path: str | os.PathLike[str]) -> str:
    """Return the storage of a file by its suffix, ``.mcap`` or ``.db3``, perhaps compressed.

    Raises:
        BagError: The suffix is another one.
    """
    name = Path(path).name.lower().removesuffix(PACKED_SUFFIX)
    for storage, suffix in SUFFIXES.items():
        if name.endswith(suffix):
            return storage
    raise BagError(f"{path}: no file of a bag; expected {' or '.join(SUFFIXES.values())}")
