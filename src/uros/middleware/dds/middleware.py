"""Nodes on DDS, and the thread that sleeps until a sample arrives.

That thread sits in Cyclone's waitset without the GIL. When something arrives
it notes which readers, makes :meth:`DdsMiddleware.fileno` readable and sleeps
on a lock until the data plane has dispatched: the data plane takes the samples
itself, and nothing of Python runs in Cyclone's own threads.
"""

from __future__ import annotations

import itertools
import os
import threading
import time
from collections.abc import Callable, Sequence
from typing import Final

from ...qos import QoSProfile
from ..base import Middleware, MiddlewareError, Node, OnReady, Service, check_domain
from ..wakeup_fd import Wake
from . import announce, config, cyclone
from .announced import Announced, participant_of
from .conflicts import TypeWatch
from .endpoints import DdsReader, DdsReplier, DdsRequester, DdsWriter
from .gids import GidWatch
from .graph import PacedDiscovery
from .hidden import HiddenNodes
from .late_writer_heartbeat import Offers
from .participant import MAX_NODES, SharedParticipant
from .reader_listener import Watched
from .shared import Shared

# Attack: a node in each of the 233 domains. Each costs five threads and six descriptors, and is
# not left before the end; 1024 descriptors are what a process has mostly.
MAX_DOMAINS: Final = 32
# Attack: a board that makes one service after the other.
_MAX_NOTICES: Final = 1000


class DdsNode(Node):
    """A node of the ROS graph; it shares its participant with others."""

    def __init__(
        self, middleware: DdsMiddleware, participant: SharedParticipant, namespace: str, name: str
    ) -> None:
        self.middleware = middleware
        self.participant = participant
        self._entities = announce.NodeEntities(namespace, name)
        self._endpoints: list[DdsWriter | DdsReader] = []
        participant.nodes.append(self._entities)
        participant.changed()

    def create_writer(self, topic: str, type_name: str, qos: QoSProfile) -> DdsWriter:
        _check_open(topic)
        return DdsWriter(self, topic, type_name, qos, b"")

    def create_reader(
        self, topic: str, type_name: str, qos: QoSProfile, on_ready: OnReady
    ) -> DdsReader:
        return DdsReader(self, topic, type_name, qos, on_ready, b"")

    def create_requester(
        self, service: Service, qos: QoSProfile, on_ready: OnReady
    ) -> DdsRequester:
        _check_open(service.request_topic)
        return DdsRequester(self, service, qos, on_ready)

    def create_replier(self, service: Service, qos: QoSProfile, on_ready: OnReady) -> DdsReplier:
        _check_open(service.reply_topic)
        return DdsReplier(self, service, qos, on_ready)

    def unique_id(self) -> str:
        """A service client's or server's id as rmw_cyclonedds writes it."""
        number = next(self.middleware.service_numbers)
        octets = self.participant.guid[:12] + number.to_bytes(4, "big")
        return ".".join(f"{octet:x}" for octet in octets)

    def adopt(self, readers: list[bytes], writers: list[bytes]) -> None:
        """Announce endpoints of another participant of this process, by their GUIDs, as this
        node's, and as nobody else's.
        """
        self._entities.readers += readers
        self._entities.writers += writers
        self.participant.changed()
        self._hide(readers + writers)

    def _hide(self, guids: list[bytes]) -> None:
        self.middleware.hide_nodes_of({participant_of(it) for it in guids}, self.participant)

    def disown(self, readers: list[bytes], writers: list[bytes]) -> None:
        """Undo :meth:`adopt`."""
        for mine, theirs in (
            (self._entities.readers, readers),
            (self._entities.writers, writers),
        ):
            for guid in theirs:
                mine.remove(guid)
        self.participant.changed()
        self._hide(readers + writers)

    def add_writer(self, writer: DdsWriter) -> None:
        self._endpoints.append(writer)
        self._entities.writers.append(writer.guid)
        self.participant.changed()

    def add_reader(self, reader: DdsReader) -> None:
        self._endpoints.append(reader)
        self._entities.readers.append(reader.guid)
        self.participant.changed()

    def remove_writer(self, writer: DdsWriter) -> None:
        self._endpoints.remove(writer)
        self._entities.writers.remove(writer.guid)
        self.participant.changed()

    def remove_reader(self, reader: DdsReader) -> None:
        self._endpoints.remove(reader)
        self._entities.readers.remove(reader.guid)
        self.participant.changed()

    def close(self) -> None:
        for endpoint in list(self._endpoints):
            endpoint.close()
        if self._entities in self.participant.nodes:
            self.participant.nodes.remove(self._entities)
            self.participant.changed()


def _check_open(topic: str) -> None:
    """Whether nodes may write on a topic. Raises MiddlewareError.

    Attack: a board that writes what only middlewares write, such as nodes that do not exist.
    Cyclone itself refuses the names of its builtin topics (DCPS…).
    """
    if topic == announce.TOPIC:
        raise MiddlewareError(f"nodes do not write on {topic}: it belongs to the middleware")


class DdsMiddleware(Middleware):
    """See the module. Domains are started by their first node."""

    name = "dds"

    def __init__(self) -> None:
        self.service_numbers = itertools.count(1)
        self._environment = dict(os.environ)
        config.discovery_range(self._environment)  # a wrong value is better told at once
        self._domains: set[int] = set()
        self._participants: dict[int, list[SharedParticipant]] = {}
        self._gids: dict[int, GidWatch] = {}
        self._offers: dict[int, Offers] = {}
        self._hidden: dict[int, HiddenNodes] = {}
        self.graphs: list[PacedDiscovery] = []
        self.announced: list[Announced] = []
        self._readers: dict[int, Watched] = {}
        # Our readers by domain and topic, each a list kept up to date, and those
        # just written to: Cyclone has their samples ready when the write returns.
        self.local = Shared[tuple[int, str], list[DdsReader]](lambda _key: [], lambda _list: None)
        self._written: dict[int, Sequence[Watched]] = {}
        self._noticed: set[str] = set()
        self.own_writers: set[int] = set()  # their instance handles
        self.unsent: set[int] = set()  # writers that hold samples back
        self._keys = itertools.count(1)
        self.wake = Wake()
        self._waitset: cyclone.Waitset | None = None
        self._ready: list[int] = []
        self._resume = threading.Lock()
        self._closed = False
        self._thread: threading.Thread | None = None

    def create_node(
        self, domain: int, namespace: str, name: str, localhost_only: bool = False
    ) -> DdsNode:
        check_domain(domain)
        if localhost_only and not config.stays_on_loopback(self._environment):
            raise MiddlewareError(
                "a client wants a participant that never leaves this machine, and domain"
                f" {domain} is open to the network: start the agent with"
                " ROS_AUTOMATIC_DISCOVERY_RANGE=LOCALHOST, and without other interfaces in"
                " CYCLONEDDS_URI"
            )
        return DdsNode(self, self._participant(domain), namespace, name)

    def _participant(self, domain: int) -> SharedParticipant:
        if domain not in self._domains:
            if len(self._domains) >= MAX_DOMAINS:
                raise MiddlewareError(
                    f"domain {domain} would be one more than the {MAX_DOMAINS} that this agent may"
                    " join: let it have an agent of its own"
                )
            try:
                cyclone.open_domain(domain, config.config_xml(self._environment, os.getpid()))
            except MiddlewareError as error:
                if self._environment.get("CYCLONEDDS_URI"):
                    raise MiddlewareError(f"{error}; is CYCLONEDDS_URI right?") from error
                raise
            self._domains.add(domain)
        shared = self._participants.setdefault(domain, [])
        for participant in shared:
            if len(participant.nodes) < MAX_NODES:
                return participant
        told = config.gid_size(self._environment)
        known = self._gids.get(domain)
        shared.append(SharedParticipant(domain, known.size if known else told or config.SHORT_GID))
        if known is None:
            self._gids[domain] = GidWatch(self, shared[0], told)
        if len(shared) == 1 and self.on_type_conflict is not None:
            TypeWatch(self, shared[0])
        return shared[-1]

    def expect_offers(self, participant: SharedParticipant) -> None:
        """A reliable reader is about to be made: from now on see to it that writers of its
        domain do not let it wait; see :mod:`~uros.middleware.dds.late_writer_heartbeat`.
        """
        if participant.domain not in self._offers:
            self._offers[participant.domain] = Offers(self, participant)

    def hide_nodes_of(self, others: set[bytes], ours: SharedParticipant) -> None:
        """Say that those participants of this process have no nodes; see :mod:`.hidden`."""
        if others and ours.domain not in self._hidden:
            self._hidden[ours.domain] = HiddenNodes(self, self._participants[ours.domain][0])
        for guid in others:
            self._hidden[ours.domain].add(guid)

    def owns(self, domain: int, participant: bytes) -> bool:
        """Whether the participant of that GUID is one of ours."""
        return any(one.guid == participant for one in self._participants.get(domain, ()))

    def resize_gids(self, domain: int, size: int) -> None:
        """Announce the nodes of a domain with Gids of so many bytes from now on."""
        for participant in self._participants[domain]:
            participant.gid_size = size
            participant.changed()

    def graph(self, domain: int, on_change: Callable[[], None]) -> PacedDiscovery:
        check_domain(domain)
        shared = self._participants.get(domain)
        return PacedDiscovery(self, shared[0] if shared else self._participant(domain), on_change)

    # --- waiting ------------------------------------------------------------

    def watch(self, reader: Watched) -> int:
        """Wait for the reader's samples; the key it is known by."""
        if self._waitset is None:
            self._waitset = cyclone.Waitset()
            self._resume.acquire()
            self._thread = threading.Thread(target=self._wait, name="uros-dds", daemon=True)
            self._thread.start()
        key = next(self._keys)
        self._readers[key] = reader
        self._waitset.attach(reader.entity, key)
        return key

    def watch_local(self, reader: DdsReader) -> None:
        """While a reader hears none but this middleware's own writers, let only the
        coming of others wake the waiting thread: of our own samples we know first.
        """
        cyclone.wake_on(reader.entity, cyclone.STATUS_SUBSCRIPTION_MATCHED)
        reader.local_only = True
        self._look_for_others(reader)
        self.written([reader])  # what transient-local writers of ours said before

    def _look_for_others(self, reader: Watched) -> bool:
        """Whether a reader, local so far, hears others' writers; from then on for good."""
        if cyclone.matched_writers(reader.entity) <= self.own_writers:
            return False
        reader.local_only = False
        cyclone.wake_on(reader.entity, cyclone.STATUS_DATA_AVAILABLE)
        return True

    def written(self, readers: list[DdsReader]) -> None:
        """These local readers have been written to."""
        if not self._written:
            self.wake.set()
        self._written[id(readers)] = readers

    def flush(self) -> None:
        unsent = self.unsent
        while unsent:
            cyclone.flush(unsent.pop())

    def again(self, reader: Watched) -> None:
        """Announce a reader once more, after others: it has enough for this turn, and something is
        left.
        """
        if not self._written:
            self.wake.set()
        self._written[-reader.key] = [reader]

    def notice(self, text: str) -> None:
        """Tell the user, once for each text."""
        if self.on_notice is not None and text not in self._noticed:
            if len(self._noticed) < _MAX_NOTICES:
                self._noticed.add(text)
                self.on_notice(text)

    def dispatch_local(self) -> None:
        if not self._written:
            return
        self.wake.clear()
        failed = self._announce_written()
        if self._ready:  # the waiting thread may have spoken in between
            self.wake.set()
        if failed is not None:
            raise failed

    def _announce_written(self) -> Exception | None:
        failed: Exception | None = None
        written, self._written = self._written, {}  # what these have written again has a turn too
        for readers in written.values():
            for reader in list(readers):
                if reader.key in self._readers:
                    failed = self._announce(reader) or failed
        return failed

    def _announce(self, reader: Watched) -> Exception | None:
        """Tell that there is something to take, once until it is taken.

        What goes wrong there is returned: others must hear of theirs first.
        """
        if reader.taken:
            reader.taken = False
            try:
                reader.on_ready()
            except Exception as error:
                return error
        return None

    def unwatch(self, reader: Watched) -> None:
        if self._readers.pop(reader.key, None) and self._waitset:
            self._waitset.detach(reader.entity)

    def resume(self, reader: Watched) -> None:
        """Wait again for a reader that was left full; see :meth:`dispatch`."""
        reader.paused = False
        if self._waitset and reader.key in self._readers:
            self._waitset.attach(reader.entity, reader.key)

    def _wait(self) -> None:
        waitset = self._waitset
        assert waitset is not None
        while not self._closed:
            ready = waitset.wait()
            if ready:
                self._ready = ready
                self.wake.set()
                self._resume.acquire()  # until the data plane has taken them

    def fileno(self) -> int:
        return self.wake.fileno()

    def dispatch(self) -> None:
        self.wake.clear()
        ready, self._ready = self._ready, []
        failed = self._announce_written()
        for key in ready:
            reader = self._readers.get(key)
            if reader is None or (reader.local_only and not self._look_for_others(reader)):
                continue
            if not reader.paused:
                failed = self._announce(reader) or failed
                if not reader.taken and key in self._readers and self._waitset:
                    # Nobody has room for it now: until somebody takes, it
                    # would wake us again and again.
                    reader.paused = True
                    self._waitset.detach(reader.entity)
        if ready:
            self._resume.release()
        if failed is not None:
            raise failed

    # --- the graph ----------------------------------------------------------

    def _all_participants(self) -> list[SharedParticipant]:
        return [one for shared in self._participants.values() for one in shared]

    def next_deadline(self) -> float | None:
        soonest: float | None = None
        for shared in self._participants.values():
            for one in shared:
                if one.due is not None and (soonest is None or one.due < soonest):
                    soonest = one.due
        for offers in self._offers.values():
            if offers.due is not None and (soonest is None or offers.due < soonest):
                soonest = offers.due
        for hidden in self._hidden.values():
            if hidden.due is not None and (soonest is None or hidden.due < soonest):
                soonest = hidden.due
        for announced in self.announced:
            if announced.due is not None and (soonest is None or announced.due < soonest):
                soonest = announced.due
        for graph in self.graphs:
            if graph.due is not None and (soonest is None or graph.due < soonest):
                soonest = graph.due
        return soonest

    def tick(self) -> None:
        now = time.monotonic()
        for participant in self._all_participants():
            if participant.due is not None and participant.due <= now:
                participant.announce()
        for offers in self._offers.values():
            if offers.due is not None and offers.due <= now:
                offers.tick(now)
        for hidden in self._hidden.values():
            if hidden.due is not None and hidden.due <= now:
                hidden.tick(now)
        for announced in self.announced:
            if announced.due is not None and announced.due <= now:
                announced.tick()
        for graph in self.graphs.copy():
            if graph.due is not None and graph.due <= now:
                graph.tell()

    def close(self) -> None:
        if self._closed:
            return
        self._closed = True
        if self._thread and self._waitset:
            self._waitset.wake()
            if self._resume.locked():
                self._resume.release()
            self._thread.join()
            self._waitset.close()
        for participant in self._all_participants():
            participant.close()
        for domain in self._domains:
            cyclone.close_domain(domain)
        self.wake.close()
