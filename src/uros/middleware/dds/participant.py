"""DDS participants, each shared by up to 50 nodes of one domain.

One participant a board is what costs the C++ agent 9 MB a board. The price of
sharing is that ``ros_discovery_info`` grows with the nodes of a participant
and is sent whole at every change; so it is sent at most ten times a second.
"""

from __future__ import annotations

import time

from ...qos import QoSProfile
from . import announce, cyclone

MAX_NODES = 50
# A board makes its entities within a few milliseconds: one announcement for all.
_SETTLE = 0.02
_INTERVAL = 0.1


class SharedParticipant:
    """A participant with the groups, topics and node list that its nodes share."""

    def __init__(self, domain: int, gid_size: int) -> None:
        self.domain = domain
        self.entity = cyclone.create_participant(domain, b"enclave=/;")
        self.guid = cyclone.guid(self.entity)
        self.nodes: list[announce.NodeEntities] = []
        self._groups: dict[tuple[str, tuple[str, ...]], int] = {}
        self._topics: dict[tuple[str, str], tuple[int, int]] = {}  # entity, users
        self._gid_size = gid_size
        self._sent_at = 0.0
        self.due: float | None = None  # when to announce next
        topic = self.topic(announce.TOPIC, announce.TYPE)
        self._announcer = cyclone.create_writer(
            self.group("publisher", ()), topic, announce.qos(), b""
        )

    def group(self, kind: str, partitions: tuple[str, ...]) -> int:
        """The publisher or subscriber for these partitions."""
        key = (kind, partitions)
        if key not in self._groups:
            self._groups[key] = cyclone.create_group(kind, self.entity, partitions)
        return self._groups[key]

    def topic(self, name: str, type_name: str) -> int:
        """The topic, made for its first user; each user gives it back once."""
        entity, users = self._topics.get((name, type_name), (0, 0))
        if not users:
            entity = cyclone.create_topic(self.entity, name, type_name)
        self._topics[name, type_name] = entity, users + 1
        return entity

    def release_topic(self, name: str, type_name: str) -> None:
        entity, users = self._topics.pop((name, type_name))
        if users == 1:
            cyclone.delete(entity)
        else:
            self._topics[name, type_name] = entity, users - 1

    def create_writer(self, name: str, type_name: str, qos: QoSProfile, data: bytes) -> int:
        topic = self.topic(name, type_name)
        try:
            return cyclone.create_writer(
                self.group("publisher", qos.partitions), topic, qos, data
            )
        except BaseException:
            self.release_topic(name, type_name)
            raise

    def create_reader(self, name: str, type_name: str, qos: QoSProfile, data: bytes) -> int:
        topic = self.topic(name, type_name)
        try:
            return cyclone.create_reader(
                self.group("subscriber", qos.partitions), topic, qos, data
            )
        except BaseException:
            self.release_topic(name, type_name)
            raise

    def changed(self) -> None:
        """Nodes or endpoints came or went: announce it soon."""
        if self.due is None:
            self.due = max(time.monotonic() + _SETTLE, self._sent_at + _INTERVAL)

    def announce(self) -> None:
        """Send ``ros_discovery_info`` now."""
        sample = announce.encode(self.guid, self.nodes, self._gid_size)
        sent = cyclone.write(self._announcer, sample)
        self._sent_at = time.monotonic()
        self.due = None if sent else self._sent_at + _INTERVAL

    def close(self) -> None:
        cyclone.delete(self.entity)
