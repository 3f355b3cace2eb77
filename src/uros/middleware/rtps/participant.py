"""One participant of ours in a domain: discovery, its endpoints, and what goes to whom.

A :class:`Participant` takes datagrams and the time, and gives datagrams, samples and a deadline. It
uses neither sockets nor a clock.

Discovery is that of RTPS 8.5: each participant announces itself (SPDP), and tells those that it has
heard its writers and readers over reliable builtin topics (SEDP). Nothing that a peer announces is
believed beyond what can be checked: datagrams are sent only to addresses that the peer was heard
from, or that the user configured; a farewell counts only from such an address.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Final

from ...qos import HistoryPolicy, LivelinessPolicy, QoSProfile
from ..qos_matching import Mismatch
from . import builtin, ids, parameters, sedp, submessages
from .builtin import BuiltinEndpoints
from .kinds import (
    AckNack,
    Data,
    DataFrag,
    Gap,
    Heartbeat,
    HeartbeatFrag,
    InfoDestination,
    InfoReply,
    InfoSource,
    InfoTimestamp,
    NackFrag,
    Submessage,
)
from .liveliness import LivelinessAssertion
from .local import (
    EndpointSchedule,
    LocalEndpoints,
    LocalReader,
    LocalWriter,
    lifespan,
    why_unmatched,
)
from .locators import Locator
from .outbox import MESSAGE_SIZE, Outbox
from .parameters import EndpointData, ParticipantData
from .reader import Sample, StatefulReader
from .reassembly import OctetBudget
from .remote import RemoteEndpoints, RemoteParticipant, cost, lease
from .spdp import LEASE_MS, ParticipantAnnouncer
from .submessages import MalformedError
from .writer import StatefulWriter

# What a message has besides fragments: headers, INFO_DST, INFO_TS, DATA_FRAG, a heartbeat.
_FRAGMENT_OVERHEAD: Final = 180
# Attack: participants and endpoints without end.
MAX_PARTICIPANTS: Final = 1000
MAX_ENDPOINTS: Final = 16_384  # of one participant: an agent may have thousands of boards
# RTPS has ports for 120 participants on one machine.
MAX_PARTICIPANTS_OF_ADDRESS: Final = 250
# Octets of what is known of all of them, and their share (see :class:`OctetBudget`).
MAX_KNOWN: Final = 64 * 1024 * 1024
# Where all places are taken, one that has not answered for so many seconds makes room for another.
_UNPROVEN: Final = 1.0
# Octets of early and incomplete samples of all readers.
MAX_HELD: Final = 64 * 1024 * 1024
# Seconds without a poll after which this process was stopped. Announcements of others are still
# unread then: their leases are extended for as long as it takes to read them.
_STOPPED: Final = 5.0
# Seconds that participants may take to find each other. Samples written up to this long before a
# participant was heard are sent to its volatile readers too.
_DISCOVERY: Final = 1.0
_GRACE: Final = 1.0


class Participant:
    """A participant of ours; see the module.

    Attributes:
        guid: Its GUID.
        remotes: The participants heard, by GUID prefix.
        writers: Our writers by entity id, builtin ones included.
        readers: Our readers by entity id, builtin ones included.
        malformed: Datagrams that were not valid, in part or as a whole.
        take_datagrams: Returns the datagrams to send, each with where to, made of what is queued.
        schedule: What is due by time of its endpoints, and of the participants heard.
        on_participant: Called with a participant that comes or changes (True), or goes (False).
        on_endpoint: The same with an endpoint of others.
        on_mismatch: Called with a local endpoint, a remote one of its topic, and why they do not
            match.

    Args:
        prefix: The GUID prefix, 12 octets that begin with our vendor id.
        domain: The domain.
        unicast: Where we receive, announced for discovery.
        multicast: Where all participants of the domain receive announcements.
        peers: Further places to announce to.
        user_data: USER_DATA of the participant.
        now: The time in seconds.
        message_size: The most octets of a datagram.
        data: Where we receive samples; None: where we receive discovery.
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
        data: list[Locator] | None = None,
    ) -> None:
        self.guid = prefix + ids.ENTITY_PARTICIPANT
        self.remotes: dict[bytes, RemoteParticipant] = {}
        self._endpoints = LocalEndpoints()
        self._remote_endpoints = RemoteEndpoints()
        self.writers = self._endpoints.writers
        self.readers = self._endpoints.readers
        self.malformed = 0
        self.on_participant: Callable[[ParticipantData, bool], None] = lambda data, is_there: None
        self.on_endpoint: Callable[[EndpointData, bool], None] = lambda data, is_there: None
        self.on_mismatch: Callable[[EndpointData, EndpointData, list[Mismatch]], None] = (
            lambda ours, theirs, why: None
        )
        self._prefix = prefix
        self._domain = domain
        self._fragment_size = (message_size - _FRAGMENT_OVERHEAD) & ~3
        self._budget = OctetBudget(MAX_HELD)
        self._known = OctetBudget(MAX_KNOWN)
        self._turn = 0
        self._polled_at = now
        self._next_key = 0
        announced = ParticipantData(
            self.guid, domain, "", builtin.SERVED, LEASE_MS,
            unicast, multicast, unicast if data is None else data, [], user_data,
        )  # fmt: skip
        self._announcer = ParticipantAnnouncer(announced, peers, now)
        self._now = now
        self._outbox = Outbox(prefix, self.remotes, message_size)
        self.take_datagrams: Callable[[], list[tuple[bytes, Locator]]] = self._outbox.take
        self.schedule = EndpointSchedule()
        self._publications = self._builtin(
            builtin.PUBLICATIONS, lambda sample: self._on_endpoint(sample, True)
        )
        self._subscriptions = self._builtin(
            builtin.SUBSCRIPTIONS, lambda sample: self._on_endpoint(sample, False)
        )
        # What others assert has no effect here besides their lease: our readers do not report it.
        messages = self._builtin(builtin.PARTICIPANT_MESSAGES, lambda sample: None, 1)
        self._builtins = (self._publications, self._subscriptions, messages)
        self._liveliness = LivelinessAssertion(messages, prefix)
        self._closed = False

    def _builtin(
        self,
        topic: builtin.BuiltinTopic,
        deliver: Callable[[Sample], None],
        depth: int | None = None,
    ) -> BuiltinEndpoints:
        made = BuiltinEndpoints(
            topic,
            self._prefix,
            self._fragment_size,
            self._outbox,
            self.schedule,
            self._budget,
            deliver,
            depth,
        )
        self._endpoints.add(made.writer)
        self._endpoints.add(made.reader)
        return made

    @property
    def has_output(self) -> bool:
        """Whether something waits to be sent, flushed or not."""
        return not self._outbox.is_empty

    def move(
        self,
        unicast: list[Locator],
        multicast: list[Locator],
        now: float,
        data: list[Locator] | None = None,
    ) -> None:
        """Announce that we receive elsewhere from now on; see the class for the arguments."""
        self._announcer.move(unicast, multicast, unicast if data is None else data, now)
        for remote in self.remotes.values():
            remote.announced_at = float("-inf")

    def leave_address(self, address: str) -> None:
        """Note that datagrams do not reach an address; see RemoteParticipant.leave_address."""
        for remote in self.remotes.values():
            remote.leave_address(address)

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
        state = StatefulWriter(
            guid, qos.reliable, qos.transient_local, depth, self._fragment_size,
            is_manual=qos.liveliness == LivelinessPolicy.MANUAL_BY_TOPIC,
            lifespan=lifespan(qos), repeats=self._outbox.repeats,
        )  # fmt: skip
        state.on_change = self.schedule.touch
        writer = LocalWriter(self._outbox, data, state)
        if wants_header is not None:
            writer.wants_header = wants_header
        self._endpoints.add(writer)
        self._liveliness.add(qos, now)
        sedp.announce(writer, self._publications, now, wall_ns)
        for theirs in self._remote_endpoints.counterparts(data):
            self._match(writer, theirs, now)
        return writer

    def create_reader(
        self, topic: str, type_name: str, qos: QoSProfile, deliver: Callable[[Sample], bool],
        now: float, wall_ns: int,
    ) -> LocalReader:  # fmt: skip
        """Create and announce a reader; ``deliver`` is that of :class:`StatefulReader`."""
        guid = self._new_guid(ids.KIND_READER_NO_KEY)
        data = EndpointData(guid, False, topic, type_name, qos)
        state = StatefulReader(guid, qos.reliable, qos.transient_local, deliver, self._budget)
        state.on_change = self.schedule.touch
        reader = LocalReader(data, state)
        self._endpoints.add(reader)
        sedp.announce(reader, self._subscriptions, now, wall_ns)
        for theirs in self._remote_endpoints.counterparts(data):
            self._match(reader, theirs, now)
        return reader

    def delete(self, endpoint: LocalWriter | LocalReader, now: float, wall_ns: int) -> None:
        """Delete one of our endpoints and announce that; idempotent."""
        if not self._endpoints.remove(endpoint):
            return
        if isinstance(endpoint, LocalWriter):
            self._outbox.burst.discard(endpoint.state)
            self.schedule.remove(endpoint.state)
            self._liveliness.remove(endpoint.data.qos)
            sedp.withdraw(endpoint, self._publications, now, wall_ns)
        else:
            endpoint.state.close()
            self.schedule.remove(endpoint.state)
            sedp.withdraw(endpoint, self._subscriptions, now, wall_ns)

    def _new_guid(self, kind: int) -> bytes:
        self._next_key = self._next_key % 0xFF_FFFF + 1
        return self._prefix + self._next_key.to_bytes(3, "big") + bytes([kind])

    # --- matching --------------------------------------------------------------------------

    def _match(
        self, ours: LocalWriter | LocalReader, theirs: EndpointData, now: float,
        since: float = math.inf,
    ) -> None:  # fmt: skip
        """Match two endpoints of different kinds, if topic, type and QoS allow it.

        ``since`` is that of :meth:`StatefulWriter.match`.
        """
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
                ours.wants_header(theirs), since,
            )  # fmt: skip
            self._outbox.add_packets(ours.state, packets)
            ours.on_match(theirs.guid)
        else:
            ours.state.match(theirs.guid, theirs.qos.reliable, now, lifespan(theirs.qos))

    def _match_builtin(self, remote: RemoteParticipant, now: float) -> None:
        for endpoints in self._builtins:
            endpoints.match(remote, now)

    def _forget(self, remote: RemoteParticipant) -> None:
        """Remove a participant with its endpoints."""
        self.remotes.pop(remote.prefix, None)
        self.schedule.remove(remote)
        self._known.give_back(cost(remote.data), remote.prefix)
        for endpoint in remote.endpoints.values():
            self._known.give_back(cost(endpoint), remote.prefix)
            self._remote_endpoints.remove(endpoint)
        for writer in self.writers.values():
            writer.state.unmatch_participant(remote.prefix)
            writer.on_leave(remote.prefix)
        for reader in self.readers.values():
            reader.state.unmatch_participant(remote.prefix)
        self._outbox.forget(remote)
        for endpoint in remote.endpoints.values():
            self.on_endpoint(endpoint, False)
        self.on_participant(remote.data, False)

    def _remove_endpoint(self, remote: RemoteParticipant, guid: bytes) -> None:
        endpoint = remote.remove(guid)
        if endpoint is None:
            return
        self._remote_endpoints.remove(endpoint)
        self._known.give_back(cost(endpoint), remote.prefix)
        for ours in self._endpoints.counterparts(endpoint):
            ours.state.unmatch(guid)
            if isinstance(ours, LocalWriter):
                ours.on_leave(guid)
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
            _, _, sender = submessages.read_header(datagram)
            prefix = sender
            remote = self.remotes.get(prefix)
            is_for_us, is_directed = True, False
            answers_to: tuple[Locator, ...] = ()
            source_ns = 0
            if remote is not None and source in remote.heard:
                remote.received += len(datagram)
            for submessage in submessages.read(datagram):
                if type(submessage) is InfoTimestamp:
                    source_ns = submessage.time_ns or 0
                elif type(submessage) is InfoDestination:
                    is_directed = submessage.prefix == self._prefix
                    is_for_us = is_directed or submessage.prefix == ids.NO_PREFIX
                elif type(submessage) is InfoSource:
                    prefix = submessage.prefix
                    remote = self.remotes.get(prefix)
                    answers_to, source_ns = (), 0
                elif type(submessage) is InfoReply:
                    answers_to = submessage.unicast
                elif not is_for_us or prefix == self._prefix:
                    continue  # our own multicast comes back; others do not speak for us
                elif type(submessage) is Data and submessage.writer == ids.SPDP_WRITER:
                    # Attack: many participants in one datagram, each of which could be answered
                    # with as many octets.
                    octets = len(datagram) if prefix == sender else 0
                    self._on_announcement(submessage, prefix, source, octets, now)
                    remote = self.remotes.get(prefix)
                elif remote is not None and (source in remote.heard or remote.is_from(source)):
                    # Multicast announcements may be lost. The schedule asks again when the lease
                    # would have ended, not for each submessage.
                    remote.expires = now + remote.lease
                    # What is for us alone shows that it knows our prefix.
                    remote.is_proven |= is_directed
                    if type(submessage) is AckNack or type(submessage) is NackFrag:
                        self._answer_to(remote, submessage, answers_to)
                    if not self._dispatch(remote, submessage, now, source_ns):
                        self._begin_anew(remote, source, now)
                        remote = self.remotes.get(prefix)
            if remote is not None and remote.left_out and remote.may_resume():
                for endpoints in self._builtins:
                    endpoints.resume(remote, now)
        except MalformedError:
            self.malformed += 1

    def _answer_to(
        self, remote: RemoteParticipant, submessage: AckNack | NackFrag, places: tuple[Locator, ...]
    ) -> None:
        """Note where a reader wants answers: at its locators, unless INFO_REPLY names others.

        As always, nothing is sent to an address that its participant was not heard from.
        """
        guid = remote.prefix + submessage.reader
        writer = self.writers.get(submessage.writer)
        is_known = writer is not None and guid in writer.state.readers
        remote.answer_to(guid, places if is_known else ())

    def _dispatch(
        self, remote: RemoteParticipant, submessage: Submessage, now: float, source_ns: int
    ) -> bool:
        """Give a submessage to the endpoints it is for; False where its sender has begun anew."""
        if type(submessage) is AckNack or type(submessage) is NackFrag:
            writer = self.writers.get(submessage.writer)
            if writer is not None:
                guid = remote.prefix + submessage.reader
                if type(submessage) is AckNack:
                    return writer.state.on_acknack(guid, submessage, now)
                writer.state.on_nack_frag(guid, submessage, now)
            return True
        if not (  # the most frequent ones first; isinstance() with all of them takes longer
            type(submessage) is Data
            or type(submessage) is Heartbeat
            or type(submessage) is DataFrag
            or type(submessage) is Gap
            or type(submessage) is HeartbeatFrag
        ):
            return True
        guid = remote.prefix + submessage.writer
        if submessage.reader == ids.ENTITY_UNKNOWN:
            endpoint = remote.endpoints.get(guid)
            readers = self._endpoints.readers_of(guid, "" if endpoint is None else endpoint.topic)
        else:
            named = self.readers.get(submessage.reader)
            readers = [] if named is None else [named.state]
        is_same = True
        for reader in readers:
            is_same &= reader.receive(guid, submessage, now, source_ns)
        return is_same

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
        if remote is not None:
            if not remote.is_from(source):
                return  # another host uses its GUID
            remote.hear(source)
            self._outbox.datagrams += self._announcer.answer(remote, now)
            remote.lease = lease(announced)
            remote.expires = now + remote.lease
            self.schedule.touch(remote)
            if remote.data != announced:
                if not self._exchange(cost(remote.data), cost(announced), prefix):
                    return
                remote.announce(announced)
                self._match_builtin(remote, now)
                self.on_participant(announced, True)
            return
        self._meet(announced, source, octets, now)

    def _meet(
        self, announced: ParticipantData, source: str, octets: int, now: float
    ) -> RemoteParticipant | None:
        """Add a participant that is heard first, if there is room for it."""
        prefix = announced.guid[: ids.PREFIX_SIZE]
        if not self._has_place(source, now) or not self._known.take(cost(announced), prefix):
            return None
        remote = self.remotes[prefix] = RemoteParticipant(announced, now)
        remote.hear(source)
        remote.received = octets
        self.schedule.touch(remote)
        self._outbox.datagrams += self._announcer.introduce(remote, now)
        self._match_builtin(remote, now)
        self.on_participant(announced, True)
        return remote

    def _begin_anew(self, remote: RemoteParticipant, source: str, now: float) -> None:
        """Forget what is known of a participant that was restarted, or had forgotten us."""
        self._forget(remote)
        again = self._meet(remote.data, source, 0, now)
        if again is not None:
            again.is_proven = remote.is_proven

    def _exchange(self, before: int, after: int, holder: bytes) -> bool:
        """Account for what is known anew; False where a participant would know too much."""
        if after > before:
            return self._known.take(after - before, holder)
        self._known.give_back(before - after, holder)
        return True

    def _has_place(self, source: str, now: float) -> bool:
        """Whether one more participant may come from an address; one that is forged makes room."""
        from_there = sum(source in remote.heard for remote in self.remotes.values())
        if from_there >= MAX_PARTICIPANTS_OF_ADDRESS:
            return False
        if len(self.remotes) < MAX_PARTICIPANTS:
            return True
        for remote in self.remotes.values():
            if not remote.is_proven and now - remote.since >= _UNPROVEN:
                self._forget(remote)
                return True
        return False

    def _on_endpoint(self, sample: Sample, is_writer: bool) -> None:
        """Handle a sample of SEDP."""
        remote = self.remotes.get(sample.writer[: ids.PREFIX_SIZE])
        if remote is None:
            return
        try:
            endpoint = sedp.read_announcement(sample, is_writer)
        except MalformedError:
            self.malformed += 1
            return
        if endpoint is None:
            return
        if isinstance(endpoint, bytes):
            self._remove_endpoint(remote, endpoint)
            return
        known = remote.endpoints.get(endpoint.guid)
        if known is not None and not known.is_of_same(endpoint):
            self._remove_endpoint(remote, endpoint.guid)
            known = None
        if known is None and len(remote.endpoints) >= MAX_ENDPOINTS:
            return
        before = 0 if known is None else cost(known)
        if not self._exchange(before, cost(endpoint), remote.prefix):
            return
        remote.add(endpoint)
        self._remote_endpoints.add(endpoint)
        topic = self._publications if is_writer else self._subscriptions
        announcer = topic.reader.state.writers.get(sample.writer)
        was_there = announcer is not None and sample.number <= announcer.last_at_match
        since = remote.since - _DISCOVERY if was_there else math.inf
        for ours in self._endpoints.counterparts(endpoint):
            self._match(ours, endpoint, self._now, since)
        self.on_endpoint(endpoint, True)

    # --- what is sent ----------------------------------------------------------------------

    def flush(self) -> None:
        """Make datagrams of what is queued; see :meth:`Outbox.flush`."""
        self._outbox.flush()

    def next_deadline(self) -> float | None:
        """Return when :meth:`poll` has something to do."""
        if self._closed:
            return None
        deadline = self._announcer.due
        if self._liveliness.due is not None:
            deadline = min(deadline, self._liveliness.due)
        due = self.schedule.next_deadline()
        return deadline if due is None else min(deadline, due)

    def poll(self, now: float) -> None:
        """Do what is due: announcements, leases, heartbeats, acknowledgements; then flush."""
        if self._closed:
            return
        self._now = now
        if now >= self._announcer.due:
            self._outbox.datagrams += self._announcer.announce(self.remotes.values(), now)
        self._liveliness.poll(now)
        if now - self._polled_at > _STOPPED:
            for remote in self.remotes.values():
                remote.expires = max(remote.expires, now + _GRACE)
                self.schedule.touch(remote)
        self._polled_at = now
        due = self.schedule.take_due(now)
        self._turn += 1
        first = self._turn % max(1, len(due))  # another one is the first to repeat samples
        for item in due[first:] + due[:first]:
            if isinstance(item, StatefulWriter):
                self._outbox.add_packets(item, item.poll(now))
            elif isinstance(item, StatefulReader):
                for guid, octets in item.poll(now):
                    self._outbox.add(guid, octets)
            elif item.expires <= now:
                self._outbox.datagrams += self._announcer.give_up(item)
                self._forget(item)
        self.flush()

    def close(self) -> None:
        """Say farewell; idempotent."""
        if self._closed:
            return
        self._closed = True
        self._outbox.datagrams += self._announcer.leave(self.remotes.values())
        for reader in self.readers.values():
            reader.state.close()
