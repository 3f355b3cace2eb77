"""Reading the graph: who is in a domain, by Cyclone's builtin topics and ``ros_discovery_info``.

Everything is kept under its DDS names; :mod:`uros.host.graph` makes ROS names of them. The
readers are served by the middleware like all others, so :attr:`Discovery.on_change` comes from
its ``dispatch``, in the data plane's thread.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Final

from ...qos import QoSProfile
from . import announce, builtin, cyclone
from .announced import Announced
from .reader_listener import Watched
from .service_forms import OFFER

if TYPE_CHECKING:
    from .middleware import DdsMiddleware
    from .participant import SharedParticipant

_BATCH: Final = 256
# Attack: endpoints that come and go without end. Batches in one turn; others come between.
_BATCHES: Final = 4


@dataclass(frozen=True)
class Endpoint:
    """A writer or a reader on the network; ``qos.user_data`` is what it announces itself."""

    guid: bytes
    participant: bytes
    is_writer: bool
    topic: str
    type_name: str
    qos: QoSProfile


class Peers:
    """The participants that one of ours has discovered, itself included, and their nodes.

    ``participants`` maps a GUID to its USER_DATA, ``announced`` and ``gid_sizes`` are what
    :class:`.announced.Announced` has; these may come before the participant itself is known.
    ``on_change`` is called after each batch of news.
    """

    def __init__(
        self,
        middleware: DdsMiddleware,
        participant: SharedParticipant,
        on_change: Callable[[], None],
    ) -> None:
        self.participants: dict[bytes, bytes] = {}
        self._on_change = on_change
        self._middleware = middleware
        self._participant = participant
        self._closers: list[Callable[[], None]] = []
        try:
            for topic, take in self._builtin_topics():
                reader = builtin.create_reader(participant.entity, topic)
                self._watch(reader, take, partial(cyclone.delete, reader))
            self.announcements = Announced(middleware, participant, on_change)
            self._closers.append(self.announcements.close)
        except BaseException:
            self.close()
            raise

    @property
    def announced(self) -> dict[bytes, list[announce.NodeEntities]]:
        return self.announcements.nodes

    @property
    def gid_sizes(self) -> dict[bytes, int]:
        return self.announcements.gid_sizes

    def ask_again(self) -> None:
        """Read ``ros_discovery_info`` anew."""
        self.announcements.ask_again()

    def _builtin_topics(self) -> list[tuple[int, Callable[[int], int]]]:
        return [(builtin.TOPIC_PARTICIPANT, self._take_participants)]

    def _watch(
        self,
        entity: int,
        take: Callable[[int], int],
        delete: Callable[[], None],
    ) -> None:
        def on_ready() -> None:
            reader.taken = True
            for _ in range(_BATCHES):
                if take(entity) < _BATCH:
                    break
            else:
                self._middleware.again(reader)
            self._on_change()

        reader = Watched(self._middleware, entity, on_ready)

        def close() -> None:
            self._middleware.unwatch(reader)
            delete()

        self._closers.append(close)

    def _take_participants(self, entity: int) -> int:
        news = builtin.take_participants(entity, _BATCH)
        for guid, qos in news:
            if qos is None:
                self.participants.pop(guid, None)
                self.announcements.forget(guid)
            else:
                self.participants[guid] = qos.user_data
        return len(news)

    def close(self) -> None:
        """Stop reading. Twice is once."""
        for close in self._closers:
            close()
        self._closers.clear()


class Discovery(Peers):
    """These, and what they write and read: ``endpoints`` maps a GUID to the endpoint."""

    def __init__(
        self,
        middleware: DdsMiddleware,
        participant: SharedParticipant,
        on_change: Callable[[], None],
    ) -> None:
        self.endpoints: dict[bytes, Endpoint] = {}
        super().__init__(middleware, participant, on_change)

    def _builtin_topics(self) -> list[tuple[int, Callable[[int], int]]]:
        return [
            *super()._builtin_topics(),
            (builtin.TOPIC_PUBLICATION, self._take_writers),
            (builtin.TOPIC_SUBSCRIPTION, self._take_readers),
        ]

    def silent(self) -> set[bytes]:
        """The ROS participants (they have an enclave) that did not tell their nodes yet."""
        return {
            guid
            for guid, data in self.participants.items()
            if b"enclave=" in data and guid not in self.announced
        }

    def unheard(self) -> set[bytes]:
        """The silent ones that have a writer to tell them by; see :meth:`ask_again`."""
        tellers = {
            end.participant
            for end in self.endpoints.values()
            if end.is_writer and end.topic == announce.TOPIC
        }
        return self.silent() & tellers

    def missing(self) -> set[bytes]:
        """The endpoints that nodes are said to have and that were not discovered yet."""
        return {
            gid
            for participant, nodes in self.announced.items()
            if participant in self.participants
            for node in nodes
            for gid in (*node.readers, *node.writers)
            if gid not in self.endpoints
        }

    def empty(self) -> set[bytes]:
        """The participants without any endpoint, so far."""
        return self.participants.keys() - {end.participant for end in self.endpoints.values()}

    def _take_writers(self, entity: int) -> int:
        return self._take_endpoints(entity, True)

    def _take_readers(self, entity: int) -> int:
        return self._take_endpoints(entity, False)

    def _take_endpoints(self, entity: int, is_writer: bool) -> int:
        news = builtin.take_endpoints(entity, _BATCH)
        for guid, about in news:
            if about is None:
                self.endpoints.pop(guid, None)
            else:
                participant, topic, type_name, qos = about
                if OFFER in qos.user_data:
                    continue  # there for a moment, and nobody's
                self.endpoints[guid] = Endpoint(guid, participant, is_writer, topic, type_name, qos)
        return len(news)
