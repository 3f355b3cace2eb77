"""The messages between the network and the disk: a bounded queue, or a ring for snapshots."""

from __future__ import annotations

import threading
from collections import deque
from typing import Final, NamedTuple

from ...bag.metadata import TopicMetadata

# What a message takes in memory besides its octets, about.
_OVERHEAD: Final = 200


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
        self._closed = False
        self.dropped = 0

    def add_topic(self, topic: TopicMetadata) -> None:
        """Hand over a topic, before its messages."""
        with self._changed:
            self._queue.append(topic)

    def add(self, message: Recorded) -> None:
        """Hand over a message, or drop it."""
        size = len(message.cdr) + _OVERHEAD
        with self._changed:
            if self._closed:
                self.dropped += 1
                return
            if self._ring is not None:
                self._keep(self._ring, message, size)
                return
            if not self._max_octets:
                self._changed.wait_for(lambda: self._closed or not self._queue)
            elif self._octets + self._unwritten_octets + size > self._max_octets:
                self.dropped += 1
                return
            self._queue.append(message)
            self._octets += size
            if self._octets * 2 >= self._max_octets:
                self._changed.notify_all()

    def _keep(self, ring: deque[Recorded], message: Recorded, size: int) -> None:
        ring.append(message)
        self._ring_octets += size
        while self._ring_octets > self._max_octets and len(ring) > 1:
            self._ring_octets -= len(ring.popleft().cdr) + _OVERHEAD

    def snapshot(self) -> int:
        """Hand over what the ring has; return the number of messages."""
        with self._changed:
            if self._ring is None:
                return 0
            count = len(self._ring)
            self._queue += self._ring
            self._octets += self._ring_octets
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
        """Have `take` return at once; what the ring has is dropped. Idempotent."""
        with self._changed:
            self._closed = True
            self._changed.notify_all()
