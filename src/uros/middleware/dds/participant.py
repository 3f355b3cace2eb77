"""DDS participants, each shared by up to 50 nodes of one domain.

One participant a board is what costs the C++ agent 9 MB a board. The price of
sharing is that ``ros_discovery_info`` grows with the nodes of a participant
and is sent whole at every change; so it is sent at most ten times a second.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from functools import partial

from ...qos import QoSProfile
from . import announce, cyclone
from .shared import Shared

MAX_NODES = 50
# A board makes its entities within a few milliseconds: one announcement for all.
_SETTLE = 0.02
_INTERVAL = 0.1


class SharedParticipant:
    """A participant with the groups, topics and node list that its nodes share."""

    def __init__(self, domain: int, gid_size: int) -> None:
        self.domain = domain
        self.entity = cyclone.create_participant(domain, announce.USER_DATA)
        self.guid = cyclone.guid(self.entity)
        self.nodes: list[announce.NodeEntities] = []
        self._groups = Shared[tuple[str, tuple[str, ...]], int](
            lambda key: cyclone.create_group(key[0], self.entity, key[1]), cyclone.delete
        )
        self._topics = Shared[tuple[str, str], int](
            lambda key: cyclone.create_topic(self.entity, *key), cyclone.delete
        )
        self.gid_size = gid_size
        self._sent_at = 0.0
        self.due: float | None = None  # when to announce next
        self._announcer = self.create_writer(announce.TOPIC, announce.TYPE, announce.qos(), b"")

    def create_writer(
        self, name: str, type_name: str, qos: QoSProfile, data: bytes, batching: bool = False
    ) -> int:
        """A writer; :meth:`delete_writer` gives back what it used."""
        create = partial(cyclone.create_writer, batching=batching)
        return self._create("publisher", create, name, type_name, qos, data)

    def create_reader(self, name: str, type_name: str, qos: QoSProfile, data: bytes) -> int:
        """A reader; :meth:`delete_reader` gives back what it used."""
        return self._create("subscriber", cyclone.create_reader, name, type_name, qos, data)

    def _create(
        self,
        group: str,
        create: Callable[[int, int, QoSProfile, bytes], int],
        name: str,
        type_name: str,
        qos: QoSProfile,
        data: bytes,
    ) -> int:
        topic = self._topics.get((name, type_name))
        try:
            owner = self._groups.get((group, qos.partitions))
            try:
                return create(owner, topic, qos, data)
            except BaseException:
                self._groups.release((group, qos.partitions))
                raise
        except BaseException:
            self._topics.release((name, type_name))
            raise

    def delete_writer(self, writer: int, name: str, type_name: str, qos: QoSProfile) -> None:
        self._delete("publisher", writer, name, type_name, qos)

    def delete_reader(self, reader: int, name: str, type_name: str, qos: QoSProfile) -> None:
        self._delete("subscriber", reader, name, type_name, qos)

    def _delete(
        self, group: str, endpoint: int, name: str, type_name: str, qos: QoSProfile
    ) -> None:
        cyclone.delete(endpoint)
        self._groups.release((group, qos.partitions))
        self._topics.release((name, type_name))

    def changed(self) -> None:
        """Nodes or endpoints came or went: announce it soon."""
        if self.due is None:
            self.due = max(time.monotonic() + _SETTLE, self._sent_at + _INTERVAL)

    def announce(self) -> None:
        """Send ``ros_discovery_info`` now."""
        sample = announce.encode(self.guid, self.nodes, self.gid_size)
        sent = cyclone.write(self._announcer, sample)
        self._sent_at = time.monotonic()
        self.due = None if sent else self._sent_at + _INTERVAL

    def close(self) -> None:
        cyclone.delete(self.entity)
