"""One participant of ours in a domain: discovery, its endpoints, and what goes to whom.

A :class:`Participant` takes datagrams and the time, and gives datagrams, samples and a deadline. It
uses neither sockets nor a clock.

Discovery is that of RTPS 8.5: each participant announces itself (SPDP), and tells those that it has
heard its writers and readers over reliable builtin topics (SEDP). Nothing that a peer announces is
believed beyond what can be checked: datagrams are sent only to addresses that the peer was heard
from, or that the user configured; a farewell counts only from such an address.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Final

from ...qos import DurabilityPolicy, HistoryPolicy, QoSProfile
from ..qos_matching import Mismatch, mismatches
from . import ids, parameters, submessages
from .locators import Locator
from .parameters import EndpointData, ParticipantData
from .reader import Sample, StatefulReader
from .reassembly import OctetBudget
from .submessages import (
    AckNack,
    Data,
    DataFrag,
    Gap,
    Heartbeat,
    HeartbeatFrag,
    InfoDestination,
    InfoSource,
    MalformedError,
    NackFrag,
)
from .writer import Packet, StatefulWriter

# Octets of a message. Wi-Fi loses the fragments of larger IP datagrams.
MESSAGE_SIZE: Final = 1400
# What a message has besides fragments: headers, INFO_DST, INFO_TS, DATA_FRAG, a heartbeat.
_FRAGMENT_OVERHEAD: Final = 180
# Seconds after which a peer that hears nothing of us counts us as gone, and between announcements:
# some at once, as the first ones may be lost.
LEASE_MS: Final = 20_000
_FIRST_ANNOUNCEMENTS: Final = (0.1, 0.2, 0.5, 1.0)
_ANNOUNCEMENT_PERIOD: Final = 3.0
# Attack: participants and endpoints without end.
MAX_PARTICIPANTS: Final = 1000
MAX_ENDPOINTS: Final = 5000  # of one participant
# Attack: a participant that never leaves. The longest lease that is believed, in ms.
MAX_LEASE_MS: Final = 600_000
# Octets of early and incomplete samples of all readers.
MAX_HELD: Final = 64 * 1024 * 1024
_BUILTIN: Final = (
    ids.BIT_PARTICIPANT_ANNOUNCER
    | ids.BIT_PARTICIPANT_DETECTOR
    | ids.BIT_PUBLICATIONS_ANNOUNCER
    | ids.BIT_PUBLICATIONS_DETECTOR
    | ids.BIT_SUBSCRIPTIONS_ANNOUNCER
    | ids.BIT_SUBSCRIPTIONS_DETECTOR
)
_BUILTIN_QOS: Final = QoSProfile(
    durability=DurabilityPolicy.TRANSIENT_LOCAL, history=HistoryPolicy.KEEP_ALL
)


def why_unmatched(writer: EndpointData, reader: EndpointData) -> list[Mismatch] | None:
    """Return what keeps two endpoints from matching; None if their topics or types differ."""
    if writer.topic != reader.topic or writer.type_name != reader.type_name:
        return None
    why = mismatches(writer.qos, reader.qos)
    if not set(writer.representations) & set(reader.representations):
        why.append(Mismatch("data representation", "XCDR1", "XCDR2"))
    return why


class LocalWriter:
    """A writer of ours.

    Attributes:
        data: What is announced of it.
        state: Its history and its matched readers.
        wants_header: Returns whether a reader expects the identity of a request in the payload.
        on_match: Called with the GUID of a reader that matches.
    """

    def __init__(self, participant: Participant, data: EndpointData, state: StatefulWriter) -> None:
        self.data = data
        self.state = state
        self.wants_header: Callable[[EndpointData], bool] = lambda reader: False
        self.on_match: Callable[[bytes], None] = lambda guid: None
        self._participant = participant
        self.announced = 0  # the number of its announcement

    def write(
        self, payload: bytes, time_ns: int, now: float, inline_qos: bytes = b"",
        readers: frozenset[bytes] | None = None, with_header: bytes | None = None,
    ) -> bool:  # fmt: skip
        """Write a sample; see :meth:`StatefulWriter.write`.

        Returns:
            False where there is no room in the history: nothing was written.
        """
        if not self.state.has_room():
            return False
        packets = self.state.write(payload, time_ns, now, inline_qos, readers, False, with_header)
        self._participant.send_packets(self.state, packets)
        self._participant.burst.add(self)
        return True

    def matched(self) -> int:
        """Return how many readers match it."""
        return len(self.state.readers)


class LocalReader:
    """A reader of ours.

    Attributes:
        data: What is announced of it.
        state: Its matched writers, and what it has of each.
    """

    def __init__(self, data: EndpointData, state: StatefulReader) -> None:
        self.data = data
        self.state = state
        self.announced = 0


class RemoteParticipant:
    """A participant that was heard.

    Attributes:
        data: What it announces of itself.
        heard: The addresses that it was heard from, the first one first.
        expires: When it counts as gone.
        endpoints: Its endpoints by GUID.
        received: Octets that came from it.
        is_proven: Whether it has answered us, and so receives what is sent to its address.
    """

    def __init__(self, data: ParticipantData) -> None:
        self.data = data
        self.heard: dict[str, None] = {}
        self.expires = float("inf")
        self.endpoints: dict[bytes, EndpointData] = {}
        self.received = 0
        self.is_proven = False
        self._sent = 0  # octets, until it is proven

    def may_send(self, octets: int) -> bool:
        """Count octets to be sent; return whether they may.

        Attack: announcements with the address of somebody else. Until a participant has answered,
        it gets no more octets than came from it; the protocol repeats what was left out.
        """
        if self.is_proven:
            return True
        if self._sent + octets > self.received:
            return False
        self._sent += octets
        return True

    @property
    def prefix(self) -> bytes:
        """Its GUID prefix."""
        return self.data.guid[: ids.PREFIX_SIZE]

    def place(self, announced: Iterable[Locator]) -> Locator | None:
        """Return the first of the announced locators at an address that it was heard from.

        A participant behind a translation of addresses announces none of those: then it is the
        announced port at the address that was heard.
        """
        announced = [locator for locator in announced if not locator.is_multicast]
        for locator in announced:
            if locator.address in self.heard:
                return locator
        if announced and self.heard:
            return announced[0]._replace(address=next(iter(self.heard)))
        return None


class Participant:
    """A participant of ours; see the module.

    Attributes:
        guid: Its GUID.
        outgoing: Datagrams to send, each with where to.
        remotes: The participants heard, by GUID prefix.
        writers: Our writers by entity id, builtin ones included.
        readers: Our readers by entity id, builtin ones included.
        burst: Writers that have written since the last :meth:`flush`.
        malformed: Datagrams that were not valid, in part or as a whole.
        on_participant: Called with a participant that comes or changes (True), or goes (False).
        on_endpoint: The same with an endpoint of others.
        on_mismatch: Called with a local endpoint, a remote one of its topic, and why they do not
            match.

    Args:
        prefix: The GUID prefix, 12 octets that begin with our vendor id.
        domain: The domain.
        unicast: Where we receive, announced for discovery and data.
        multicast: Where all participants of the domain receive announcements.
        peers: Further places to announce to.
        user_data: USER_DATA of the participant.
        now: The time in seconds.
        message_size: The most octets of a datagram.
    """

    def __init__(
        self,
        prefix: bytes,
        domain: int,
        unicast: list[Locator],
        multicast: list[Locator],
        peers: list[Locator],
        user_data: bytes,
        now: float,
        message_size: int = MESSAGE_SIZE,
    ) -> None:
        self.guid = prefix + ids.ENTITY_PARTICIPANT
        self.outgoing: list[tuple[bytes, Locator]] = []
        self.remotes: dict[bytes, RemoteParticipant] = {}
        self.writers: dict[bytes, LocalWriter] = {}
        self.readers: dict[bytes, LocalReader] = {}
        self.burst: set[LocalWriter] = set()
        self.malformed = 0
        self.on_participant: Callable[[ParticipantData, bool], None] = lambda data, is_there: None
        self.on_endpoint: Callable[[EndpointData, bool], None] = lambda data, is_there: None
        self.on_mismatch: Callable[[EndpointData, EndpointData, list[Mismatch]], None] = (
            lambda ours, theirs, why: None
        )
        self._prefix = prefix
        self._domain = domain
        self._announce_to = [*multicast, *peers]
        self._message_size = message_size
        self._budget = OctetBudget(MAX_HELD)
        self._next_key = 0
        self._data = ParticipantData(
            self.guid, ids.VENDOR, ids.VERSION, domain, "", _BUILTIN, LEASE_MS,
            unicast, multicast, unicast, [], user_data,
        )  # fmt: skip
        self._announcements = 0  # sent, which are numbered
        self._periods = 0  # of announcements to all
        self._announce_at = now
        self._now = now
        self._pending: dict[tuple[Locator, bytes], list[bytes]] = {}
        self._publications = self._builtin_writer(ids.PUBLICATIONS_WRITER)
        self._subscriptions = self._builtin_writer(ids.SUBSCRIPTIONS_WRITER)
        self._builtin_reader(ids.PUBLICATIONS_READER, True)
        self._builtin_reader(ids.SUBSCRIPTIONS_READER, False)
        self._closed = False

    def _builtin_writer(self, entity: bytes) -> LocalWriter:
        guid = self._prefix + entity
        state = StatefulWriter(guid, True, True, None, self._fragment_size, MAX_ENDPOINTS)
        data = EndpointData(guid, True, "", "", _BUILTIN_QOS)
        writer = self.writers[entity] = LocalWriter(self, data, state)
        return writer

    def _builtin_reader(self, entity: bytes, is_writer: bool) -> None:
        guid = self._prefix + entity

        def deliver(sample: Sample) -> bool:
            self._on_endpoint(sample, is_writer)
            return True

        state = StatefulReader(guid, True, True, deliver, self._budget)
        data = EndpointData(guid, False, "", "", _BUILTIN_QOS)
        self.readers[entity] = LocalReader(data, state)

    @property
    def _fragment_size(self) -> int:
        return (self._message_size - _FRAGMENT_OVERHEAD) & ~3

    # --- our endpoints ---------------------------------------------------------------------

    def create_writer(
        self, topic: str, type_name: str, qos: QoSProfile, now: float, wall_ns: int,
        wants_header: Callable[[EndpointData], bool] | None = None,
    ) -> LocalWriter:  # fmt: skip
        """Create and announce a writer.

        Args:
            topic: The DDS name of the topic.
            type_name: The DDS name of the type.
            qos: The profile; its USER_DATA is announced.
            now: The time in seconds.
            wall_ns: The time in ns since 1970.
            wants_header: See :class:`LocalWriter`.
        """
        guid = self._new_guid(ids.KIND_WRITER_NO_KEY)
        data = EndpointData(guid, True, topic, type_name, qos)
        depth = None if qos.history == HistoryPolicy.KEEP_ALL else max(1, qos.depth)
        state = StatefulWriter(guid, qos.reliable, qos.transient_local, depth, self._fragment_size)
        writer = self.writers[guid[ids.PREFIX_SIZE :]] = LocalWriter(self, data, state)
        if wants_header is not None:
            writer.wants_header = wants_header
        writer.announced = self._announce_endpoint(self._publications, data, now, wall_ns)
        for remote in self.remotes.values():
            for endpoint in remote.endpoints.values():
                if not endpoint.is_writer:
                    self._match(writer, endpoint, now)
        return writer

    def create_reader(
        self, topic: str, type_name: str, qos: QoSProfile, deliver: Callable[[Sample], bool],
        now: float, wall_ns: int,
    ) -> LocalReader:  # fmt: skip
        """Create and announce a reader; ``deliver`` is that of :class:`StatefulReader`."""
        guid = self._new_guid(ids.KIND_READER_NO_KEY)
        data = EndpointData(guid, False, topic, type_name, qos)
        state = StatefulReader(guid, qos.reliable, qos.transient_local, deliver, self._budget)
        reader = self.readers[guid[ids.PREFIX_SIZE :]] = LocalReader(data, state)
        reader.announced = self._announce_endpoint(self._subscriptions, data, now, wall_ns)
        for remote in self.remotes.values():
            for endpoint in remote.endpoints.values():
                if endpoint.is_writer:
                    self._match(reader, endpoint, now)
        return reader

    def delete(self, endpoint: LocalWriter | LocalReader, now: float, wall_ns: int) -> None:
        """Delete one of our endpoints and announce that; idempotent."""
        guid = endpoint.data.guid
        table: dict[bytes, LocalWriter] | dict[bytes, LocalReader] = (
            self.writers if isinstance(endpoint, LocalWriter) else self.readers
        )
        if table.pop(guid[ids.PREFIX_SIZE :], None) is None:
            return
        if isinstance(endpoint, LocalWriter):
            self.burst.discard(endpoint)
            announcer = self._publications
        else:
            endpoint.state.close()
            announcer = self._subscriptions
        # A late participant needs neither the announcement nor the farewell.
        announcer.state.remove(endpoint.announced)
        packets = announcer.state.write(
            parameters.write_key(guid), wall_ns, now, parameters.write_farewell_qos(guid),
            is_key=True,
        )  # fmt: skip
        self.send_packets(announcer.state, packets)
        announcer.state.expire(announcer.state.last)

    def _new_guid(self, kind: int) -> bytes:
        self._next_key = self._next_key % 0xFF_FFFF + 1
        return self._prefix + self._next_key.to_bytes(3, "big") + bytes([kind])

    def _announce_endpoint(
        self, announcer: LocalWriter, data: EndpointData, now: float, wall_ns: int
    ) -> int:
        packets = announcer.state.write(parameters.write_endpoint(data), wall_ns, now)
        self.send_packets(announcer.state, packets)
        self.burst.add(announcer)
        return announcer.state.last

    # --- matching --------------------------------------------------------------------------

    def _match(self, ours: LocalWriter | LocalReader, theirs: EndpointData, now: float) -> None:
        """Match two endpoints of different kinds, if topic, type and QoS allow it."""
        writer, reader = (ours.data, theirs) if ours.data.is_writer else (theirs, ours.data)
        why = why_unmatched(writer, reader)
        if why is None:
            return
        if why:
            self.on_mismatch(ours.data, theirs, why)
            ours.state.unmatch(theirs.guid)
        elif isinstance(ours, LocalWriter):
            packets = ours.state.match(
                theirs.guid, theirs.qos.reliable, theirs.qos.transient_local, now,
                ours.wants_header(theirs),
            )  # fmt: skip
            self.send_packets(ours.state, packets)
            ours.on_match(theirs.guid)
        else:
            ours.state.match(theirs.guid, theirs.qos.reliable, now)

    def _counterparts(self, theirs: EndpointData) -> list[LocalWriter | LocalReader]:
        """Our endpoints of the other kind."""
        return [*self.readers.values()] if theirs.is_writer else [*self.writers.values()]

    def _match_builtin(self, remote: RemoteParticipant, now: float) -> None:
        prefix, bits = remote.prefix, remote.data.builtin
        for bit, writer, reader in (
            (ids.BIT_PUBLICATIONS_DETECTOR, self._publications, ids.PUBLICATIONS_READER),
            (ids.BIT_SUBSCRIPTIONS_DETECTOR, self._subscriptions, ids.SUBSCRIPTIONS_READER),
        ):
            if bits & bit:
                packets = writer.state.match(prefix + reader, True, True, now)
                self.send_packets(writer.state, packets)
        for bit, entity, theirs in (
            (
                ids.BIT_PUBLICATIONS_ANNOUNCER,
                ids.PUBLICATIONS_READER,
                ids.PUBLICATIONS_WRITER,
            ),
            (
                ids.BIT_SUBSCRIPTIONS_ANNOUNCER,
                ids.SUBSCRIPTIONS_READER,
                ids.SUBSCRIPTIONS_WRITER,
            ),
        ):
            if bits & bit:
                self.readers[entity].state.match(prefix + theirs, True, now)

    def _forget(self, remote: RemoteParticipant) -> None:
        """Remove a participant with its endpoints."""
        self.remotes.pop(remote.prefix, None)
        for guid in list(remote.endpoints):
            self._remove_endpoint(remote, guid)
        for writer in self.writers.values():
            for guid in [guid for guid in writer.state.readers if guid.startswith(remote.prefix)]:
                writer.state.unmatch(guid)
        for reader in self.readers.values():
            for guid in [guid for guid in reader.state.writers if guid.startswith(remote.prefix)]:
                reader.state.unmatch(guid)
        for key in [key for key in self._pending if key[1] == remote.prefix]:
            del self._pending[key]
        self.on_participant(remote.data, False)

    def _remove_endpoint(self, remote: RemoteParticipant, guid: bytes) -> None:
        endpoint = remote.endpoints.pop(guid, None)
        if endpoint is None:
            return
        for ours in self._counterparts(endpoint):
            ours.state.unmatch(guid)
        self.on_endpoint(endpoint, False)

    # --- what comes ------------------------------------------------------------------------

    def receive(self, datagram: memoryview, source: str, now: float) -> None:
        """Handle one datagram.

        Args:
            datagram: Its octets.
            source: The IP address of its sender.
            now: The time in seconds.
        """
        self._now = now
        try:
            _, _, prefix = submessages.read_header(datagram)
            if prefix == self._prefix:
                return
            remote = self.remotes.get(prefix)
            is_for_us, is_directed = True, False
            if remote is not None:
                remote.received += len(datagram)
            for submessage in submessages.read(datagram):
                if isinstance(submessage, InfoDestination):
                    is_directed = submessage.prefix == self._prefix
                    is_for_us = is_directed or submessage.prefix == ids.NO_PREFIX
                elif isinstance(submessage, InfoSource):
                    prefix = submessage.prefix
                    remote = self.remotes.get(prefix)
                elif not is_for_us:
                    continue
                elif isinstance(submessage, Data) and submessage.writer == ids.SPDP_WRITER:
                    self._on_announcement(submessage, prefix, source, len(datagram), now)
                    remote = self.remotes.get(prefix)
                elif remote is not None and self._is_from(remote, source):
                    if is_directed and isinstance(submessage, AckNack):
                        remote.is_proven = True  # it knows our prefix
                    self._dispatch(remote, submessage, now)
        except MalformedError:
            self.malformed += 1

    @staticmethod
    def _is_from(remote: RemoteParticipant, source: str) -> bool:
        """Whether an address is one that the participant was heard from, or announces."""
        if source in remote.heard:
            return True
        data = remote.data
        return any(
            locator.address == source
            for locator in (*data.metatraffic_unicast, *data.default_unicast)
        )

    def _dispatch(
        self, remote: RemoteParticipant, submessage: submessages.Submessage, now: float
    ) -> None:
        if isinstance(submessage, AckNack | NackFrag):
            writer = self.writers.get(submessage.writer)
            if writer is not None:
                guid = remote.prefix + submessage.reader
                if isinstance(submessage, AckNack):
                    writer.state.on_acknack(guid, submessage, now)
                else:
                    writer.state.on_nack_frag(guid, submessage, now)
            return
        if not isinstance(submessage, Data | DataFrag | Heartbeat | HeartbeatFrag | Gap):
            return
        guid = remote.prefix + submessage.writer
        if submessage.reader == ids.ENTITY_UNKNOWN:
            readers = [
                reader.state for reader in self.readers.values() if guid in reader.state.writers
            ]
        else:
            named = self.readers.get(submessage.reader)
            readers = [] if named is None else [named.state]
        for reader in readers:
            if isinstance(submessage, Data):
                reader.on_data(
                    guid, submessage.number, submessage.payload, submessage.inline_qos,
                    submessage.little, submessage.is_key,
                )  # fmt: skip
            elif isinstance(submessage, DataFrag):
                reader.on_fragments(guid, submessage)
            elif isinstance(submessage, Heartbeat):
                reader.on_heartbeat(guid, submessage, now)
            elif isinstance(submessage, Gap):
                reader.on_gap(guid, submessage)
            else:
                reader.on_heartbeat_frag(guid, submessage, now)

    def _on_announcement(
        self, data: Data, prefix: bytes, source: str, octets: int, now: float
    ) -> None:
        """Handle DATA of SPDP, in a datagram of so many octets: an announcement or a farewell."""
        status = 0
        if data.inline_qos is not None:
            status = parameters.read_inline_qos(data.inline_qos, data.little).status
        remote = self.remotes.get(prefix)
        if status & (ids.STATUS_DISPOSED | ids.STATUS_UNREGISTERED):
            if remote is not None and source in remote.heard:
                self._forget(remote)
            return
        if data.payload is None or data.is_key:
            return
        announced = parameters.read_participant(data.payload)
        if announced.guid[: ids.PREFIX_SIZE] != prefix:
            return  # a participant announces only itself and its endpoints
        if announced.domain not in (None, self._domain) or announced.domain_tag:
            return
        lease = announced.lease_ms if announced.lease_ms is not None else MAX_LEASE_MS
        expires = now + min(lease, MAX_LEASE_MS) / 1000
        if remote is not None:
            if not self._is_from(remote, source):
                return  # another host uses its GUID
            remote.heard.setdefault(source)
            remote.expires = expires
            if remote.data != announced:
                remote.data = announced
                self._match_builtin(remote, now)
                self.on_participant(announced, True)
            return
        if len(self.remotes) >= MAX_PARTICIPANTS:
            return
        remote = self.remotes[prefix] = RemoteParticipant(announced)
        remote.heard[source] = None
        remote.expires = expires
        remote.received = octets
        place = remote.place(announced.metatraffic_unicast)
        if place is not None:
            self._announce([place], remote)  # it need not wait for our next announcement
        self._match_builtin(remote, now)
        self.on_participant(announced, True)

    def _on_endpoint(self, sample: Sample, is_writer: bool) -> None:
        """Handle a sample of SEDP."""
        remote = self.remotes.get(sample.writer[: ids.PREFIX_SIZE])
        if remote is None:
            return
        try:
            if sample.payload is None or sample.is_key:
                status = sample.inline_qos.status if sample.inline_qos is not None else 0
                if sample.payload is not None:
                    guid = parameters.read_key(sample.payload)
                else:
                    guid = sample.inline_qos.key_hash if sample.inline_qos is not None else b""
                if status and guid in remote.endpoints:
                    self._remove_endpoint(remote, guid)
                return
            endpoint = parameters.read_endpoint(sample.payload, is_writer)
        except MalformedError:
            self.malformed += 1
            return
        if endpoint.guid[: ids.PREFIX_SIZE] != remote.prefix:
            return  # a participant announces only itself and its endpoints
        if endpoint.guid not in remote.endpoints and len(remote.endpoints) >= MAX_ENDPOINTS:
            return
        remote.endpoints[endpoint.guid] = endpoint
        for ours in self._counterparts(endpoint):
            self._match(ours, endpoint, self._now)
        self.on_endpoint(endpoint, True)

    # --- what is sent ----------------------------------------------------------------------

    def _announce(self, places: Iterable[Locator], to: RemoteParticipant | None = None) -> None:
        """Announce ourselves to all, or to one that was heard just now."""
        message = self._announcement(parameters.write_participant(self._data))
        if to is None or to.may_send(len(message)):
            self.outgoing += [(message, place) for place in places]

    def _announcement(self, payload: bytes, inline_qos: bytes = b"", is_key: bool = False) -> bytes:
        """A message with DATA of SPDP."""
        self._announcements += 1
        return submessages.header(self._prefix) + submessages.encode_data(
            ids.SPDP_READER, ids.SPDP_WRITER, self._announcements, payload, inline_qos, is_key
        )

    def _place_of(self, guid: bytes) -> tuple[Locator, bytes] | None:
        """Where a remote endpoint receives, and its participant's prefix."""
        remote = self.remotes.get(guid[: ids.PREFIX_SIZE])
        if remote is None:
            return None
        endpoint = remote.endpoints.get(guid)
        if endpoint is None:
            announced = remote.data.metatraffic_unicast
        else:
            announced = endpoint.unicast or remote.data.default_unicast
        place = remote.place(announced)
        return None if place is None else (place, remote.prefix)

    def send_packets(self, writer: StatefulWriter, packets: Iterable[Packet]) -> None:
        """Queue packets of a writer for the readers they are for, until :meth:`flush`."""
        everybody: list[tuple[Locator, bytes]] | None = None
        for packet in packets:
            if packet.reader is not None:
                place = self._place_of(packet.reader)
                places = [] if place is None else [place]
            else:
                if everybody is None:
                    found = map(self._place_of, writer.readers)
                    everybody = list(dict.fromkeys(place for place in found if place is not None))
                places = everybody
            octets = packet.submessages
            if packet.time_ns is not None:
                octets = submessages.encode_info_ts(packet.time_ns) + octets
            for place in places:
                self._pending.setdefault(place, []).append(octets)

    def flush(self) -> None:
        """Make datagrams of what is queued, with a heartbeat behind each burst of samples."""
        for writer in self.burst:
            self.send_packets(writer.state, writer.state.heartbeats_for_burst())
        self.burst.clear()
        pending, self._pending = self._pending, {}
        head = submessages.header(self._prefix)
        for (place, prefix), parts in pending.items():
            remote = self.remotes[prefix]
            begin = head + submessages.encode_info_dst(prefix)
            messages = [begin]
            for part in parts:
                size = len(messages[-1])
                if size + len(part) > self._message_size and size > len(begin):
                    messages.append(begin)
                messages[-1] += part
            self.outgoing += [
                (message, place) for message in messages if remote.may_send(len(message))
            ]

    def next_deadline(self) -> float | None:
        """Return when :meth:`poll` has something to do."""
        if self._closed:
            return None
        deadline = self._announce_at
        for remote in self.remotes.values():
            deadline = min(deadline, remote.expires)
        states = [writer.state.next_deadline() for writer in self.writers.values()]
        states += [reader.state.next_deadline() for reader in self.readers.values()]
        for at in states:
            if at is not None and at < deadline:
                deadline = at
        return deadline

    def poll(self, now: float) -> None:
        """Do what is due: announcements, leases, heartbeats, acknowledgements; then flush."""
        if self._closed:
            return
        self._now = now
        if now >= self._announce_at:
            pauses = _FIRST_ANNOUNCEMENTS
            count = self._periods
            self._periods += 1
            pause = pauses[count] if count < len(pauses) else _ANNOUNCEMENT_PERIOD
            self._announce_at = now + pause
            self._announce(self._announce_to)
        for remote in [remote for remote in self.remotes.values() if remote.expires <= now]:
            self._forget(remote)
        for writer in list(self.writers.values()):
            self.send_packets(writer.state, writer.state.poll(now))
        for reader in list(self.readers.values()):
            for guid, octets in reader.state.poll(now):
                place = self._place_of(guid)
                if place is not None:
                    self._pending.setdefault(place, []).append(octets)
        self.flush()

    def close(self) -> None:
        """Say farewell; idempotent."""
        if self._closed:
            return
        self._closed = True
        message = self._announcement(
            parameters.write_key(self.guid), parameters.write_farewell_qos(self.guid), True
        )
        places = dict.fromkeys(self._announce_to)
        for remote in self.remotes.values():
            place = remote.place(remote.data.metatraffic_unicast)
            if place is not None:
                places[place] = None
        self.outgoing += [(message, place) for place in places]
        for reader in self.readers.values():
            reader.state.close()
