"""Writes ``metadata.yaml`` of a bag from its files."""

from __future__ import annotations

import os
import re
from collections.abc import Iterable
from pathlib import Path
from typing import Final

from .errors import BagError
from .lock import locked
from .metadata import NO_TIME, BagMetadata, TopicMetadata, write_metadata
from .packed import FORMAT, MESSAGE, is_packed
from .reader import open_reader
from .storage import PACKED_SUFFIX, SUFFIXES, storage_of

_NUMBERED: Final = re.compile(r"(.*?)(?:_(\d+))?\.[^.]+")


def reindex(folder: str | os.PathLike[str], storage: str = "") -> BagMetadata:
    """Write ``metadata.yaml`` of a folder from its files, as they say themselves.

    Args:
        folder: The folder of the bag.
        storage: The storage of the files that count; by default that of the first one.

    Returns:
        What was written.

    Raises:
        BagError: There is no file of a bag in the folder, one of them is damaged, or another
            program writes the bag.
    """
    with locked(Path(folder)):
        return write_index(folder, storage)


def write_index(folder: str | os.PathLike[str], storage: str = "") -> BagMetadata:
    """Do what `reindex` does, for a caller who has the lock of the folder."""
    files = bag_files(folder, storage)
    parts = []
    for path in files:
        reader = open_reader(path, storage_of(path))
        try:
            parts.append(reader.metadata)
            if is_packed(reader):
                parts[-1].compression_mode, parts[-1].compression_format = MESSAGE, FORMAT
        finally:
            reader.close()
    metadata = merged(parts)
    write_metadata(folder, metadata)
    return metadata


def bag_files(folder: str | os.PathLike[str], storage: str = "") -> list[Path]:
    """Return the files of a bag in the order of their numbers.

    Raises:
        BagError: There is none, or there are files of two storages or compressed ones.
    """
    path = Path(folder)
    if not path.is_dir():
        raise BagError(f"{folder}: no such folder; give the folder of a bag")
    suffixes = [SUFFIXES[storage]] if storage else list(SUFFIXES.values())
    packed = sorted(file for end in suffixes for file in path.glob(f"*{end}{PACKED_SUFFIX}"))
    if packed:
        name = packed[0].name
        raise BagError(
            f"{folder}: {name} is compressed as a whole; unpack such files first, as by"
            f" 'zstd -d {name} -o {name.removesuffix(PACKED_SUFFIX)}', and move them away"
        )
    found = [file for file in path.iterdir() if file.suffix in suffixes and file.is_file()]
    if not found:
        raise BagError(f"{folder}: no file with the suffix {' or '.join(suffixes)} in it")
    if len({file.suffix for file in found}) > 1:
        raise BagError(f"{folder}: files of MCAP and of SQLite in it; choose with -s")
    return sorted(found, key=_order)


def merged(parts: Iterable[BagMetadata]) -> BagMetadata:
    """Return the metadata of a bag whose files have these, in their order."""
    whole = BagMetadata()
    topics: dict[str, tuple[TopicMetadata, int]] = {}
    end = 0
    for part in parts:
        whole.storage = part.storage
        whole.files += part.files
        whole.message_count += part.message_count
        if part.message_count:
            whole.starting_time_ns = min(whole.starting_time_ns, part.starting_time_ns)
            end = max(end, part.end_time_ns)
        whole.custom_data = {**whole.custom_data, **part.custom_data}
        whole.ros_distro = part.ros_distro or whole.ros_distro
        whole.compression_mode = part.compression_mode or whole.compression_mode
        whole.compression_format = part.compression_format or whole.compression_format
        for topic, count in part.topics:
            known, before = topics.get(topic.name, (topic, 0))
            if not known.offered_qos:
                known.offered_qos = topic.offered_qos
            topics[topic.name] = known, before + count
    whole.topics = list(topics.values())
    if whole.starting_time_ns != NO_TIME:
        whole.duration_ns = end - whole.starting_time_ns
    return whole


def _order(path: Path) -> tuple[str, int]:
    match = _NUMBERED.fullmatch(path.name)
    assert match is not None  # every name with a suffix
    return match[1], int(match[2] or 0)
