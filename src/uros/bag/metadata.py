"""The metadata of a bag, and ``metadata.yaml`` of its folder in rosbag2's format.

Version 9 is written, as ROS 2 Jazzy and Kilted do; versions 1 to 9 are read.
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

from ..qos import QoSProfile
from . import qos_profiles, yaml_text
from .errors import BagError
from .lock import in_use, is_locked

FILE_NAME: Final = "metadata.yaml"
VERSION: Final = 9
NO_TIME: Final = 2**63 - 1
"""The starting time of a bag or a file without messages, in nanoseconds."""
_ROOT: Final = "rosbag2_bagfile_information"
_MAX_TIME: Final = 2**63 - 1


@dataclass
class TopicMetadata:
    """A topic of a bag.

    Attributes:
        name: The topic's name, from the root on.
        type_name: The type, such as ``std_msgs/msg/String``.
        offered_qos: The profiles that its publishers offered.
        type_hash: The type's RIHS01 hash, empty if unknown.
        definition: The definitions of the type and its nested types as one text, empty if unknown.
        definition_encoding: The language of the definition: ``ros2msg`` or ``ros2idl``.
        serialization_format: The format of its messages.
    """

    name: str
    type_name: str
    offered_qos: list[QoSProfile] = field(default_factory=list)
    type_hash: str = ""
    definition: str = ""
    definition_encoding: str = "ros2msg"
    serialization_format: str = "cdr"


@dataclass
class FileInformation:
    """A file of a bag; times in nanoseconds, `starting_time_ns` is `NO_TIME` without messages."""

    path: str
    starting_time_ns: int = NO_TIME
    duration_ns: int = 0
    message_count: int = 0


@dataclass
class BagMetadata:
    """The content of ``metadata.yaml``.

    Attributes:
        version: The version of the format.
        storage: ``mcap`` or ``sqlite3``.
        starting_time_ns: The first message's time in nanoseconds since 1970; `NO_TIME` if none.
        duration_ns: The time from the first to the last message.
        message_count: The number of messages.
        topics: The topics with their numbers of messages.
        files: The files in their order; up to version 4 their paths alone.
        compression_format: The format of rosbag2's own compression, ``zstd`` or empty.
        compression_mode: What that compresses: ``file``, ``message`` or empty.
        custom_data: Keys and values of the user.
        ros_distro: The distribution of ROS 2 that has recorded, empty if unknown.
    """

    version: int = VERSION
    storage: str = "mcap"
    starting_time_ns: int = NO_TIME
    duration_ns: int = 0
    message_count: int = 0
    topics: list[tuple[TopicMetadata, int]] = field(default_factory=list)
    files: list[FileInformation] = field(default_factory=list)
    compression_format: str = ""
    compression_mode: str = ""
    custom_data: dict[str, str] = field(default_factory=dict)
    ros_distro: str = ""

    @property
    def end_time_ns(self) -> int:
        """The last message's time in nanoseconds; the starting time if there is none."""
        return self.starting_time_ns + self.duration_ns


def read_metadata(folder: str | os.PathLike[str]) -> BagMetadata:
    """Read ``metadata.yaml`` of a folder.

    Raises:
        BagError: There is none, or it cannot be read.
    """
    path = Path(folder) / FILE_NAME
    try:
        with open(path, "rb") as file:
            text = file.read(yaml_text.MAX_TEXT + 1)
    except FileNotFoundError as error:
        if is_locked(Path(folder)):
            raise BagError(in_use(folder)) from error
        raise BagError(
            f"{folder}: no {FILE_NAME} in it; 'uros bag recover {folder}' finishes a recording that"
            f" was cut off, 'uros bag reindex {folder}' writes {FILE_NAME} for whole files"
        ) from error
    except OSError as error:
        raise BagError(f"{path}: {error.strerror}") from error
    root = yaml_text.load(text, str(path))
    if not isinstance(root, Mapping) or _ROOT not in root:
        raise BagError(f"{path}: no key {_ROOT}; 'uros bag reindex {folder}' writes it anew")
    return from_mapping(root[_ROOT], str(path))


def write_metadata(folder: str | os.PathLike[str], metadata: BagMetadata) -> None:
    """Write ``metadata.yaml`` into a folder; an interruption leaves the old one or the new one.

    Raises:
        BagError: The file cannot be written.
    """
    path = Path(folder) / FILE_NAME
    unfinished = path.with_name(FILE_NAME + ".part")
    try:
        with open(unfinished, "w", encoding="utf-8") as file:
            file.write(yaml_text.dump({_ROOT: to_mapping(metadata)}))
            file.flush()
            os.fsync(file.fileno())
        os.replace(unfinished, path)
    except OSError as error:
        raise BagError(f"{path}: {error.strerror}") from error


def to_mapping(metadata: BagMetadata) -> dict[str, Any]:
    """Return what ``metadata.yaml`` has below its root, at the version of the metadata."""
    version = metadata.version
    topics = []
    for topic, count in metadata.topics:
        profiles: object = qos_profiles.to_yaml(topic.offered_qos, version)
        if version < VERSION:
            profiles = yaml_text.dump(profiles) if profiles else ""
        entry = {
            "name": topic.name,
            "type": topic.type_name,
            "serialization_format": topic.serialization_format,
            "offered_qos_profiles": profiles,
            "type_description_hash": topic.type_hash,
        }
        topics.append({"topic_metadata": entry, "message_count": count})
    return {
        "version": version,
        "storage_identifier": metadata.storage,
        "duration": {"nanoseconds": metadata.duration_ns},
        "starting_time": {"nanoseconds_since_epoch": metadata.starting_time_ns},
        "message_count": metadata.message_count,
        "topics_with_message_count": topics,
        "compression_format": metadata.compression_format,
        "compression_mode": metadata.compression_mode,
        "relative_file_paths": [file.path for file in metadata.files],
        "files": [
            {
                "path": file.path,
                "starting_time": {"nanoseconds_since_epoch": file.starting_time_ns},
                "duration": {"nanoseconds": file.duration_ns},
                "message_count": file.message_count,
            }
            for file in metadata.files
        ],
        "custom_data": dict(metadata.custom_data) or None,
        "ros_distro": metadata.ros_distro,
    }


def from_mapping(node: object, where: str) -> BagMetadata:
    """Return the metadata of a mapping as `to_mapping` makes it, of any version.

    Args:
        node: What YAML has below its root.
        where: The file, for the error.

    Raises:
        BagError: A value is missing or wrong, or the version is newer than `VERSION`.
    """
    whole = _Fields(node, where)
    version = whole.number("version")
    if not 1 <= version <= VERSION:
        raise BagError(f"{where}: version {version}; uros knows 1 to {VERSION}")
    metadata = BagMetadata(
        version=version,
        storage=whole.text("storage_identifier"),
        starting_time_ns=whole.fields("starting_time").number("nanoseconds_since_epoch"),
        duration_ns=whole.fields("duration").number("nanoseconds"),
        message_count=whole.number("message_count"),
        topics=[_topic(each) for each in whole.mappings("topics_with_message_count")],
        files=[FileInformation(_text(path, where)) for path in whole.items("relative_file_paths")],
    )
    if version >= 3:
        metadata.compression_format = whole.text("compression_format")
        mode = whole.text("compression_mode").lower()
        metadata.compression_mode = "" if mode == "none" else mode
    if version >= 5:
        details = {file.path: file for file in map(_file, whole.mappings("files"))}
        metadata.files = [details.get(file.path, file) for file in metadata.files]
    if version >= 6:
        custom = whole.node.get("custom_data") or {}
        if not isinstance(custom, Mapping):
            raise BagError(f"{where}: custom_data is no mapping")
        metadata.custom_data = {str(key): str(value) for key, value in custom.items()}
    if version >= 8:
        metadata.ros_distro = whole.text("ros_distro")
    return metadata


def _topic(entry: _Fields) -> tuple[TopicMetadata, int]:
    fields = entry.fields("topic_metadata")
    name = fields.text("name")
    where = f"{entry.where}: topic {name}"
    return TopicMetadata(
        name,
        fields.text("type"),
        qos_profiles.from_yaml(fields.node.get("offered_qos_profiles"), where),
        _text(fields.node.get("type_description_hash") or "", where),
        serialization_format=fields.text("serialization_format"),
    ), entry.number("message_count")


def _file(entry: _Fields) -> FileInformation:
    return FileInformation(
        entry.text("path"),
        entry.fields("starting_time").number("nanoseconds_since_epoch"),
        entry.fields("duration").number("nanoseconds"),
        entry.number("message_count"),
    )


class _Fields:
    """A mapping whose values are checked."""

    def __init__(self, node: object, where: str) -> None:
        if not isinstance(node, Mapping):
            raise BagError(f"{where}: a mapping was expected, not {node!r:.40}")
        self.node = node
        self.where = where

    def _value(self, key: str) -> object:
        if key not in self.node:
            raise BagError(f"{self.where}: {key} is missing")
        return self.node[key]

    def text(self, key: str) -> str:
        return _text(self._value(key), f"{self.where}: {key}")

    def number(self, key: str) -> int:
        value = self._value(key)
        if isinstance(value, bool) or not isinstance(value, int) or not 0 <= value <= _MAX_TIME:
            raise BagError(f"{self.where}: {key} is {value!r:.40}; expected a number from 0 on")
        return value

    def fields(self, key: str) -> _Fields:
        return _Fields(self._value(key), f"{self.where}: {key}")

    def items(self, key: str) -> list[object]:
        value = self._value(key) or []
        if not isinstance(value, list):
            raise BagError(f"{self.where}: {key} is no list")
        return value

    def mappings(self, key: str) -> list[_Fields]:
        return [_Fields(each, self.where) for each in self.items(key)]


def _text(value: object, where: str) -> str:
    """Return a scalar as text: YAML takes unquoted ``1.0`` or ``null`` for something else."""
    if value is None:
        return ""
    if isinstance(value, (str, int, float)):
        return str(value)
    raise BagError(f"{where}: text was expected, not {value!r:.40}")
