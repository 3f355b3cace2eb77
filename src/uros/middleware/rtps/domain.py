"""One domain: a participant of ours, its sockets, and what all nodes in the domain share."""

from __future__ import annotations

import itertools
import os
import time
from collections import deque
from collections.abc import Callable, Mapping
from typing import Final, Protocol

from ...qos import QoSProfile
from .. import user_data
from ..discovery_info import codec
from ..discovery_info.gid_size import configured_gid_size
from ..qos_matching import Mismatch
from ..type_conflicts import TypeConflicts
from . import ids, network
from .discovery_info import RtpsDiscoveryInfo
from .endpoints import RtpsReader, RtpsWriter
from .local import LocalReader, LocalWriter
from .locators import Locator
from .parameters import EndpointData, ParticipantData
from .participant import Participant
from .reader import Sample
from .reassembly import OctetBudget
from .udp import MAX_BURST, DomainSockets

# A sample of megabytes must not keep the data plane from the boards, nor overflow the receiver's
# buffer, which has 208 kB on Linux: octets that are sent to one place at once, and the pause after
# that, in seconds.
_SLICE: Final = 64 * 1024
_PAUSE: Final = 0.001
# A writer that is faster than that for long: datagrams that wait for one place. Others are lost, as
# on a network; reliable writers repeat them.
_MAX_BACKLOG: Final = 50_000
# Octets of such datagrams for all places.
_MAX_BACKLOG_OCTETS: Final = 128 * 1024 * 1024
# Attack: datagrams that take long, and crowds that come at once. Seconds of them in one turn, for
# each descriptor; boards are served in between.
_RECEIVE_SECONDS: Final = 0.002
# Attack: topics without end whose endpoints do not match. Pairs that are reported once.
_MAX_REPORTED: Final = 1000


class DomainContext(Protocol):
    """What a domain uses of the middleware."""

    batching: bool
    unsent: set[RtpsDomain]
    on_type_conflict: Callable[[str, str, str], None] | None

    def notice(self, text: str) -> None:
        """Give the user a line."""

    def ready(self, reader: RtpsReader) -> None:
        """Have the reader's ``on_ready`` called by the next dispatch."""


class RtpsDomain:
    """A domain that is joined.

    Attributes:
        number: The domain.
        participant: Our participant.
        info: Its ``ros_discovery_info``; None if another participant announces our nodes.
        watchers: Called after changes of the graph.
        service_ids: Numbers for the ids of service clients and servers.

    Args:
        context: The middleware.
        number: The domain.
        environment: The environment variables.
        announces_nodes: Whether nodes are announced and those of others are read.

    Raises:
        MiddlewareError: The domain cannot be joined.
    """

    def __init__(
        self,
        context: DomainContext,
        number: int,
        environment: Mapping[str, str],
        announces_nodes: bool,
    ) -> None:
        self.number = number
        self.info: RtpsDiscoveryInfo | None = None
        self.watchers: list[Callable[[], None]] = []
        self.service_ids = itertools.count(1)
        # What endpoints use, see endpoints.EndpointOwner.
        self.ready: Callable[[RtpsReader], None] = context.ready
        self._context = context
        self._reported: set[tuple[bytes, bytes]] = set()
        self._writers: dict[str, list[RtpsWriter]] = {}
        self._readers: dict[str, list[RtpsReader]] = {}
        # Datagrams behind a slice, by place; those that follow have to wait too.
        self._backlog: dict[Locator, deque[bytes]] = {}
        self._backlog_octets = OctetBudget(_MAX_BACKLOG_OCTETS)
        self._backlog_at: float | None = None
        # The deadline, as long as nothing has happened that may change it.
        self._deadline: float | None = None
        self._is_deadline_known = False
        self._is_behind = False  # whether discovery is to be handled before samples
        self._has_waited = False  # whether samples were left out since they were received
        self._conflicts = TypeConflicts(self._on_type_conflict)
        self._user_data = user_data.PARTICIPANT
        if not announces_nodes:
            self._user_data += user_data.WITHOUT_NODES
        now = time.monotonic()
        settings = network.read_settings(environment, number)
        self._sockets = DomainSockets(number, settings, now)
        for text in self._sockets.notices:
            context.notice(text)
        self.participant = Participant(
            ids.VENDOR + os.urandom(ids.PREFIX_SIZE - len(ids.VENDOR)), number,
            self._sockets.unicast, self._sockets.multicast, self._sockets.peers,
            self._user_data, now, settings.message_size, self._sockets.data,
        )  # fmt: skip
        self._touched = self.participant.schedule.touched
        self.participant.on_participant = self._on_participant
        self.participant.on_endpoint = self._on_endpoint
        self.participant.on_mismatch = self._on_mismatch
        if announces_nodes:
            self.info = RtpsDiscoveryInfo(
                self, self.participant.guid, number, configured_gid_size(environment),
                self.participants,
                lambda writer: writer[: ids.PREFIX_SIZE] in self.participant.remotes,
                context.notice, self._changed_graph,
            )  # fmt: skip

    # --- what endpoints use (see endpoints.EndpointOwner) --------------------------------------

    def written(self) -> None:
        """Send what was written, unless the caller flushes."""
        if self._context.batching:
            self._context.unsent.add(self)
        else:
            self.flush()

    def create_local_writer(
        self, topic: str, type_name: str, qos: QoSProfile,
        wants_header: Callable[[EndpointData], bool] | None,
    ) -> LocalWriter:  # fmt: skip
        """Create and announce a writer."""
        now, wall = time.monotonic(), time.time_ns()
        writer = self.participant.create_writer(topic, type_name, qos, now, wall, wants_header)
        self._add_type(writer.data, True)
        self.written()
        return writer

    def create_local_reader(
        self, topic: str, type_name: str, qos: QoSProfile, deliver: Callable[[Sample], bool]
    ) -> LocalReader:
        """Create and announce a reader."""
        now, wall = time.monotonic(), time.time_ns()
        reader = self.participant.create_reader(topic, type_name, qos, deliver, now, wall)
        self._add_type(reader.data, True)
        self.written()
        return reader

    def join(self, endpoint: RtpsWriter | RtpsReader) -> None:
        """Connect an endpoint with those of this process that match it."""
        topic = endpoint.local.data.topic
        if isinstance(endpoint, RtpsWriter):
            self._writers.setdefault(topic, []).append(endpoint)
            for reader in self._readers.get(topic, ()):
                if endpoint.matches(reader):
                    endpoint.readers.append(reader)
        else:
            self._readers.setdefault(topic, []).append(endpoint)
            for writer in self._writers.get(topic, ()):
                if writer.matches(endpoint):
                    writer.readers.append(endpoint)
                    if endpoint.local.data.qos.transient_local:
                        for sample in writer.past():
                            endpoint.put(sample)
        self._changed_graph()

    def remove(self, endpoint: RtpsWriter | RtpsReader) -> None:
        """Undo :meth:`join`, delete the local endpoint and announce that."""
        self._separate(endpoint)
        self.participant.delete(endpoint.local, time.monotonic(), time.time_ns())
        self._conflicts.remove(endpoint.guid)
        self.written()
        self._changed_graph()

    def _separate(self, endpoint: RtpsWriter | RtpsReader) -> None:
        """Disconnect an endpoint from those of this process."""
        topic = endpoint.local.data.topic
        if isinstance(endpoint, RtpsWriter):
            self._writers[topic].remove(endpoint)
            if not self._writers[topic]:
                del self._writers[topic]
            return
        self._readers[topic].remove(endpoint)
        if not self._readers[topic]:
            del self._readers[topic]
        for writer in self._writers.get(topic, ()):
            if endpoint in writer.readers:
                writer.readers.remove(endpoint)

    # --- discovery -------------------------------------------------------------------------

    def _on_participant(self, data: ParticipantData, is_there: bool) -> None:
        if self.info is not None:
            if not is_there:
                self.info.intake.forget(data.guid)
            self.info.select_gid_size()
        self._changed_graph()

    def _on_endpoint(self, data: EndpointData, is_there: bool) -> None:
        if is_there:
            self._add_type(data, False)
        else:
            self._conflicts.remove(data.guid)
        self._changed_graph()

    def participants(self) -> dict[bytes, bytes]:
        """Return USER_DATA of the participants, ours included, by GUID."""
        found = {
            remote.data.guid: remote.data.user_data for remote in self.participant.remotes.values()
        }
        found[self.participant.guid] = self._user_data
        return found

    def endpoints(self) -> dict[bytes, EndpointData]:
        """Return the endpoints of the domain, ours included, by GUID."""
        found: dict[bytes, EndpointData] = {}
        for remote in self.participant.remotes.values():
            found.update(
                (guid, data)
                for guid, data in remote.endpoints.items()
                if user_data.PROBE_READER not in data.qos.user_data  # temporary, of no node
            )
        for writers in self._writers.values():
            found.update((writer.guid, writer.local.data) for writer in writers)
        for readers in self._readers.values():
            found.update((reader.guid, reader.local.data) for reader in readers)
        return found

    def _changed_graph(self) -> None:
        self._is_deadline_known = False
        for watcher in self.watchers:
            watcher()

    def _add_type(self, data: EndpointData, is_ours: bool) -> None:
        if self._context.on_type_conflict is not None and data.topic != codec.TOPIC:
            self._conflicts.add(data.guid, data.topic, data.type_name, is_ours)

    def _on_type_conflict(self, topic: str, own_type: str, other_type: str) -> None:
        if self._context.on_type_conflict is not None:
            self._context.on_type_conflict(topic, own_type, other_type)

    def _on_mismatch(self, ours: EndpointData, theirs: EndpointData, why: list[Mismatch]) -> None:
        pair = ours.guid, theirs.guid
        if pair in self._reported or len(self._reported) >= _MAX_REPORTED:
            return
        self._reported.add(pair)
        names = ", ".join(f"{one.policy} ({one.offered} offered, {one.requested} requested)"
                          for one in why)  # fmt: skip
        role = "writer" if ours.is_writer else "reader"
        other = "reader" if ours.is_writer else "writer"
        self._context.notice(
            f"a {role} of {ours.topic} in domain {self.number} does not match a {other} of another"
            f" participant: {names}"
        )

    # --- the data plane ----------------------------------------------------------------------

    def filenos(self) -> list[int]:
        """Return the descriptors that are readable when datagrams have come."""
        return self._sockets.filenos()

    def receive(self, fileno: int) -> None:
        """Handle a burst of datagrams of a descriptor.

        What they have us send waits for a flush or a tick. Where not all of discovery was handled,
        what announces the writer of a sample may be in the rest: then samples are left out once.
        """
        is_for_samples = self._sockets.is_for_samples(fileno)
        if is_for_samples and self._is_behind:
            self._is_behind, self._has_waited = False, True
            return
        now = time.monotonic()
        count, is_late = 0, False
        for datagram, source in self._sockets.receive(fileno):
            self.participant.receive(datagram, source, now)
            count += 1
            is_late = time.monotonic() - now > _RECEIVE_SECONDS
            if is_late:
                break
        if not count:
            self._is_deadline_known = False  # the descriptor is that of changed interfaces
        if is_for_samples:
            self._has_waited = False
        else:
            self._is_behind = (is_late or count >= MAX_BURST) and not self._has_waited
        if self.participant.has_output:
            self._context.unsent.add(self)

    def next_deadline(self) -> float | None:
        """Return when :meth:`tick` has work."""
        if self._touched or not self._is_deadline_known:
            self._deadline = self._find_deadline()
            self._is_deadline_known = True
        return self._deadline

    def _find_deadline(self) -> float | None:
        deadline = self.participant.next_deadline()
        of_info = None if self.info is None else self.info.next_deadline()
        for at in (self._backlog_at, self._sockets.scan_at, of_info):
            if at is not None and (deadline is None or at < deadline):
                deadline = at
        return deadline

    def tick(self) -> None:
        """Do what is due by time."""
        self._is_deadline_known = False
        now = time.monotonic()
        if self.info is not None:
            self.info.tick(now)
        if self._sockets.scan_at is not None and self._sockets.scan_at <= now:
            if self._sockets.scan(now):
                sockets = self._sockets
                self.participant.move(sockets.unicast, sockets.multicast, now, sockets.data)
        self.participant.poll(now)
        self.flush()

    def flush(self) -> None:
        """Send what is held back."""
        outgoing = self.participant.take_datagrams()
        if not outgoing and not self._backlog:
            return
        is_one = len(outgoing) == 1  # mostly: nothing to count
        octets: dict[Locator, int] = {}
        for datagram, place in outgoing:
            sent = 0 if is_one else octets.get(place, 0)
            waits = sent >= _SLICE or (self._backlog and place in self._backlog)
            if waits or not self._sockets.send(datagram, place):
                waiting = self._backlog.setdefault(place, deque())
                if len(waiting) < _MAX_BACKLOG and self._backlog_octets.take(len(datagram), place):
                    waiting.append(datagram)
                continue
            if not is_one:
                octets[place] = sent + len(datagram)
        if self._backlog:
            self._send_backlog(time.monotonic())
        if self._sockets.unreachable:
            for address in self._sockets.unreachable:
                self.participant.leave_address(address)
            self._sockets.unreachable.clear()

    def _send_backlog(self, now: float) -> None:
        """Send a slice of what waits for each place, if the pause is over."""
        self._is_deadline_known = False
        if self._backlog_at is not None and self._backlog_at <= now:
            self._backlog_at = None
            for place, datagrams in list(self._backlog.items()):
                self._send_slice(place, datagrams)
        if self._backlog and self._backlog_at is None:
            self._backlog_at = now + _PAUSE

    def _send_slice(self, place: Locator, datagrams: deque[bytes]) -> None:
        octets = 0
        while datagrams and octets < _SLICE:
            datagram = datagrams[0]
            if not self._sockets.send(datagram, place):
                return  # the system has no room
            datagrams.popleft()
            octets += len(datagram)
            self._backlog_octets.give_back(len(datagram), place)
        if not datagrams:
            del self._backlog[place]

    def close(self) -> None:
        """Say farewell and close the sockets."""
        self.participant.close()
        self._backlog.clear()  # the farewell must not wait
        self.flush()
        self._sockets.close()
