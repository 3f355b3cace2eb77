"""All clients of one agent: who may come in, and whose a datagram is.

A session with an id from 0x80 on is known by the address it talks from, one
with a lower id by the client key in every header, wherever it talks from. What
belongs to no session can be a CREATE_CLIENT, a ping, or the farewell of a
client that is forgotten already; everything else stays unanswered, which is
how micro-ROS clients learn that they must start anew.
"""

from __future__ import annotations

import time
from typing import Any

from ..middleware.base import Middleware
from ..transport.base import ServerTransport
from ..wire import ids
from ..wire import session as messages
from ..wire.cdr import Reader
from ..wire.errors import DecodeError
from ..wire.header import MessageWriter, pull_header, pull_subheader
from ..wire.streams import TIME_MASK, ticks_diff
from .client import Client
from .control import Control
from .graph import Graphs
from .log import DEBUG, WARNING, Log, RateLimit
from .profiles import References
from .session import MIN_MTU, Session

# What one UDP datagram can hold; a client that can take more gets no more.
MAX_MTU = 65507
# Attack: a client that makes one topic after the other with a second type.
MAX_CONFLICTS = 1000
# Attack: CREATE_CLIENT with one key after the other. Those that made nothing and were silent
# the longest go first, so many at a time.
MAX_CLIENTS = 4096
_MAKE_ROOM = 256


class Agent:
    """See the module. One thread only: its server's."""

    def __init__(
        self,
        middleware: Middleware,
        log: Log | None = None,
        references: References | None = None,
        domain_of_agent: int = 0,
        domain_override: int | None = None,
        control: Control | None = None,
    ) -> None:
        self.middleware = middleware
        self.log = log or Log()
        self.faults = RateLimit()
        self.strangers = RateLimit(10.0)
        self.references = references or References()
        self.domain_of_agent = domain_of_agent
        self.domain_override = domain_override
        self.control = control or Control()
        self.clients: dict[int, Client] = {}
        # Where each client talks from: its transport and address there.
        self._places: dict[int, tuple[ServerTransport, Any]] = {}
        self.attended: set[Session] = set()
        self._scratch = bytearray(128)
        # The place of the client that left last: its confirmation goes there.
        self._left: dict[int, tuple[ServerTransport, Any]] = {}
        self._conflicts: set[tuple[str, str, str]] = set()
        self.graphs = Graphs(middleware, self.log)
        middleware.on_type_conflict = self._type_conflict
        middleware.on_notice = self._notice

    def address(self, key: int) -> str:
        """Where a client talks from, as a person reads it."""
        transport, peer = self._places[key]
        return transport.address(peer)

    def now(self) -> int:
        return int(time.monotonic() * 1000) & TIME_MASK

    def attend(self, session: Session) -> None:
        """The session has something to send, or a new deadline."""
        self.attended.add(session)

    def _type_conflict(self, topic: str, here: str, there: str) -> None:
        """Say once that samples of a topic do not reach each other."""
        conflict = topic, here, there
        if conflict not in self._conflicts and len(self._conflicts) < MAX_CONFLICTS:
            self._conflicts.add(conflict)
            self.log.warning(
                "Middleware", "create_endpoint", "type differs",
                f"topic: {topic}, type: {here}, elsewhere on the network: {there}"
                " (samples of one do not reach the other)",
            )  # fmt: skip

    def _notice(self, text: str) -> None:
        self.log.warning("Middleware", "notice", "middleware", text)

    # --- datagrams --------------------------------------------------------------

    def stray(
        self, transport: ServerTransport, peer: Any, buf: bytearray, view: memoryview, length: int
    ) -> None:
        """Handle a datagram that names no session of this peer."""
        try:
            session_id, stream_id, sequence, key, start = pull_header(buf, length)
            kind, flags, start, stop = pull_subheader(buf, start, length)
            r = Reader(view, start, stop, bool(flags & ids.FLAG_LITTLE_ENDIAN))
            if session_id in (ids.SESSION_NONE_WITH_KEY, ids.SESSION_NONE_WITHOUT_KEY):
                if kind == ids.CREATE_CLIENT:
                    self._create_client(transport, peer, r)
                elif kind == ids.GET_INFO:
                    self._ping(transport, peer, r, session_id, key or 0)
                return
            client = self.clients.get(key) if key is not None else None
            if client is not None and client.session.session_id == session_id:
                self._move(client, transport, peer)
                if client.session.receive(buf, view, length, self.now()):
                    self.attend(client.session)
            else:
                self._stranger(transport, peer, session_id)
                if kind == ids.DELETE:
                    self._farewell(transport, peer, r, session_id, key or 0)
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

    def _stranger(self, transport: ServerTransport, peer: Any, session_id: int) -> None:
        """Somebody goes on with a session of another agent, or of before our start."""
        address = transport.address(peer)
        if self.strangers.admit(f"{transport.name} {address}"):
            self.log.warning(
                "SessionManager", "receive", "unknown session",
                f"address: {address}, session_id: 0x{session_id:02X}"
                " (a board that pings will start anew by itself; reset one that does not)",
            )  # fmt: skip

    def _create_client(self, transport: ServerTransport, peer: Any, r: Reader) -> None:
        cookie, version, _, key, session_id, _, mtu = messages.pull_create_client(r)
        status = ids.STATUS_OK
        what = ""
        if key == 0 or cookie != ids.COOKIE:
            status = ids.STATUS_ERR_INVALID_DATA
            what = "invalid client key" if key == 0 else "invalid cookie"
        elif session_id in (ids.SESSION_NONE_WITH_KEY, ids.SESSION_NONE_WITHOUT_KEY):
            status, what = ids.STATUS_ERR_INVALID_DATA, "invalid session id"
        elif version[0] != ids.VERSION_MAJOR:
            status, what = ids.STATUS_ERR_INCOMPATIBLE, "incompatible version"
        elif mtu < MIN_MTU:
            status, what = ids.STATUS_ERR_INVALID_DATA, f"MTU of {mtu} is under {MIN_MTU}"
        elif not self._has_room(key):
            status, what = ids.STATUS_ERR_RESOURCES, f"over {MAX_CLIENTS} clients"
        if status == ids.STATUS_OK:
            self._admit(transport, peer, key, session_id, min(mtu, MAX_MTU, transport.mtu))
        elif (times := self.faults.times(f"create_client {status}")) is not None:
            self.log.warning("Root", "create_client", what, f"client_key: 0x{key:08X}{times}")
        w = MessageWriter(self._scratch, session_id, ids.STREAM_NONE, 0, key)
        w.begin(ids.STATUS_AGENT)
        messages.push_status_agent(w, status)
        self._send(transport, peer, w.finish(), key)

    def _has_room(self, key: int) -> bool:
        """Whether the client may come in; those of no use leave for it."""
        if key in self.clients or len(self.clients) < MAX_CLIENTS:
            return True
        now = self.now()
        bare = [client for client in self.clients.values() if not client.objects]
        bare.sort(key=lambda client: ticks_diff(client.session.heard, now))
        for client in bare[:_MAKE_ROOM]:
            self.delete_client(client.key)
        return len(self.clients) < MAX_CLIENTS

    def _admit(
        self, transport: ServerTransport, peer: Any, key: int, session_id: int, mtu: int
    ) -> None:
        resident = transport.sessions.get(peer)
        if resident is not None and resident.key != key:
            self.delete_client(resident.key)
        client = self.clients.get(key)
        if client is not None and client.session.session_id != session_id:
            self.delete_client(key)
            client = None
        about = f"client_key: 0x{key:08X}, session_id: 0x{session_id:02X}"
        if client is None:
            client = self.clients[key] = Client(self, key, session_id, mtu)
            self.log.info("Root", "create_client", "create", about)
            client.session.heard = self.now()
        else:
            # The same client again: its streams start anew, its objects stay.
            client.session.mtu = mtu
            client.session.heard = self.now()
            client.session.reset()
            self.attend(client.session)
            self.log.info("Root", "create_client", "session re-established", about)
        self._move(client, transport, peer)

    def _move(self, client: Client, transport: ServerTransport, peer: Any) -> None:
        """The client talks from here now."""
        place = self._places.get(client.key)
        if place == (transport, peer):
            return
        if place is not None:
            place[0].sessions.pop(place[1], None)
        self._places[client.key] = transport, peer
        if client.session.session_id & 0x80:
            transport.sessions[peer] = client.session
        self.log.info(
            "SessionManager", "establish_session", "session established",
            f"client_key: 0x{client.key:08X}, address: {transport.address(peer)}",
        )  # fmt: skip

    def _ping(
        self, transport: ServerTransport, peer: Any, r: Reader, session_id: int, key: int
    ) -> None:
        request_id, object_id, _ = messages.pull_get_info(r)
        known = key in self.clients if key else peer in transport.sessions
        w = MessageWriter(self._scratch, session_id, ids.STREAM_NONE, 0, key)
        w.begin(ids.INFO)
        messages.push_info(w, request_id, object_id, ids.STATUS_OK, int(known), [])
        self._send(transport, peer, w.finish(), key)

    def _farewell(
        self, transport: ServerTransport, peer: Any, r: Reader, session_id: int, key: int
    ) -> None:
        """A client that is forgotten says goodbye: confirm it, or it waits in vain."""
        request_id, object_id = messages.pull_request(r)
        if object_id & 0x0F != ids.KIND_CLIENT:
            return
        w = MessageWriter(self._scratch, session_id, ids.STREAM_NONE, 0, key)
        w.begin(ids.STATUS)
        messages.push_status(w, request_id, object_id, ids.STATUS_OK)
        self._send(transport, peer, w.finish(), key)

    # --- sending -----------------------------------------------------------------

    def _send(self, transport: ServerTransport, peer: Any, datagram: bytes, key: int) -> None:
        if self.log.level >= DEBUG:
            trace(self.log, transport, "send", datagram, len(datagram), key)
        transport.send(peer, datagram)

    def flush(self, session: Session) -> None:
        """Send what the session has to send to where its client is, or was."""
        outgoing = session.outgoing
        if not outgoing:
            return
        place = self._places.get(session.key) or self._left.pop(session.key, None)
        if place is not None:
            transport, peer = place
            if self.log.level >= DEBUG:
                for datagram in outgoing:
                    trace(self.log, transport, "send", datagram, len(datagram), session.key)
            for datagram in outgoing:
                transport.send(peer, datagram)
        outgoing.clear()

    # --- leaving -------------------------------------------------------------------

    def delete_client(self, key: int) -> bool:
        """Forget a client and all it made; whether there was one.

        What its session still has to say is sent by the next :meth:`flush`.
        """
        client = self.clients.pop(key, None)
        if client is None:
            return False
        client.close()
        place = self._places.pop(key, None)
        if place is not None:
            place[0].sessions.pop(place[1], None)
            self._left = {key: place}
        about = f"client_key: 0x{key:08X}"
        self.log.info("Root", "delete_client", "delete", about)
        if place is not None:
            self.log.info(
                "SessionManager", "destroy_session", "session closed",
                f"{about}, address: {place[0].address(place[1])}",
            )  # fmt: skip
        return True

    def gone(self, transport: ServerTransport, peer: Any) -> None:
        """The peer's connection is closed: a session cannot outlive a TCP connection."""
        for key, place in list(self._places.items()):
            if place == (transport, peer):
                self.delete_client(key)

    def close(self) -> None:
        """Say goodbye to the network for every client."""
        for key in list(self.clients):
            self.delete_client(key)


def trace(
    log: Log, transport: ServerTransport, function: str, message: bytes | memoryview, length: int,
    key: int,
) -> None:  # fmt: skip
    """A line for a message: at level 5 its length, at 6 its bytes too."""
    label = transport.kind
    arrow = f"[** <<{label}>> **]" if function == "send" else f"[==>> {label} <<==]"
    about = f"client_key: 0x{key:08X}, len: {length}"
    if log.level > DEBUG:
        about += f", data: {bytes(message[:length]).hex(' ').upper()}"
    log.debug(transport.name, f"{function}_message", arrow, about)
