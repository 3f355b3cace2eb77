"""DDS participants, each shared by up to 50 nodes of one domain.

One participant a board is what costs the C++ agent 9 MB a board. The price of sharing is that
``ros_discovery_info`` grows with the nodes of a participant and is sent whole at every change; so
it is sent at most ten times a second.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from functools import partial

from ...qos import QoSProfile
from .. import user_data
from ..discovery_info import codec
from ..ref_counted import RefCounted
from . import cyclone

MAX_NODES = 50
# Seconds from the first change to the message. A board creates its entities within a few
# milliseconds, so that one message tells of all.
_SETTLE = 0.02
_INTERVAL = 0.1


class SharedParticipant:
    """A participant with the groups, topics and node list that its nodes share.

    Attributes:
        domain: Its domain.
        entity: The DDS entity.
        guid: Its GUID.
        nodes: The nodes on it; after a change call :meth:`changed`.
        gid_size: Octets of a Gid in its discovery info.
        due: When :meth:`tick` writes the discovery info (``time.monotonic``), or None.
    """

    def __init__(self, domain: int, gid_size: int) -> None:
        self.domain = domain
        self.entity = cyclone.create_participant(domain, user_data.PARTICIPANT)
        self.guid = cyclone.guid(self.entity)
        self.nodes: list[codec.NodeEntities] = []
        self._groups = RefCounted[tuple[str, tuple[str, ...]], int](
            lambda key: cyclone.create_group(key[0], self.entity, key[1]), cyclone.delete
        )
        self._topics = RefCounted[tuple[str, str], int](
            lambda key: cyclone.create_topic(self.entity, *key), cyclone.delete
        )
        self.gid_size = gid_size
        self._sent_at = 0.0
        self.due: float | None = None
        self._info_writer = self.create_writer(codec.TOPIC, codec.TYPE, codec.qos(), b"")

    def create_writer(
        self, name: str, type_name: str, qos: QoSProfile, data: bytes, batching: bool = False
    ) -> int:
        """Create a writer; :meth:`delete_writer` releases what it uses.

        Args:
            name: The DDS name of the topic.
            type_name: The DDS name of the type.
            qos: The profile.
            data: USER_DATA besides the profile's.
            batching: Whether samples wait for a flush.

        Raises:
            MiddlewareError: DDS refuses it.
        """
        create = partial(cyclone.create_writer, batching=batching)
        return self._create("publisher", create, name, type_name, qos, data)

    def create_reader(self, name: str, type_name: str, qos: QoSProfile, data: bytes) -> int:
        """Create a reader; :meth:`delete_reader` releases what it uses."""
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
        topic = self._topics.acquire((name, type_name))
        try:
            owner = self._groups.acquire((group, qos.partitions))
            try:
                return create(owner, topic, qos, data)
            except BaseException:
                self._groups.release((group, qos.partitions))
                raise
        except BaseException:
            self._topics.release((name, type_name))
            raise

    def delete_writer(self, writer: int, name: str, type_name: str, qos: QoSProfile) -> None:
        """Delete a writer, given what it was created with."""
        self._delete("publisher", writer, name, type_name, qos)

    def delete_reader(self, reader: int, name: str, type_name: str, qos: QoSProfile) -> None:
        """Delete a reader, given what it was created with."""
        self._delete("subscriber", reader, name, type_name, qos)

    def _delete(
        self, group: str, endpoint: int, name: str, type_name: str, qos: QoSProfile
    ) -> None:
        cyclone.delete(endpoint)
        self._groups.release((group, qos.partitions))
        self._topics.release((name, type_name))

    def changed(self) -> None:
        """Schedule discovery info: nodes or endpoints were created or closed."""
        if self.due is None:
            self.due = max(time.monotonic() + _SETTLE, self._sent_at + _INTERVAL)

    def tick(self, now: float) -> None:
        """Write the discovery info; if the writer has no room, again after a pause."""
        sample = codec.encode(self.guid, self.nodes, self.gid_size)
        sent = cyclone.write(self._info_writer, sample)
        self._sent_at = time.monotonic()
        self.due = None if sent else self._sent_at + _INTERVAL

    def close(self) -> None:
        """Delete the participant with all that it contains."""
        cyclone.delete(self.entity)
