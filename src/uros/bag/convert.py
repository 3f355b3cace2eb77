"""Writes bags with other settings: merges them, selects topics, splits and compresses files."""

from __future__ import annotations

import heapq
import shutil
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Literal

from .errors import BagError
from .metadata import BagMetadata, TopicMetadata
from .reader import BagReader
from .writer import BagWriter


def every_topic(name: str, type_name: str) -> bool:
    """Take every topic."""
    return True


@dataclass
class Output:
    """A bag to be written.

    Attributes:
        uri: The folder, which must not exist.
        takes: Whether a topic is written, by its name and type.
        storage: ``mcap`` or ``sqlite3``.
        compression: None, ``zstd`` or ``lz4`` for the chunks of MCAP files.
        max_size: The size in bytes at which the next file begins; 0 for one file.
        max_duration_ns: The time after which the next file begins; 0 for one file.
        start_ns: The first time that is written; None for all.
        stop_ns: The first time that is not written any more; None for all.
        custom_data: Keys and values for the metadata, besides those of the inputs.
    """

    uri: str
    takes: Callable[[str, str], bool] = every_topic
    storage: str = "mcap"
    compression: Literal["zstd", "lz4"] | None = None
    max_size: int = 0
    max_duration_ns: int = 0
    start_ns: int | None = None
    stop_ns: int | None = None
    custom_data: dict[str, str] = field(default_factory=dict)


class _Target:
    """An output with its writer and the numbers of its topics."""

    def __init__(self, output: Output, metadata: Sequence[BagMetadata]) -> None:
        custom = {key: value for each in metadata for key, value in each.custom_data.items()}
        self.output = output
        self.ids: dict[str, int] = {}
        self.writer = BagWriter(
            output.uri,
            output.storage,
            compression=output.compression,
            max_size=output.max_size,
            max_duration_ns=output.max_duration_ns,
            custom_data={**custom, **output.custom_data},
            ros_distro=next((each.ros_distro for each in metadata if each.ros_distro), None),
        )

    def wants(self, received_ns: int) -> bool:
        start, stop = self.output.start_ns, self.output.stop_ns
        return (start is None or received_ns >= start) and (stop is None or received_ns < stop)


def convert(inputs: Sequence[BagReader], outputs: Sequence[Output]) -> list[BagMetadata]:
    """Write the messages of all inputs, in the order of their time, to the outputs that take them.

    Args:
        inputs: The bags that are read.
        outputs: The bags that are written.

    Returns:
        The metadata of each output.

    Raises:
        BagError: An input cannot be read, an output exists or cannot be written, or a topic has
            different types in the inputs. No output is left then.
    """
    for output in outputs:
        if Path(output.uri).exists():
            raise BagError(f"{output.uri} exists; choose another name: a bag is never overwritten")
    topics = merged_topics(topic for reader in inputs for topic in reader.topics)
    targets: list[_Target] = []
    try:
        for output in outputs:
            target = _Target(output, [reader.metadata for reader in inputs])
            targets.append(target)
            for topic in topics:
                if output.takes(topic.name, topic.type_name):
                    target.ids[topic.name] = target.writer.add_topic(replace(topic))
        _copy(inputs, targets)
        for target in targets:
            target.writer.close()
    except BaseException:
        for target in targets:
            _discard(target)
        raise
    return [target.writer.metadata for target in targets]


def merged_topics(topics: Iterable[TopicMetadata]) -> list[TopicMetadata]:
    """Return each topic once, with the QoS profiles of all, sorted by name.

    Raises:
        BagError: A topic has different types.
    """
    found: dict[str, TopicMetadata] = {}
    for topic in topics:
        known = found.setdefault(topic.name, replace(topic, offered_qos=[]))
        if known.type_name != topic.type_name:
            raise BagError(
                f"{topic.name} has the types {known.type_name} and {topic.type_name} in the inputs;"
                " convert them one by one, and exclude the topic from one"
            )
        known.offered_qos += [each for each in topic.offered_qos if each not in known.offered_qos]
        if not known.definition:
            known.definition = topic.definition
            known.definition_encoding = topic.definition_encoding
    return [found[name] for name in sorted(found)]


def _copy(inputs: Sequence[BagReader], targets: Sequence[_Target]) -> None:
    wanted = {name for target in targets for name in target.ids}
    sources = [reader.messages(wanted) for reader in inputs]
    for message in heapq.merge(*sources, key=lambda message: message.received_ns):
        for target in targets:
            number = target.ids.get(message.topic)
            if number is not None and target.wants(message.received_ns):
                target.writer.write(number, message.cdr, message.received_ns, message.sent_ns)


def _discard(target: _Target) -> None:
    """Remove what was written of an output."""
    try:
        target.writer.close()
    except BagError:
        pass  # the error that ended the conversion is the one to tell
    shutil.rmtree(target.writer.folder, ignore_errors=True)
