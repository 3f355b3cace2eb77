"""Announcements of endpoints (SEDP, RTPS 8.5.4): reliable builtin topics of writers and readers."""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

from . import ids, parameters
from .local import BUILTIN_QOS, LocalReader, LocalWriter
from .outbox import Outbox
from .parameters import EndpointData
from .reader import Sample, StatefulReader
from .reassembly import OctetBudget
from .remote import RemoteParticipant
from .writer import StatefulWriter

# Announcements of ours in the history: there are no more entity ids.
_MAX_OURS: Final = 1 << 24
BUILTIN: Final = (
    ids.BIT_PUBLICATIONS_ANNOUNCER
    | ids.BIT_PUBLICATIONS_DETECTOR
    | ids.BIT_SUBSCRIPTIONS_ANNOUNCER
    | ids.BIT_SUBSCRIPTIONS_DETECTOR
)


class EndpointDiscovery:
    """The builtin endpoints of SEDP of one participant.

    Attributes:
        writers: The two that announce our writers and readers.
        readers: The two that receive announcements of others.

    Args:
        prefix: Our GUID prefix.
        fragment_size: Octets of a fragment.
        outbox: Where announcements go.
        budget: For samples that are incomplete or early.
        deliver: Called with each sample received, and whether it is of a writer.
    """

    def __init__(
        self,
        prefix: bytes,
        fragment_size: int,
        outbox: Outbox,
        budget: OctetBudget,
        deliver: Callable[[Sample, bool], None],
    ) -> None:
        self._prefix = prefix
        self._outbox = outbox

        def writer(entity: bytes) -> LocalWriter:
            guid = prefix + entity
            state = StatefulWriter(guid, True, True, None, fragment_size, _MAX_OURS)
            return LocalWriter(outbox, EndpointData(guid, True, "", "", BUILTIN_QOS), state)

        def reader(entity: bytes, is_writer: bool) -> LocalReader:
            def accept(sample: Sample) -> bool:
                deliver(sample, is_writer)
                return True

            guid = prefix + entity
            state = StatefulReader(guid, True, True, accept, budget)
            return LocalReader(EndpointData(guid, False, "", "", BUILTIN_QOS), state)

        self._publications = writer(ids.PUBLICATIONS_WRITER)
        self._subscriptions = writer(ids.SUBSCRIPTIONS_WRITER)
        self._remote_publications = reader(ids.PUBLICATIONS_READER, True)
        self._remote_subscriptions = reader(ids.SUBSCRIPTIONS_READER, False)
        self.writers = (self._publications, self._subscriptions)
        self.readers = (self._remote_publications, self._remote_subscriptions)

    def announce(self, endpoint: LocalWriter | LocalReader, now: float, wall_ns: int) -> None:
        """Announce one of our endpoints."""
        announcer = self._announcer(endpoint)
        announcer.write(parameters.write_endpoint(endpoint.data), wall_ns, now)
        endpoint.announced = announcer.state.last

    def withdraw(self, endpoint: LocalWriter | LocalReader, now: float, wall_ns: int) -> None:
        """Announce that one of our endpoints is deleted."""
        announcer, guid = self._announcer(endpoint), endpoint.data.guid
        # A late participant needs neither the announcement nor the farewell.
        announcer.state.remove(endpoint.announced)
        announcer.write(
            parameters.write_key(guid), wall_ns, now, parameters.write_farewell_qos(guid),
            is_key=True,
        )  # fmt: skip
        announcer.state.expire(announcer.state.last)

    def _announcer(self, endpoint: LocalWriter | LocalReader) -> LocalWriter:
        return self._publications if endpoint.data.is_writer else self._subscriptions

    def match(self, remote: RemoteParticipant, now: float) -> None:
        """Match the builtin endpoints that a participant says it has."""
        prefix, bits = remote.prefix, remote.data.builtin
        for bit, writer, reader_entity in (
            (ids.BIT_PUBLICATIONS_DETECTOR, self._publications, ids.PUBLICATIONS_READER),
            (ids.BIT_SUBSCRIPTIONS_DETECTOR, self._subscriptions, ids.SUBSCRIPTIONS_READER),
        ):
            if bits & bit:
                packets = writer.state.match(prefix + reader_entity, True, True, now)
                self._outbox.add_packets(writer.state, packets)
        for bit, reader, writer_entity in (
            (ids.BIT_PUBLICATIONS_ANNOUNCER, self._remote_publications, ids.PUBLICATIONS_WRITER),
            (ids.BIT_SUBSCRIPTIONS_ANNOUNCER, self._remote_subscriptions, ids.SUBSCRIPTIONS_WRITER),
        ):
            if bits & bit:
                reader.state.match(prefix + writer_entity, True, now)


def read_announcement(sample: Sample, is_writer: bool) -> EndpointData | bytes | None:
    """Read a sample of SEDP.

    Args:
        sample: The sample.
        is_writer: Whether it comes from the topic of writers.

    Returns:
        The endpoint that it announces; or the GUID of one that is deleted; or None where it says
        nothing, or speaks for another participant than its own.

    Raises:
        MalformedError: It is not valid.
    """
    found: EndpointData | bytes
    if sample.payload is None or sample.is_key:
        qos = sample.inline_qos
        if qos is None or not qos.status:
            return None
        found = guid = (
            qos.key_hash if sample.payload is None else parameters.read_key(sample.payload)
        )
    else:
        found = parameters.read_endpoint(sample.payload, is_writer)
        guid = found.guid
    return found if guid.startswith(sample.writer[: ids.PREFIX_SIZE]) else None
