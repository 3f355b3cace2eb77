"""Reading the graph: who is in a domain, by Cyclone's builtin topics and ``ros_discovery_info``.

Everything is kept under its DDS names; :mod:`uros.host.graph` makes ROS names of them. The
readers are served by the middleware like all others, so :attr:`Discovery.on_change` comes from
its ``dispatch``, in the data plane's thread.
"""

from __future__ import annotations

import struct
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Final

from ...qos import HistoryPolicy, QoSProfile
from . import announce, builtin, config, cyclone
from .forms import OFFER
from .watched import Watched

if TYPE_CHECKING:
    from .middleware import DdsMiddleware
    from .participant import SharedParticipant

_BATCH: Final = 256
_GUID_SIZE: Final = 16
# Attack: a peer that announces the nodes of one participant after the other that does not exist.
MAX_ANNOUNCED: Final = 4096


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

    ``participants`` maps a GUID to its USER_DATA, ``announced`` a participant's GUID to the nodes
    that it says it has, and ``gid_sizes`` to the bytes of a Gid in what it says; both may come
    before the participant itself is known. ``on_change`` is called after each batch of news.
    """

    def __init__(
        self,
        middleware: DdsMiddleware,
        participant: SharedParticipant,
        on_change: Callable[[], None],
    ) -> None:
        self.participants: dict[bytes, bytes] = {}
        self.announced: dict[bytes, list[announce.NodeEntities]] = {}
        self.gid_sizes: dict[bytes, int] = {}
        self._on_change = on_change
        self._middleware = middleware
        self._participant = participant
        self._closers: list[Callable[[], None]] = []
        try:
            for topic, take in self._builtin_topics():
                reader = builtin.create_reader(participant.entity, topic)
                self._watch(reader, take, partial(cyclone.delete, reader))
            self._listen()
        except BaseException:
            self.close()
            raise

    def _builtin_topics(self) -> list[tuple[int, Callable[[int], int]]]:
        return [(builtin.TOPIC_PARTICIPANT, self._take_participants)]

    def ask_again(self) -> None:
        """Read ``ros_discovery_info`` anew.

        A Fast DDS writer offers what it has when it meets a reader. Where the reader does not know
        the writer by then, the offer is lost and comes again with the next heartbeat, after up to
        three seconds; a new reader gets it at once.
        """
        self._closers.pop()()
        self._listen()

    def _listen(self) -> None:
        participant = self._participant
        qos = announce.qos()
        qos.history = HistoryPolicy.KEEP_ALL  # the topic has no key: one must not displace another
        about = announce.TOPIC, announce.TYPE, qos
        entity = participant.create_reader(*about, b"")
        self._watch(
            entity, self._take_announcements, lambda: participant.delete_reader(entity, *about)
        )

    def _watch(
        self,
        entity: int,
        take: Callable[[int], int],
        delete: Callable[[], None],
    ) -> None:
        def on_ready() -> None:
            reader.taken = True
            while take(entity) == _BATCH:
                pass
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
                self.announced.pop(guid, None)
                self.gid_sizes.pop(guid, None)
            else:
                self.participants[guid] = qos.user_data
        return len(news)

    def _take_announcements(self, entity: int) -> int:
        news = cyclone.take(entity, _BATCH)
        for sample, _info in news:
            decoded = decode(sample)
            if decoded is None:
                continue
            if decoded[0] in self.announced or len(self.announced) < MAX_ANNOUNCED:
                guid, self.announced[guid], self.gid_sizes[guid] = decoded
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


# --- ros_discovery_info -----------------------------------------------------------


def decode(sample: bytes) -> tuple[bytes, list[announce.NodeEntities], int] | None:
    """The participant's GUID, its nodes and the bytes of a Gid; None for what is no such message.

    Nothing in a sample tells whether its Gids have 16 bytes (from Iron on) or 24: the size with
    which the message ends where the sample ends, and strings are strings, is the right one.
    """
    if len(sample) < 4 or sample[0] != 0 or sample[1] > 1:
        return None
    for gid_size in (config.SHORT_GID, config.LONG_GID):
        try:
            return *_Decoder(sample, gid_size).message(), gid_size
        except (ValueError, struct.error):
            pass
    return None


class _Decoder:
    """CDR of one ``ParticipantEntitiesInfo``; ValueError or struct.error where it does not fit."""

    def __init__(self, sample: bytes, gid_size: int) -> None:
        self._data = memoryview(sample)[4:]
        self._count = struct.Struct("<I" if sample[1] else ">I")
        self._gid_size = gid_size
        self._offset = 0

    def message(self) -> tuple[bytes, list[announce.NodeEntities]]:
        guid = self._gid()
        nodes = [
            announce.NodeEntities(self._text(), self._text(), self._gids(), self._gids())
            for _ in range(self._number())
        ]
        rest = bytes(self._data[self._offset :])
        if len(rest) > 3 or any(rest):
            raise ValueError("octets are left")
        return guid, nodes

    def _number(self) -> int:
        self._offset += -self._offset % 4
        number: int = self._count.unpack_from(self._data, self._offset)[0]
        self._offset += 4
        if number > len(self._data) - self._offset:  # everything counted has an octet or more
            raise ValueError("more than the sample holds")
        return number

    def _bytes(self, size: int) -> bytes:
        start, self._offset = self._offset, self._offset + size
        if self._offset > len(self._data):
            raise ValueError("the sample ends early")
        return bytes(self._data[start : self._offset])

    def _text(self) -> str:
        raw = self._bytes(self._number())
        if raw[-1:] != b"\0":
            raise ValueError("a string without its end")
        return raw[:-1].decode()

    def _gids(self) -> list[bytes]:
        return [self._gid() for _ in range(self._number())]

    def _gid(self) -> bytes:
        raw = self._bytes(self._gid_size)
        if any(raw[_GUID_SIZE:]):
            raise ValueError("a padding that is none")
        return raw[:_GUID_SIZE]
