"""The messages between the network and the disk: a bounded queue, or a ring for snapshots."""

from __future__ import annotations

import threading
from collections import deque
from typing import Final, NamedTuple

from ...bag.metadata import TopicMetadata

# What a message takes in memory besides its octets, about.
_OVERHEAD: Final = 200
# The most octets of messages that are held where there is no cache.
_MOST_HELD: Final = 16 << 20


class Recorded(NamedTuple):
    """A message of a topic with the times that the bag stores (Unix ns)."""

    topic: TopicMetadata
    cdr: bytes
    received_ns: int
    sent_ns: int


class MessageCache:
    """Messages that wait for the thread that writes them.

    A message is dropped and counted if the cache is full. As a ring it drops the oldest instead,
    which counts for nothing, and hands over what it has at each snapshot only.

    The messages of a topic can be held until its definition is known, since a file has the topic
    before its messages.

    Args:
        max_octets: The most that wait; 0: a message waits until those before it are taken.
        ring: Whether messages are kept for a snapshot.

    Attributes:
        dropped: The messages that were dropped because the cache was full or closed.
    """

    def __init__(self, max_octets: int, ring: bool = False) -> None:
        self._max_octets = max_octets
        self._ring: deque[Recorded] | None = deque() if ring else None
        self._ring_octets = 0
        self._changed = threading.Condition()
        self._queue: list[Recorded | TopicMetadata] = []
        self._octets = 0
        self._unwritten_octets = 0
        self._held: dict[str, tuple[TopicMetadata, list[Recorded]]] = {}
        self._held_octets = 0
        self._closed = False
        self.dropped = 0

    def hold(self, topic: TopicMetadata) -> None:
        """Hold the messages of a topic until :meth:`add_topic` or :meth:`close`."""
        with self._changed:
            self._held[topic.name] = topic, []

    def add_topic(self, topic: TopicMetadata) -> None:
        """Hand over a topic before its messages, with those that were held."""
        with self._changed:
            _, messages = self._held.pop(topic.name, (topic, []))
            self._queue += [topic, *messages]
            size = sum(map(_size, messages))
            self._held_octets -= size
            self._octets += size

    def add(self, message: Recorded) -> None:
        """Hand over a message, or drop it."""
        size = _size(message)
        with self._changed:
            if self._closed:
                self.dropped += 1
                return
            if self._ring is not None:
                self._keep(self._ring, message, size)
                return
            if not self._max_octets and message.topic.name not in self._held:
                self._changed.wait_for(lambda: self._closed or not self._queue)
            elif self._is_full(size):
                self.dropped += 1
                return
            self._enqueue(message, size)
            if self._octets * 2 >= self._max_octets:
                self._changed.notify_all()

    def _is_full(self, size: int) -> bool:
        waiting = self._octets + self._unwritten_octets + self._held_octets
        return waiting + size > (self._max_octets or _MOST_HELD)

    def _enqueue(self, message: Recorded, size: int) -> None:
        held = self._held.get(message.topic.name)
        if held is None:
            self._queue.append(message)
            self._octets += size
        else:
            held[1].append(message)
            self._held_octets += size

    def _keep(self, ring: deque[Recorded], message: Recorded, size: int) -> None:
        ring.append(message)
        self._ring_octets += size
        while self._ring_octets > self._max_octets and len(ring) > 1:
            self._ring_octets -= _size(ring.popleft())

    def snapshot(self) -> int:
        """Hand over what the ring has; return the number of messages."""
        with self._changed:
            if self._ring is None:
                return 0
            count = len(self._ring)
            for message in self._ring:
                self._enqueue(message, _size(message))
            self._ring.clear()
            self._ring_octets = 0
            self._changed.notify_all()
            return count

    def take(self, seconds: float) -> tuple[list[Recorded | TopicMetadata], bool]:
        """Take all that waits, after ``seconds`` or as soon as the cache is half full.

        Returns:
            Topics and messages in their order, and whether the cache is closed.
        """
        with self._changed:
            self._unwritten_octets = 0
            self._changed.wait_for(self._is_urgent, seconds)
            taken, self._queue = self._queue, []
            self._unwritten_octets, self._octets = self._octets, 0
            self._changed.notify_all()
            return taken, self._closed

    def _is_urgent(self) -> bool:
        return self._closed or (bool(self._queue) and self._octets * 2 >= self._max_octets)

    def close(self) -> None:
        """Have `take` return at once, with what was held; what the ring has is dropped.

        Idempotent.
        """
        with self._changed:
            for topic, _ in list(self._held.values()):
                self.add_topic(topic)
            self._closed = True
            self._changed.notify_all()


def _size(message: Recorded) -> int:
    return len(message.cdr) + _OVERHEAD
