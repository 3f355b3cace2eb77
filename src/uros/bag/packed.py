"""What rosbag2 has compressed itself (``compression_mode``): whole files, or each message.

It has the format ``zstd`` alone. Chunks of MCAP files are no matter of this module.
"""

from __future__ import annotations

import errno
import tempfile
from collections.abc import Callable, Collection, Iterable, Iterator
from pathlib import Path
from typing import BinaryIO, Final

from . import compression
from .errors import BagError
from .metadata import BagMetadata
from .storage import PACKED_SUFFIX, BagMessage, FileReader

FILE: Final = "file"
MESSAGE: Final = "message"
FORMAT: Final = "zstd"
_MAGIC: Final = b"\x28\xb5\x2f\xfd"  # of zstd (RFC 8878); the first octet of CDR is 0
_STEP: Final = 1 << 20
# Attack: a message of some octets that unpacks to more than the memory.
_MOST: Final = 1 << 30

_Unpack = Callable[[Iterable[bytes]], Iterator[bytes]]


def why_unreadable(metadata: BagMetadata) -> str:
    """Return why the compression of a bag cannot be read; empty if it can, or if it has none."""
    mode, form = metadata.compression_mode, metadata.compression_format
    if not mode or (mode in (FILE, MESSAGE) and form == FORMAT):
        return ""
    return (
        f"compression_mode {mode!r:.20} and compression_format {form!r:.20}; uros reads {FORMAT} in"
        f" the modes {FILE} and {MESSAGE}: let 'ros2 bag convert' write the bag without compression"
    )


def is_packed(reader: FileReader) -> bool:
    """Return whether the messages of a file are compressed, as the first one is."""
    try:
        first = next(iter(reader.messages(None, None, None)), None)
    except BagError:
        return False
    return first is not None and first.cdr.startswith(_MAGIC)


class PackedFile:
    """A compressed file, which is unpacked to a temporary one.

    Args:
        path: The file, such as ``x_0.db3.zstd``.
        open_file: Opens the unpacked one.

    Raises:
        BagError: The file cannot be read or unpacked.
    """

    def __init__(self, path: Path, open_file: Callable[[Path], FileReader]) -> None:
        self._name = path.name
        unpack = _unpacker(path)
        self._folder = tempfile.TemporaryDirectory(prefix="uros_bag_")
        try:
            unpacked = Path(self._folder.name, path.name.removesuffix(PACKED_SUFFIX))
            _write(path, unpacked, unpack)
            self._reader = open_file(unpacked)
        except BaseException:
            self._folder.cleanup()
            raise

    @property
    def metadata(self) -> BagMetadata:
        """What the file says of itself, with the compressed one as the only file."""
        metadata = self._reader.metadata
        metadata.files[0].path = self._name
        return metadata

    def messages(
        self, topics: Collection[str] | None, start_ns: int | None, stop_ns: int | None
    ) -> Iterator[BagMessage]:
        """Yield the messages in the order of their time; ``stop_ns`` is the first not wanted."""
        return self._reader.messages(topics, start_ns, stop_ns)

    def close(self) -> None:
        """Remove the temporary file."""
        self._reader.close()
        self._folder.cleanup()


class PackedMessages:
    """A file whose messages are compressed one by one.

    Args:
        path: The file.
        reader: Reads the file.
    """

    def __init__(self, path: Path, reader: FileReader) -> None:
        self._path = path
        self._reader = reader
        self.close = reader.close

    @property
    def metadata(self) -> BagMetadata:
        """What the file says of itself."""
        return self._reader.metadata

    def messages(
        self, topics: Collection[str] | None, start_ns: int | None, stop_ns: int | None
    ) -> Iterator[BagMessage]:
        """Yield the messages in the order of their time; ``stop_ns`` is the first not wanted.

        Raises:
            BagError: A message cannot be unpacked, or has over 1 GiB.
        """
        unpack = _unpacker(self._path)
        for message in self._reader.messages(topics, start_ns, stop_ns):
            yield message._replace(cdr=self._unpacked(message, unpack))

    def _unpacked(self, message: BagMessage, unpack: _Unpack) -> bytes:
        parts, size = [], 0
        try:
            for part in unpack([message.cdr]):
                parts.append(part)
                size += len(part)
                if size > _MOST:
                    raise compression.Broken(f"it unpacks to over {_MOST >> 30} GiB")
        except compression.Broken as error:
            raise BagError(
                f"{self._path}: a message of {message.topic} at {message.received_ns} ns cannot be"
                f" unpacked: {error}; play or convert the bag without the topic"
            ) from error
        return parts[0] if len(parts) == 1 else b"".join(parts)


def _unpacker(path: Path) -> _Unpack:
    try:
        return compression.unpacker()
    except BagError as error:
        raise BagError(f"{path} is compressed: {error}") from error


def _write(path: Path, unpacked: Path, unpack: _Unpack) -> None:
    try:
        with open(path, "rb") as source, open(unpacked, "wb") as target:
            for part in unpack(_steps(source)):
                target.write(part)
    except compression.Broken as error:
        raise BagError(f"{path}: {error}; a whole copy of the file is needed") from error
    except OSError as error:
        remedy = ""
        if error.errno == errno.ENOSPC:
            remedy = f"; have TMPDIR name a folder with room for the unpacked {unpacked.name}"
        raise BagError(f"{path}: {error.strerror}{remedy}") from error


def _steps(file: BinaryIO) -> Iterator[bytes]:
    while part := file.read(_STEP):
        yield part
