"""Finishes a bag whose recording was cut off, and keeps what can be read of a damaged one.

A damaged file is written anew beside the original. Only when the new file is complete, it takes the
original's name; the original is then kept as ``NAME.damaged`` if anything in it was not readable.
"""

from __future__ import annotations

import os
import shutil
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from .errors import BagError, Reported
from .lock import locked
from .metadata import BagMetadata
from .reader import open_reader
from .reindex import bag_files, write_index
from .storage import DEFAULT_CHUNK, check_storage, storage_of

_UNFINISHED: Final = ".recovering"
_DAMAGED: Final = ".damaged"
# In the head of an SQLite file: the size of its pages, 1 for 65536.
_PAGE_SIZE_AT: Final = 16
_LEAST_PAGE: Final = 512
_STEP: Final = 1 << 20
_OF_SQLITE: Final = ("", "-wal", "-shm", "-journal")


@dataclass
class RecoveredFile:
    """What became of one file of a bag.

    Attributes:
        path: The file.
        kept: The number of its messages.
        lost_bytes: The size of what cannot be read.
        lost_messages: The messages that are known to be in there; there may be more.
        rewritten: Whether the file was written anew; a whole one is left as it is.
        original: Where the original is kept; None if everything in it was readable.
    """

    path: Path
    kept: int = 0
    lost_bytes: int = 0
    lost_messages: int = 0
    rewritten: bool = False
    original: Path | None = None


def recover(uri: str | os.PathLike[str], storage: str = "") -> list[RecoveredFile]:
    """Recover the files of a bag, and write ``metadata.yaml`` of a folder.

    Args:
        uri: The folder of a bag, or one of its files.
        storage: ``mcap`` or ``sqlite3``; by default what the suffixes of the files say.

    Returns:
        What became of each file.

    Raises:
        BagError: There is no bag, another program writes it, nothing of a file can be read, or no
            room for the new file. The originals are then as they were.
    """
    path = Path(uri)
    if path.is_dir():
        with locked(path):
            results = [_recover_file(file, storage_of(file)) for file in bag_files(path, storage)]
            write_index(path, storage)
        return results
    if not path.exists():
        raise BagError(f"{uri}: no such folder or file")
    with locked(path.parent):
        return [_recover_file(path, storage or storage_of(path))]


def _recover_file(path: Path, storage: str) -> RecoveredFile:
    check_storage(storage)
    count = _whole(path, storage)
    if count is not None:
        return RecoveredFile(path, count)
    result = RecoveredFile(path, rewritten=True)
    unfinished = path.with_name(path.name + _UNFINISHED)
    with Reported(path):
        try:
            unfinished.unlink(missing_ok=True)
            if storage == "mcap":
                _salvage_mcap(path, unfinished, result)
            else:
                _salvage_sqlite(path, unfinished, result)
            _sync(unfinished)
            _exchange(path, unfinished, result)
        except BaseException:
            for suffix in ("", "-source"):
                _remove(Path(f"{unfinished}{suffix}"))
            raise
    return result


def _whole(path: Path, storage: str) -> int | None:
    """Return the number of messages of a file if all of them can be read."""
    if Path(f"{path}-wal").exists():
        return None  # what a killed process has left; it belongs to the file
    try:
        reader = open_reader(path, storage)
        try:
            stated = reader.metadata.message_count
            count = sum(1 for _ in reader.messages(None, None, None))
        finally:
            reader.close()
    except BagError:
        return None
    return count if count == stated else None


def _exchange(path: Path, unfinished: Path, result: RecoveredFile) -> None:
    """Give the new file the original's name."""
    if result.lost_bytes or result.lost_messages:
        result.original = path.with_name(path.name + _DAMAGED)
        if result.original.exists():
            raise BagError(f"{result.original} exists, from an earlier recovery; move it away")
        os.replace(path, result.original)
    os.replace(unfinished, path)
    for suffix in _OF_SQLITE[1:]:  # their content is in the new file
        Path(f"{path}{suffix}").unlink(missing_ok=True)


def _salvage_mcap(path: Path, unfinished: Path, result: RecoveredFile) -> None:
    from .mcap_reader import channel_topic, stored_metadata
    from .mcap_salvage import McapSalvage
    from .mcap_writer import McapWriter

    with open(path, "rb") as file:
        salvage = McapSalvage(file, path.stat().st_size)
        messages = salvage.messages()
        first = next(messages, None)
        if first is None and not salvage.index.channels:
            raise BagError(f"{path}: no message and no topic of it can be read")
        stored = stored_metadata(salvage.index, str(path))
        writer = McapWriter(unfinished, salvage.compression, DEFAULT_CHUNK, stored)
        known: set[int] = set()
        try:
            while first is not None:
                for number in salvage.index.channels.keys() - known:
                    known.add(number)
                    writer.add_topic(number, channel_topic(salvage.index, number, str(path)))
                writer.write(first.channel, first.cdr, first.received_ns, first.sent_ns)
                result.kept += 1
                first = next(messages, None)
            for number in salvage.index.channels.keys() - known:
                writer.add_topic(number, channel_topic(salvage.index, number, str(path)))
        finally:
            writer.close(stored)
        result.lost_bytes = sum(loss.size for loss in salvage.losses)
        result.lost_messages = sum(loss.messages for loss in salvage.losses)


def _salvage_sqlite(path: Path, unfinished: Path, result: RecoveredFile) -> None:
    from .sqlite_salvage import SqliteSalvage
    from .sqlite_writer import SqliteWriter

    source = _whole_pages(path, unfinished)
    try:
        salvage = SqliteSalvage(source)
    except BagError as error:
        raise BagError(f"{path}: not even its topics can be read") from error
    try:
        writer = SqliteWriter(unfinished, BagMetadata(storage="sqlite3"))
        try:
            for number, topic in salvage.topics.items():
                writer.add_topic(number - 1, topic)
            for number, data, received in salvage.messages():
                writer.write(number - 1, data, received, received)
                result.kept += 1
        finally:
            writer.close(salvage.metadata)
    finally:
        salvage.close()
    result.lost_messages = salvage.lost
    if source != path:
        _remove(source)


def _whole_pages(path: Path, unfinished: Path) -> Path:
    """Return a copy without the page within which the file ends; the file, if it ends behind one.

    SQLite takes what is missing of a page for zeros, and messages would have them.
    """
    with open(path, "rb") as file:
        head = file.read(_PAGE_SIZE_AT + 2)[_PAGE_SIZE_AT:]
        page = int.from_bytes(head, "big") if len(head) == 2 else 0
        page = 1 << 16 if page == 1 else page
        size = path.stat().st_size
        if page < _LEAST_PAGE or not size % page:
            return path
        source = unfinished.with_name(unfinished.name + "-source")
        with open(source, "wb") as copy:
            file.seek(0)
            left = size - size % page
            while left and (part := file.read(min(left, _STEP))):
                copy.write(part)
                left -= len(part)
    log = Path(f"{path}-wal")
    if log.exists():
        shutil.copyfile(log, f"{source}-wal")
    return source


def _sync(path: Path) -> None:
    """Wait until a file is on the disk, before it takes the place of another one."""
    with open(path, "rb") as file:
        os.fsync(file.fileno())


def _remove(path: Path) -> None:
    """Remove a file, with what SQLite may have put beside it."""
    for suffix in _OF_SQLITE:
        Path(f"{path}{suffix}").unlink(missing_ok=True)
