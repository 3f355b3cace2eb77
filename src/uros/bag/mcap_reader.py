"""Reads an MCAP file of rosbag2, in the order of time and with bounded memory.

A block of the file is loaded when its first time is due. Usually blocks follow each other in time,
and one is in memory; where they overlap, a cache holds as many as fit, and loads others again.
"""

from __future__ import annotations

import heapq
import os
from array import array
from collections import OrderedDict
from collections.abc import Collection, Iterator
from pathlib import Path
from typing import Final

from . import metadata as bag_metadata
from . import qos_profiles, yaml_text
from .errors import BagError
from .mcap_codec import HEAD, MESSAGE
from .mcap_index import MAX_TIME, Block, McapIndex, messages_in, read_index
from .mcap_records import Damage, chunk_data, read_at
from .metadata import BagMetadata, FileInformation, TopicMetadata
from .storage import BagMessage

_CACHE: Final = 64 << 20  # bytes of blocks; the block in use is kept whatever its size


class McapReader:
    """An MCAP file that is whole.

    Args:
        path: The file.

    Raises:
        BagError: The file cannot be read, or is cut off.
    """

    def __init__(self, path: str | os.PathLike[str]) -> None:
        self._path = Path(path)
        self._metadata: BagMetadata | None = None
        self._cache: OrderedDict[int, tuple[bytes, array[int], array[int]]] = OrderedDict()
        try:
            self._file = open(self._path, "rb")
        except OSError as error:
            raise BagError(f"{path}: {error.strerror}") from error
        try:
            self._index = read_index(self._file)
        except (BagError, OSError) as error:
            self._file.close()
            raise self._fault(error) from error

    @property
    def metadata(self) -> BagMetadata:
        """What the file says of itself, with its own path as the only file."""
        if self._metadata is None:
            self._metadata = self._read_metadata()
        return self._metadata

    def close(self) -> None:
        """Close the file."""
        self._cache.clear()
        self._file.close()

    def messages(
        self, topics: Collection[str] | None, start_ns: int | None, stop_ns: int | None
    ) -> Iterator[BagMessage]:
        """Yield the messages in the order of their time; ``stop_ns`` is the first not wanted."""
        start = 0 if start_ns is None else start_ns
        stop = MAX_TIME + 1 if stop_ns is None else stop_ns
        names = {
            id_: channel.topic
            for id_, channel in self._index.channels.items()
            if topics is None or channel.topic in topics
        }
        try:
            yield from self._merged(names, start, stop)
        except (Damage, OSError) as error:
            raise self._fault(error) from error

    # --- order of time ------------------------------------------------------------------

    def _merged(self, names: dict[int, str], start: int, stop: int) -> Iterator[BagMessage]:
        """Yield the messages of all blocks; of equal times, the one first in the file is first."""
        wanted = [
            block for block in self._index.blocks if block.end_ns >= start and block.start_ns < stop
        ]
        heap = [(block.start_ns, number, 0) for number, block in enumerate(wanted)]
        heapq.heapify(heap)
        self._cache.clear()
        while heap:
            _, number, at = heapq.heappop(heap)
            data, times, places = self._load(number, wanted[number], names, start, stop)
            until = heap[0][:2] if heap else (MAX_TIME + 1, 0)
            count = len(times)
            while at < count and (times[at], number) <= until:
                place = places[at]
                _, length = HEAD.unpack_from(data, place)
                channel, _, received, sent = MESSAGE.unpack_from(data, place + HEAD.size)
                body = place + HEAD.size
                yield BagMessage(
                    names[channel], data[body + MESSAGE.size : body + length], received, sent
                )
                at += 1
            if at < count:
                heapq.heappush(heap, (times[at], number, at))
            else:
                self._cache.pop(number, None)

    def _load(
        self, number: int, block: Block, names: dict[int, str], start: int, stop: int
    ) -> tuple[bytes, array[int], array[int]]:
        """Return a block's data, and the times and places of its wanted messages in order."""
        if number in self._cache:
            self._cache.move_to_end(number)
            return self._cache[number]
        record = block.record
        if block.is_chunk:
            data = chunk_data(self._file, record)
        else:
            data = read_at(self._file, record.start, record.end - record.start)
        times, places = array("Q"), array("Q")
        for channel, received, place in messages_in(data, record.start):
            if channel not in self._index.channels:
                raise Damage(record.start, f"a message of the unknown channel {channel}")
            if not block.start_ns <= received <= block.end_ns:
                raise Damage(record.start, "a chunk with wrong times in its index")
            if channel in names and start <= received < stop:
                times.append(received)
                places.append(place)
        if times.tolist() != sorted(times):
            order = sorted(range(len(times)), key=times.__getitem__)
            times = array("Q", [times[at] for at in order])
            places = array("Q", [places[at] for at in order])
        self._cache[number] = data, times, places
        while len(self._cache) > 1 and sum(len(each[0]) for each in self._cache.values()) > _CACHE:
            self._cache.popitem(last=False)
        return data, times, places

    def _read_metadata(self) -> BagMetadata:
        index = self._index
        count = sum(index.counts.values())
        start = index.first_ns if count else bag_metadata.NO_TIME
        duration = index.last_ns - index.first_ns
        metadata = BagMetadata(
            storage="mcap",
            starting_time_ns=start,
            duration_ns=duration,
            message_count=count,
            topics=merged_topics(index, str(self._path)),
            files=[FileInformation(self._path.name, start, duration, count)],
        )
        stored = stored_metadata(index, str(self._path))
        metadata.custom_data = stored.custom_data
        metadata.ros_distro = stored.ros_distro
        return metadata

    def _fault(self, error: Exception) -> BagError:
        if isinstance(error, Damage):
            remedy = f"'uros bag recover {self._path}' keeps what can be read"
            return BagError(f"{self._path}: {error}; {remedy}")
        if isinstance(error, OSError):
            return BagError(f"{self._path}: {error.strerror}")
        return BagError(f"{self._path}: {error}")


def merged_topics(index: McapIndex, where: str) -> list[tuple[TopicMetadata, int]]:
    """Return the topics of a file with their numbers of messages; several channels may be of one.

    Args:
        index: What the file has.
        where: The file, for the error.

    Raises:
        BagError: The QoS profiles of a topic are wrong.
    """
    topics: dict[str, tuple[TopicMetadata, int]] = {}
    for number, channel in index.channels.items():
        topic, count = topics.get(channel.topic, (None, 0))
        topic = topic or channel_topic(index, number, where)
        topics[channel.topic] = topic, count + index.counts[number]
    return list(topics.values())


def stored_metadata(index: McapIndex, where: str) -> BagMetadata:
    """Return the metadata that rosbag2 has stored in a file; empty ones if there are none.

    Raises:
        BagError: They are wrong.
    """
    stored = index.stored or {}
    metadata = BagMetadata()
    if text := stored.get("serialized_metadata"):
        where = f"{where}: metadata"
        metadata = bag_metadata.from_mapping(yaml_text.load(text, where), where)
    metadata.ros_distro = stored.get("ROS_DISTRO", metadata.ros_distro)
    return metadata


def channel_topic(index: McapIndex, number: int, where: str) -> TopicMetadata:
    """Return the topic of a channel.

    Raises:
        BagError: Its QoS profiles are wrong.
    """
    channel = index.channels[number]
    schema = index.schemas.get(channel.schema_id)
    offered = channel.metadata.get("offered_qos_profiles", "")
    return TopicMetadata(
        channel.topic,
        schema.name if schema else "",
        qos_profiles.from_yaml(offered, f"{where}: topic {channel.topic}"),
        channel.metadata.get("topic_type_hash", ""),
        schema.data.decode("utf-8", "replace") if schema else "",
        schema.encoding if schema else "",
        channel.message_encoding,
    )
