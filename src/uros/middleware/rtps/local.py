"""Our writers and readers in a domain: what is announced of them, and their state."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

from ...qos import QoSProfile
from ..qos_matching import Mismatch, mismatches, shorten
from . import ids
from .outbox import Outbox
from .parameters import EndpointData
from .reader import StatefulReader
from .remote import RemoteParticipant
from .schedule import Schedule
from .writer import StatefulWriter

EndpointSchedule = Schedule[StatefulWriter | StatefulReader | RemoteParticipant]


class LocalWriter:
    """A writer of ours.

    Attributes:
        data: What is announced of it.
        state: Its history and its matched readers.
        wants_header: Returns whether a reader expects the identity of a request in the payload.
        on_match: Called with the GUID of a reader that matches.
        on_leave: Called with the GUID of a reader of its topic that leaves, matched or not, or with
            the prefix of a participant that does.
        announced: The number of its announcement.
    """

    def __init__(self, outbox: Outbox, data: EndpointData, state: StatefulWriter) -> None:
        self.data = data
        self.state = state
        self.wants_header: Callable[[EndpointData], bool] = lambda reader: False
        self.on_match: Callable[[bytes], None] = lambda guid: None
        self.on_leave: Callable[[bytes], None] = lambda guid: None
        self.announced = 0
        self._outbox = outbox

    def write(
        self, payload: bytes, time_ns: int | None, now: float, inline_qos: bytes = b"",
        readers: frozenset[bytes] | None = None, with_header: bytes | None = None,
        is_key: bool = False,
    ) -> bool:  # fmt: skip
        """Write a sample; see :meth:`StatefulWriter.write`.

        Returns:
            False where there is no room in the history: nothing was written.
        """
        state = self.state
        if state.depth is None and not state.has_room():
            return False
        packets = state.write(payload, time_ns, now, inline_qos, readers, is_key, with_header)
        if packets:
            self._outbox.add_packets(state, packets)
        if state.reliable_readers:
            self._outbox.burst.add(state)
        return True

    def write_once(self, payload: bytes, time_ns: int) -> bool:
        """Write a sample that the history does not keep.

        Returns:
            False if the history must keep it: nothing was written, call :meth:`write`.
        """
        octets = self.state.write_once(payload, time_ns)
        if octets:
            self._outbox.add_for_all(self.state, octets)
        return octets is not None

    def matched(self) -> int:
        """Return how many readers match it."""
        return len(self.state.readers)


class LocalReader:
    """A reader of ours.

    Attributes:
        data: What is announced of it.
        state: Its matched writers, and what it has of each.
        announced: The number of its announcement.
    """

    def __init__(self, data: EndpointData, state: StatefulReader) -> None:
        self.data = data
        self.state = state
        self.announced = 0


class LocalEndpoints:
    """Our endpoints in a domain.

    Attributes:
        writers: The writers by entity id, builtin ones included.
        readers: The readers by entity id, builtin ones included.
    """

    def __init__(self) -> None:
        self.writers: dict[bytes, LocalWriter] = {}
        self.readers: dict[bytes, LocalReader] = {}
        # A datagram must not cost more with more endpoints.
        self._by_topic: dict[str, list[LocalWriter | LocalReader]] = {}

    def add(self, endpoint: LocalWriter | LocalReader) -> None:
        """Add an endpoint."""
        entity = endpoint.data.guid[ids.PREFIX_SIZE :]
        if isinstance(endpoint, LocalWriter):
            self.writers[entity] = endpoint
        else:
            self.readers[entity] = endpoint
        self._by_topic.setdefault(endpoint.data.topic, []).append(endpoint)

    def remove(self, endpoint: LocalWriter | LocalReader) -> bool:
        """Remove an endpoint; return False where it was removed before."""
        entity = endpoint.data.guid[ids.PREFIX_SIZE :]
        if isinstance(endpoint, LocalWriter):
            removed = self.writers.pop(entity, None) is not None
        else:
            removed = self.readers.pop(entity, None) is not None
        if removed:
            same = self._by_topic[endpoint.data.topic]
            same.remove(endpoint)
            if not same:
                del self._by_topic[endpoint.data.topic]
        return removed

    def counterparts(self, theirs: EndpointData) -> list[LocalWriter | LocalReader]:
        """Return those of the topic of another endpoint that are of the other kind."""
        return [
            ours
            for ours in self._by_topic.get(theirs.topic, ())
            if ours.data.is_writer != theirs.is_writer
        ]

    def readers_of(self, guid: bytes, topic: str) -> list[StatefulReader]:
        """Return the readers that match a writer of others; builtin ones have no topic."""
        return [
            ours.state
            for ours in self._by_topic.get(topic, ())
            if isinstance(ours, LocalReader) and guid in ours.state.writers
        ]


def lifespan(qos: QoSProfile) -> float:
    """Return the lifespan of samples in seconds; infinity: without end."""
    return qos.lifespan_ms / 1000 if qos.lifespan_ms else math.inf


def why_unmatched(writer: EndpointData, reader: EndpointData) -> list[Mismatch] | None:
    """Return what keeps two endpoints from matching; None if their topics or types differ.

    Of the data representations that a writer announces, the first one counts: it writes in that
    one. A reader accepts each of its own (XTypes 7.6.3.1.1).
    """
    if writer.topic != reader.topic or writer.type_name != reader.type_name:
        return None
    why = mismatches(writer.qos, reader.qos)
    offered = writer.representations[:1]
    if not set(offered) & set(reader.representations):
        why.append(
            Mismatch(
                "data representation",
                _representation_names(offered),
                _representation_names(reader.representations),
            )
        )
    return why


def _representation_names(representations: Sequence[int]) -> str:
    return shorten([ids.REPRESENTATION_NAMES.get(one, str(one)) for one in representations])
