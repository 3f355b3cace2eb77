"""Reading the graph of a domain: Cyclone's builtin topics and ``ros_discovery_info``.

Everything is kept under its DDS names; :mod:`uros.host.graph_queries` makes ROS names of them. The
readers are dispatched like all others, so ``on_change`` is called in the data plane's thread.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Final

from ...qos import QoSProfile
from .. import user_data
from ..discovery_info import codec
from . import builtin, cyclone
from .context import DdsContext
from .discovery_info_reader import DiscoveryInfoReader
from .dispatcher import ReaderListener
from .participant import SharedParticipant

_BATCH: Final = 256
# How many batches are taken at a time, so that endpoints that are created and deleted without end
# do not hold up the data plane. The rest is taken when the data plane dispatches again.
_BATCHES: Final = 4


@dataclass(frozen=True)
class Endpoint:
    """A discovered writer or reader; ``qos.user_data`` is the USER_DATA it announces."""

    guid: bytes
    participant: bytes
    is_writer: bool
    topic: str
    type_name: str
    qos: QoSProfile


class ParticipantDiscovery:
    """The participants that one of ours has discovered, itself included, and their nodes.

    Attributes:
        participants: USER_DATA of each participant, by its GUID.

    Args:
        context: What the parts of the middleware share.
        participant: The participant whose discovery is read.
        on_change: Called after each batch of changes.
    """

    def __init__(
        self,
        context: DdsContext,
        participant: SharedParticipant,
        on_change: Callable[[], None],
    ) -> None:
        self.participants: dict[bytes, bytes] = {}
        self._on_change = on_change
        self._context = context
        self._closers: list[Callable[[], None]] = []
        try:
            for topic, take in self._builtin_topics():
                reader = builtin.create_reader(participant.entity, topic)
                self._listen(reader, take, partial(cyclone.delete, reader))
            self._info_reader = DiscoveryInfoReader(context, participant, on_change)
            self._closers.append(self._info_reader.close)
        except BaseException:
            self.close()
            raise

    @property
    def announced(self) -> dict[bytes, list[codec.NodeEntities]]:
        """The nodes of each participant, by its GUID, which may not be discovered yet."""
        return self._info_reader.intake.nodes

    @property
    def gid_sizes(self) -> dict[bytes, int]:
        """Octets of a Gid in each participant's discovery info, by its GUID."""
        return self._info_reader.intake.gid_sizes

    def reread_discovery_info(self) -> None:
        """Read ``ros_discovery_info`` again with a new reader."""
        self._info_reader.recreate()

    def _builtin_topics(self) -> list[tuple[int, Callable[[int], int]]]:
        return [(builtin.TOPIC_PARTICIPANT, self._take_participants)]

    def _listen(
        self,
        entity: int,
        take: Callable[[int], int],
        delete: Callable[[], None],
    ) -> None:
        dispatcher = self._context.dispatcher

        def on_ready() -> None:
            listener.taken = True
            for _ in range(_BATCHES):
                if take(entity) < _BATCH:
                    break
            else:
                dispatcher.requeue(listener)
            self._on_change()

        listener = ReaderListener(dispatcher, entity, on_ready)

        def close() -> None:
            dispatcher.unwatch(listener)
            delete()

        self._closers.append(close)

    def _take_participants(self, entity: int) -> int:
        changes = builtin.take_participants(entity, _BATCH)
        for guid, qos in changes:
            if qos is None:
                self.participants.pop(guid, None)
                self._info_reader.intake.forget(guid)
            else:
                self.participants[guid] = qos.user_data
        return len(changes)

    def close(self) -> None:
        """Stop reading; idempotent."""
        for close in self._closers:
            close()
        self._closers.clear()


class GraphDiscovery(ParticipantDiscovery):
    """The participants, their nodes, and what they write and read.

    Attributes:
        endpoints: The endpoints by their GUIDs.
    """

    def __init__(
        self,
        context: DdsContext,
        participant: SharedParticipant,
        on_change: Callable[[], None],
    ) -> None:
        self.endpoints: dict[bytes, Endpoint] = {}
        super().__init__(context, participant, on_change)

    def _builtin_topics(self) -> list[tuple[int, Callable[[int], int]]]:
        return [
            *super()._builtin_topics(),
            (builtin.TOPIC_PUBLICATION, self._take_writers),
            (builtin.TOPIC_SUBSCRIPTION, self._take_readers),
        ]

    def _take_writers(self, entity: int) -> int:
        return self._take_endpoints(entity, True)

    def _take_readers(self, entity: int) -> int:
        return self._take_endpoints(entity, False)

    def _take_endpoints(self, entity: int, is_writer: bool) -> int:
        changes = builtin.take_endpoints(entity, _BATCH)
        for guid, endpoint in changes:
            if endpoint is None:
                self.endpoints.pop(guid, None)
            else:
                participant, topic, type_name, qos = endpoint
                if user_data.PROBE_READER in qos.user_data:
                    continue  # temporary, and no node has it
                self.endpoints[guid] = Endpoint(guid, participant, is_writer, topic, type_name, qos)
        return len(changes)
