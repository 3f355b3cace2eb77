"""All clients of one agent: admits them, and assigns each message to a client.

A session with an id from 0x80 on is found by the sender's address. One with a lower id is found by
the client key in every header, whatever the address. An unmatched message, which belongs to no
session of its sender, can be a CREATE_CLIENT, a ping, or the DELETE of a client that is deleted
already. All others get no answer, and thus micro-ROS clients learn that they must create their
session again. A message with the key of a client at another address is handled by
:mod:`.policy.key_conflict`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any

from ..middleware.base import Middleware
from ..wire import ids
from ..wire import session as messages
from ..wire.cdr import Reader
from ..wire.errors import DecodeError
from ..wire.header import MessageWriter, pull_header, pull_subheader
from .clock import Clock
from .context import CreateClientRequest, Persistence
from .log import WARNING, Log, RateLimit, unexpected
from .malloc_trim import Heap
from .objects.client import ProxyClient
from .objects.kinds import key_label
from .objects.ros_graph import Graphs
from .objects.xml_profiles import References
from .observability.message_hooks import AGENT, MessageHooks
from .policy.admission import (
    ADDRESS_NOT_ALLOWED,
    KEY_NOT_ALLOWED,
    MAX_CLIENTS,
    Admission,
    Refusals,
)
from .policy.eviction import EvictionPolicy
from .policy.key_conflict import KeyConflicts
from .policy.limits import Limits
from .policy.line_loss import LineLossMonitor
from .policy.liveliness import CHECK_MS, DEAD_TIME, Liveliness
from .policy.memory_budget import CLIENT_BYTES, MemoryBudget
from .policy.rules import Rules
from .policy.time_budget import DeferredCloseQueue, TimeBudget
from .session.session import MIN_MTU, Session
from .transports.base import ServerTransport

# What one UDP datagram can hold: the largest MTU of any client.
MAX_MTU = 65507
# The most type conflicts that are logged, because a client may create one topic after the other
# with a second type.
MAX_CONFLICTS = 1000


class Agent:
    """An agent: its clients and what they share. Only its server's thread may use it.

    Args:
        middleware: Where the clients' nodes are created; its server closes it.
        log: Where it logs.
        references: Profiles and types that clients may name.
        domain_of_agent: The domain of clients that ask for the agent's.
        domain_override: The domain of all clients, whatever they ask for.
        rules: Names, QoS and rates that the owner has set.
        admission: Keys, networks and the number of clients that the owner admits.
        dead_time: Seconds of silence, with unanswered probes, after which a client is deleted.
        limits: What one client, and all together, may use.
        clock: The time; by default the system's.
    """

    def __init__(
        self,
        middleware: Middleware,
        log: Log | None = None,
        references: References | None = None,
        domain_of_agent: int = 0,
        domain_override: int | None = None,
        rules: Rules | None = None,
        admission: Admission | None = None,
        dead_time: float | None = None,
        limits: Limits | None = None,
        clock: Clock | None = None,
    ) -> None:
        self.middleware = middleware
        self.clock = clock or Clock()
        # Milliseconds modulo 2^30.
        self.now: Callable[[], int] = self.clock.ticks
        self.log = log or Log(clock=self.clock)
        self.message_hooks = MessageHooks(self.log, self.clock)
        self.faults = RateLimit(clock=self.clock.monotonic)
        self.unmatched_faults = RateLimit(10.0, clock=self.clock.monotonic)
        self.references = references or References()
        self.domain_of_agent = domain_of_agent
        self.domain_override = domain_override
        self.rules = rules or Rules()
        self.admission = admission or Admission()
        self.refusals = Refusals()
        self.session_store: Persistence | None = None  # with --state
        self.clients: dict[int, ProxyClient] = {}
        self.limits = limits or Limits()
        self.budget = MemoryBudget(self.limits.memory, lambda: self.clients.values(), self._dismiss)
        self.time_budget = TimeBudget(self.clock.monotonic)
        self.close_queue = DeferredCloseQueue(self.failed, self.clock.monotonic)
        self.heap = Heap()
        # The transport and address of each client.
        self._places: dict[int, tuple[ServerTransport, Any]] = {}
        self.eviction = EvictionPolicy()
        self.attended: set[Session] = set()
        self._scratch = bytearray(128)
        # Sessions that have ended since the last flush, which removes them: their last messages,
        # such as the answer to DELETE, go to the address that they had.
        self._left: dict[Session, tuple[ServerTransport, Any]] = {}
        self._conflicts: set[tuple[str, str, str]] = set()
        self.liveliness = Liveliness(self, DEAD_TIME if dead_time is None else dead_time)
        self.key_conflicts = KeyConflicts(self)
        self.line_loss = LineLossMonitor(self)
        # Calls a function once, so many seconds from now; calls nothing before :meth:`start`.
        self.wake_at: Callable[[float, Callable[[], None]], None] = lambda seconds, call: None
        self.graphs = Graphs(middleware, self.log)
        middleware.on_type_conflict = self._type_conflict
        middleware.on_notice = self._notice

    def start(
        self, wake_at: Callable[[float, Callable[[], None]], None],
        transports: Iterable[ServerTransport],
    ) -> None:  # fmt: skip
        """Start the timers, just before the transports are opened.

        Args:
            wake_at: Calls a function once, so many seconds from now.
            transports: What the agent will listen on.
        """
        self.wake_at = wake_at
        for transport in transports:
            transport.admits = self.admission.admits_host if self.admission.networks else None
            transport.on_refused = self._refused_connection
        self._check()

    def _refused_connection(self, rule: str, address: str, why: str) -> None:
        self.refusals.count("connection", rule, address, why, self.clock.monotonic())

    def _check(self) -> None:
        pause = CHECK_MS / 1000
        try:
            pause = self.liveliness.check()
            if self.budget.freed:
                self.budget.freed, self.heap.clients_left = False, True
            self.heap.check(self.clock.monotonic())
        finally:
            self.wake_at(pause, self._check)

    def place(self, key: int) -> tuple[ServerTransport, Any]:
        """Return a client's transport, and its address there."""
        return self._places[key]

    def address(self, key: int) -> str:
        """Return a client's address as text."""
        transport, peer = self._places[key]
        return transport.address(peer)

    def attend(self, session: Session) -> None:
        """Note that the session has something to send, or a new deadline."""
        self.attended.add(session)

    def failed(self, error: Exception) -> None:
        """Log an unexpected error; the agent continues."""
        count = self.faults.admit(f"internal {type(error).__name__}")
        if count:
            frame = error.__traceback__
            while frame is not None and frame.tb_next is not None:
                frame = frame.tb_next
            where = f"{frame.tb_frame.f_code.co_filename}:{frame.tb_lineno}" if frame else "?"
            self.log.error("Server", "run", "internal error", unexpected(error, f" at {where}"))

    def _type_conflict(self, topic: str, type_name: str, other_type: str) -> None:
        """Warn once that samples of a topic do not reach the endpoints of its other type."""
        conflict = topic, type_name, other_type
        if conflict not in self._conflicts and len(self._conflicts) < MAX_CONFLICTS:
            self._conflicts.add(conflict)
            self.log.warning(
                "Middleware", "create_endpoint", "type differs",
                f"topic: {topic}, type: {type_name}, elsewhere on the network: {other_type}"
                " (samples of one do not reach the other)",
            )  # fmt: skip

    def _notice(self, text: str) -> None:
        self.log.warning("Middleware", "notice", "middleware", text)

    # --- datagrams --------------------------------------------------------------

    def unmatched(
        self, transport: ServerTransport, peer: Any, buf: bytearray, view: memoryview, length: int
    ) -> None:
        """Handle a message that belongs to no session of this peer."""
        if self.admission.networks and self._is_outside(transport, peer, view[:length]):
            return
        try:
            session_id, stream_id, sequence, key, start = pull_header(buf, length)
            kind, flags, start, stop = pull_subheader(buf, start, length)
            r = Reader(view, start, stop, bool(flags & ids.FLAG_LITTLE_ENDIAN))
            if session_id in (ids.SESSION_NONE_WITH_KEY, ids.SESSION_NONE_WITHOUT_KEY):
                if kind == ids.CREATE_CLIENT:
                    if stop > start:
                        r.end = length  # the length that C clients write leaves out properties
                    self._create_client(transport, peer, r)
                elif kind == ids.GET_INFO:
                    self._ping(transport, peer, r, session_id, key or 0)
                return
            client = self.clients.get(key) if key is not None else None
            if client is not None and client.session.session_id == session_id:
                if self._places[client.key] != (transport, peer):
                    if self._may_continue(client, transport, peer):
                        self.key_conflicts.challenge(client, transport, peer, None)
                    else:  # it must create its session again, under the rules of its own address
                        self._unknown_session(transport, peer, session_id)
                elif client.session.receive(buf, view, length, self.now()):
                    self.attend(client.session)
            else:
                self._unknown_session(transport, peer, session_id)
                if kind == ids.DELETE:
                    self._confirm_delete(transport, peer, r, session_id, key or 0)
        except DecodeError as error:
            self._fault(transport, peer, str(error))

    def _fault(self, transport: ServerTransport, peer: Any, about: str) -> None:
        address = transport.address(peer)
        times = self.faults.times(f"{transport.name} {address}")
        if times is not None:
            self.log(
                WARNING, transport.name, "receive", "not an XRCE message",
                f"address: {address}, {about}{times}",
            )  # fmt: skip

    def _unknown_session(self, transport: ServerTransport, peer: Any, session_id: int) -> None:
        """Warn of a message of an unknown session, which another agent or a former run may have."""
        address = transport.address(peer)
        if self.unmatched_faults.admit(f"{transport.name} {address}"):
            self.log.warning(
                "SessionManager", "receive", "unknown session",
                f"address: {address}, session_id: 0x{session_id:02X}"
                " (a board that pings will start anew by itself; reset one that does not)",
            )  # fmt: skip

    def _create_client(self, transport: ServerTransport, peer: Any, r: Reader) -> None:
        cookie, version, _, key, session_id, properties, mtu = messages.pull_create_client(r)
        status = ids.STATUS_OK
        reason = remedy = ""
        if key == 0 or cookie != ids.COOKIE:
            status = ids.STATUS_ERR_INVALID_DATA
            reason = "invalid client key" if key == 0 else "invalid cookie"
        elif session_id in (ids.SESSION_NONE_WITH_KEY, ids.SESSION_NONE_WITHOUT_KEY):
            status, reason = ids.STATUS_ERR_INVALID_DATA, "invalid session id"
        elif version[0] != ids.VERSION_MAJOR:
            status, reason = ids.STATUS_ERR_INCOMPATIBLE, "incompatible version"
        elif mtu < MIN_MTU:
            status, reason = ids.STATUS_ERR_INVALID_DATA, f"MTU of {mtu} is under {MIN_MTU}"
        elif not self.admission.admits_key(key):
            status, reason = ids.STATUS_ERR_DENIED, KEY_NOT_ALLOWED
            remedy = f" (to let it in: --allow-key {key_label(key)})"
        elif not self._has_room(key, transport, peer):
            over = self.admission.max_clients
            status, reason = ids.STATUS_ERR_RESOURCES, f"over {over} clients"
            remedy = f" (see --max-clients, which can be {MAX_CLIENTS})" * (over < MAX_CLIENTS)
        elif key not in self.clients and not self.budget.admit(CLIENT_BYTES, True):
            status, reason = ids.STATUS_ERR_RESOURCES, "memory for clients used up"
            remedy = " (see --max-memory)"
        if status == ids.STATUS_OK:
            request = CreateClientRequest(session_id, min(mtu, MAX_MTU, transport.mtu), properties)
            client = self.clients.get(key)
            if client is not None and self._places[key] != (transport, peer):
                self.key_conflicts.challenge(client, transport, peer, request)
            else:
                self.take_over(key, transport, peer, request)
            return
        self.refusals.note(key, reason, transport.address(peer), self.clock.monotonic())
        if (times := self.faults.times(f"create_client {reason}")) is not None:
            self.log.warning(
                "Root", "create_client", reason,
                f"client_key: {key_label(key)}, address: {transport.address(peer)}{remedy}{times}",
            )  # fmt: skip
        self._answer_create(key, transport, peer, session_id, status)

    def take_over(
        self, key: int, transport: ServerTransport, peer: Any, request: CreateClientRequest | None
    ) -> None:
        """Give a client's key to an address.

        Args:
            key: The client key.
            transport: The transport of the address.
            peer: The address.
            request: The CREATE_CLIENT to answer; None: the known session continues there.
        """
        if request is None:
            self._move(self.clients[key], transport, peer)
            if self.session_store is not None:
                self.session_store.placed(self.clients[key], transport, peer, None)
            return
        status = ids.STATUS_ERR_RESOURCES
        if self._has_room(key, transport, peer):  # another client may have taken the last place
            status = ids.STATUS_OK
            self._admit(transport, peer, key, request)
        self._answer_create(key, transport, peer, request.session_id, status)

    def deny(
        self, key: int, transport: ServerTransport, peer: Any, request: CreateClientRequest
    ) -> None:
        """Answer a CREATE_CLIENT with STATUS_ERR_DENIED."""
        self._answer_create(key, transport, peer, request.session_id, ids.STATUS_ERR_DENIED)

    def _answer_create(
        self, key: int, transport: ServerTransport, peer: Any, session_id: int, status: int
    ) -> None:
        w = MessageWriter(self._scratch, session_id, ids.STREAM_NONE, 0, key)
        w.begin(ids.STATUS_AGENT)
        messages.push_status_agent(w, status)
        self._send(transport, peer, w.finish(), key)

    def _is_outside(self, transport: ServerTransport, peer: Any, message: memoryview) -> bool:
        """Return whether the sender is in no allowed network, so that it gets no answer."""
        host = transport.host_of(peer)
        if self.admission.admits_host(host):
            return False
        count = self.unmatched_faults.admit(f"outside {host}")
        if count:
            address, reason = transport.address(peer), ADDRESS_NOT_ALLOWED
            now = self.clock.monotonic()
            key = requested_key(message)
            if key is not None:
                self.refusals.note(key, reason, address, now, count)
            else:
                self.refusals.count("connection", "allow_net", address, reason, now, times=count)
            self.log.warning(
                transport.name, "receive", reason,
                f"address: {address}, it is in no allowed network"
                + (f", client_key: {key_label(key)}" if key is not None else "")
                + (f" ({count} messages)" if count > 1 else ""),
            )  # fmt: skip
        return True

    def _has_room(self, key: int, transport: ServerTransport, peer: Any) -> bool:
        """Return whether there is a place for the client; :mod:`.policy.eviction` may free one."""
        most = self.admission.max_clients
        if key in self.clients:
            return True
        if len(self.clients) < most and not self.eviction.is_over(transport, peer, most):
            return True
        leaving, why = self.eviction.select(transport, peer, most, self.now())
        for client in leaving:
            self.delete_client(client.key)
        if leaving and (times := self.faults.times("no places left")) is not None:
            self.log.warning(
                "Root", "create_client", "no places left",
                f"{len(leaving)} clients are forgotten for newcomers, {why}; one of them:"
                f" client_key: {key_label(leaving[0].key)}{times}",
            )  # fmt: skip
        return bool(leaving)

    def _admit(
        self, transport: ServerTransport, peer: Any, key: int, request: CreateClientRequest
    ) -> None:
        session_id, mtu, properties = request
        former = transport.sessions.get(peer)
        if former is not None and former.key != key:
            self.delete_client(former.key)
        client = self.clients.get(key)
        if client is not None and (
            client.session.session_id != session_id
            or not self._may_continue(client, transport, peer)
        ):
            self.delete_client(key)
            client = None
        about = f"client_key: {key_label(key)}, session_id: 0x{session_id:02X}"
        if client is None:
            client = self.clients[key] = ProxyClient(
                self, key, session_id, mtu, transport.certificate_of(peer)
            )
            self.log.info("Root", "create_client", "create", about)
            client.session.heard = self.now()
        else:
            # The client exists already: its streams are reset, its objects stay.
            client.session.mtu = mtu
            client.session.heard = self.now()
            client.begin_anew(self.now())
            client.refused.clear()
            self.attend(client.session)
            self.log.info("Root", "create_client", "session re-established", about)
        self._move(client, transport, peer)
        if self.session_store is not None:
            self.session_store.placed(client, transport, peer, properties)
        self.liveliness.enroll(client, properties)

    def _may_continue(self, client: ProxyClient, transport: ServerTransport, peer: Any) -> bool:
        """Return whether the client may keep its objects at this address.

        They were created under the rules of its present address, so the new one must have the same
        transport, certificate and rules.
        """
        old_transport, old_peer = self._places[client.key]
        return old_transport is transport and (
            old_peer == peer
            or (
                client.certificate == transport.certificate_of(peer)
                and self.rules.same_rules(
                    client.key, old_transport.address(old_peer), transport.address(peer)
                )
            )
        )

    def resume(
        self, key: int, transport: ServerTransport, peer: Any, request: CreateClientRequest
    ) -> ProxyClient:
        """Create a client again that existed before the restart, without a message from it.

        The caller has checked that it is admitted.
        """
        self._admit(transport, peer, key, request)
        client = self.clients[key]
        self.line_loss.watch(client)  # its board may have been unplugged meanwhile
        client.resumed_at = client.session.heard
        return client

    def _move(self, client: ProxyClient, transport: ServerTransport, peer: Any) -> None:
        """Set the client's address."""
        place = self._places.get(client.key)
        if place == (transport, peer):
            return
        if place is not None:
            self.eviction.remove(client, *place)
            place[0].sessions.pop(place[1], None)
        self._places[client.key] = transport, peer
        self.eviction.add(client, transport, peer)
        if client.session.session_id & 0x80:
            transport.sessions[peer] = client.session
        self.log.info(
            "SessionManager", "establish_session", "session established",
            f"client_key: {key_label(client.key)}, address: {transport.address(peer)}",
        )  # fmt: skip

    def _ping(
        self, transport: ServerTransport, peer: Any, r: Reader, session_id: int, key: int
    ) -> None:
        request_id, object_id, _ = messages.pull_get_info(r)
        client = self.clients.get(key)
        if not key and (session := transport.sessions.get(peer)) is not None:
            client = self.clients.get(session.key)
        if client is not None and self._places[client.key] == (transport, peer):
            client.session.heard = self.now()  # the client itself, outside of its session
        w = MessageWriter(self._scratch, session_id, ids.STREAM_NONE, 0, key)
        w.begin(ids.INFO)
        messages.push_info(w, request_id, object_id, ids.STATUS_OK, int(client is not None), [])
        self._send(transport, peer, w.finish(), key)

    def _confirm_delete(
        self, transport: ServerTransport, peer: Any, r: Reader, session_id: int, key: int
    ) -> None:
        """Confirm the DELETE of a client that is deleted already and waits for the answer."""
        request_id, object_id = messages.pull_request(r)
        if object_id & 0x0F != ids.KIND_CLIENT:
            return
        w = MessageWriter(self._scratch, session_id, ids.STREAM_NONE, 0, key)
        w.begin(ids.STATUS)
        messages.push_status(w, request_id, object_id, ids.STATUS_OK)
        self._send(transport, peer, w.finish(), key)

    # --- sending -----------------------------------------------------------------

    def _send(self, transport: ServerTransport, peer: Any, datagram: bytes, key: int) -> None:
        if self.message_hooks:
            self.message_hooks(transport, peer, AGENT, datagram, len(datagram), key)
        transport.send(peer, datagram)

    def flush(self, session: Session) -> None:
        """Send the session's messages to its client's address, or to the last one that it had."""
        outgoing = session.outgoing
        place = self._left.pop(session, None) or self._places.get(session.key)
        if not outgoing:
            return
        if place is not None:
            transport, peer = place
            if self.message_hooks:
                for datagram in outgoing:
                    self.message_hooks(transport, peer, AGENT, datagram, len(datagram), session.key)
            size = 0
            for datagram in outgoing:
                transport.send(peer, datagram)
                size += len(datagram)
            session.sent += len(outgoing)
            session.sent_bytes += size
        outgoing.clear()

    # --- leaving -------------------------------------------------------------------

    def delete_client(self, key: int) -> bool:
        """Delete a client and its objects; return whether it existed.

        The next :meth:`flush` sends the last messages of its session.
        """
        client = self.clients.pop(key, None)
        if client is None:
            return False
        if self.session_store is not None:
            self.session_store.forget(key)
        client.close()
        self.heap.clients_left = True
        place = self._places.pop(key, None)
        if place is not None:
            self.eviction.remove(client, *place)
            place[0].sessions.pop(place[1], None)
            self._left[client.session] = place
            self.attend(client.session)  # so that the server flushes its last messages
        about = f"client_key: {key_label(key)}"
        self.log.info("Root", "delete_client", "delete", about)
        if place is not None:
            self.log.info(
                "SessionManager", "destroy_session", "session closed",
                f"{about}, address: {place[0].address(place[1])}",
            )  # fmt: skip
        return True

    def _dismiss(self, key: int, held_bytes: int) -> None:
        """Delete a client because the memory for all clients is used up."""
        times = self.faults.times("memory")
        if times is not None:
            self.log.warning(
                "Root", "budget", "memory used up",
                f"client_key: {key_label(key)} held {held_bytes} bytes and is forgotten"
                f" (all clients together may hold {self.limits.memory}: raise --max-memory, or find"
                f" out what it does){times}",
            )  # fmt: skip
        self.delete_client(key)

    def has_client(self, transport: ServerTransport, peer: Any) -> bool:
        """Return whether a client has this address."""
        return (transport, peer) in self._places.values()

    def gone(self, transport: ServerTransport, peer: Any) -> None:
        """Delete the clients of a closed connection: a session ends with its TCP connection."""
        self.key_conflicts.gone(transport, peer)
        for key, place in list(self._places.items()):
            if place == (transport, peer):
                self.delete_client(key)

    def close(self) -> None:
        """Delete all clients."""
        for key in list(self.clients):
            self.delete_client(key)


def requested_key(message: memoryview) -> int | None:
    """Return the client key in a CREATE_CLIENT, or None if the message is another."""
    try:
        buf = bytes(message)
        _, _, _, _, start = pull_header(buf, len(buf))
        kind, flags, start, _ = pull_subheader(buf, start, len(buf))
        if kind != ids.CREATE_CLIENT:
            return None
        r = Reader(buf, start, len(buf), bool(flags & ids.FLAG_LITTLE_ENDIAN))
        return messages.pull_create_client(r)[3]
    except DecodeError:
        return None
