"""Discovery of the agent by boards, which ask a multicast group for its locators.

A client sends GET_INFO outside of any session, to the group or to a configured address; the INFO
that answers carries the locators of the agent. A locator is an address and a port and does not
tell UDP from TCP, so the locators of UDP come first.
"""

from __future__ import annotations

import errno
import socket
import sys
from collections.abc import Sequence
from typing import Final

from ... import addresses
from ...token_bucket import KeyedTokenBuckets
from ...wire import ids, session
from ...wire.cdr import Reader
from ...wire.errors import DecodeError
from ...wire.header import MessageWriter, pull_header, pull_subheader
from ..log import RateLimit
from .base import ERROR, INFO, MAX_BURST, WARNING, Host, ServerTransport, TransportError
from .ip import Address, bind_trouble, family_of, text_of
from .tcp import TcpServer
from .tls import TlsServer
from .udp import UdpServer

DEFAULT_PORT: Final = 7400
GROUP: Final = "239.255.0.2"
# The most that eProsima's clients have room for; as many fit their 200 bytes.
MAX_LOCATORS: Final = 4
# The most answers to one address at once and in a second, because the source of a question may be
# forged: then that address gets the answers, which are eight times as long.
MAX_ANSWERS: Final = 50
# The same for all addresses together, because many sources may be forged.
MAX_ANSWERS_IN_ALL: Final = 500
# Seconds from one log line about bad packets to the next, so that a flood does not fill the log.
FAULT_PAUSE: Final = 10.0
# Seconds between two scans of the interfaces, which may be added and removed at any time.
SCAN_PAUSE: Final = 10.0
_LARGEST: Final = 2048
_IP_MULTICAST_ALL: Final = 49  # of Linux; Python has no name for it


def read_question(buf: bytearray | bytes, length: int) -> tuple[int, int, int, int]:
    """Parse a GET_INFO: ``(session id, client key or 0, request id, object id)``.

    Raises DecodeError for anything else.
    """
    session_id, _, _, key, at = pull_header(buf, length)
    kind, flags, start, stop = pull_subheader(buf, at, length)
    outside = session_id in (ids.SESSION_NONE_WITH_KEY, ids.SESSION_NONE_WITHOUT_KEY)
    if kind == ids.CREATE_CLIENT:
        raise DecodeError("CREATE_CLIENT at the discovery port")
    if kind != ids.GET_INFO or not outside:
        raise DecodeError(f"submessage {kind} of session 0x{session_id:02X} is not a GET_INFO")
    r = Reader(buf, start, stop, bool(flags & ids.FLAG_LITTLE_ENDIAN))
    request_id, object_id, _ = session.pull_get_info(r)
    return session_id, key or 0, request_id, object_id


def write_answer(question: tuple[int, int, int, int], locators: list[tuple[bytes, int]]) -> bytes:
    """Encode the INFO that answers a GET_INFO."""
    session_id, key, request_id, object_id = question
    w = MessageWriter(bytearray(256), session_id, ids.STREAM_NONE, 0, key)
    w.begin(ids.INFO)
    session.push_info(w, request_id, object_id, ids.STATUS_OK, 0, locators)
    return bytes(w.finish())


def answer_limit() -> KeyedTokenBuckets:
    """Make the limit of answers, by the address that asks."""
    return KeyedTokenBuckets((MAX_ANSWERS, MAX_ANSWERS), (MAX_ANSWERS_IN_ALL, MAX_ANSWERS_IN_ALL))


class DiscoveryServer(ServerTransport):
    """Answers boards that search for an agent with the addresses of its UDP and TCP transports.

    It has no sessions. On Linux it joins the group on every interface with an IPv4 address, those
    added later too; elsewhere on the one that the system chooses.
    """

    name = "DiscoveryServer"
    kind = "UDP"

    def __init__(self, transports: Sequence[ServerTransport], port: int = DEFAULT_PORT) -> None:
        super().__init__()
        self.port = port
        self.faults = 0
        # Not TLS: a client that searches would use plain TCP there.
        network_transports = [
            each for each in transports
            if isinstance(each, (UdpServer, TcpServer)) and not isinstance(each, TlsServer)
        ]  # fmt: skip
        # Clients that use only the first address use UDP over IPv4.
        self._servers = sorted(
            network_transports,
            key=lambda server: (
                server.kind != "UDP",
                family_of(server.listens_on) == socket.AF_INET6,
            ),
        )
        self._limit = answer_limit()
        self._buf = bytearray(_LARGEST)
        self._group: socket.socket | None = None
        # Sockets of single addresses, by interface; see _own_socket.
        self._own: dict[str, tuple[str, socket.socket]] = {}
        self._joined: dict[str, str] = {}
        self._trouble: dict[str, str] = {}
        self._fault_lines = RateLimit(FAULT_PAUSE)

    def admits_boards(self, now: float) -> bool:
        """Return False: it has no sessions."""
        return False

    # --- sockets ------------------------------------------------------------------

    def open(self, host: Host) -> None:
        """Open and start watching; raises TransportError."""
        try:
            sock = _reusing_socket("0.0.0.0", self.port)
        except OSError as error:
            reason = bind_trouble("UDP", self.port, error, "--discovery")
            raise TransportError(error.errno, reason) from error
        self.port = sock.getsockname()[1]
        self._group = sock
        self._host = host
        host.watch(sock.fileno(), lambda: self._drain(sock))
        self._scan_interfaces()
        where = ", ".join(f"{name} ({ip})" for name, ip in self._joined.items())
        host.note(
            INFO, self.name, "init", "running...",
            f"port: {self.port}, group: {GROUP}, interfaces: {where or 'none'}",
        )  # fmt: skip
        if not self._servers:
            host.note(
                WARNING, self.name, "init", "nothing to discover",
                "the agent listens neither on UDP nor on TCP: add udp4, or leave --discovery out",
            )  # fmt: skip
        elif all(ip.startswith("127.") for ip in self._joined.values()):
            host.note(
                WARNING, self.name, "init", "only this machine can find the agent",
                "no network has the multicast group: connect one (checked again every"
                f" {SCAN_PAUSE:.0f} s), or tell boards this machine's address",
            )  # fmt: skip
        self._look_again()

    def _look_again(self) -> None:
        if self._group is not None:
            before = dict(self._joined)
            self._scan_interfaces()
            for name in self._joined.keys() - before.keys():
                self._host.note(
                    INFO, self.name, "scan", "interface found", f"{name} ({self._joined[name]})"
                )
            for name in before.keys() - self._joined.keys():
                self._host.note(
                    INFO, self.name, "scan", "interface lost", f"{name} ({before[name]})"
                )
            self._host.wake_at(SCAN_PAUSE, self._look_again)

    def _scan_interfaces(self) -> None:
        """Join the group on new interfaces, and leave those that were removed."""
        by_interface = addresses.ipv4_by_interface()
        if sys.platform != "linux":
            by_interface = {"default": "0.0.0.0"}
        for name in [name for name, ip in self._joined.items() if by_interface.get(name) != ip]:
            del self._joined[name]
            if name in self._own:
                sock = self._own.pop(name)[1]
                self._host.unwatch(sock.fileno())
                sock.close()
        for name, ip in by_interface.items():
            # Joined ones too: an interface that was away meanwhile is not a member any more.
            trouble = self._join(ip)
            if trouble is None:
                self._trouble.pop(name, None)
                if name not in self._joined:
                    self._joined[name] = ip
                    self._own_socket(name, ip)
            elif self._trouble.get(name) != trouble:
                self._trouble[name] = trouble
                self._host.note(
                    WARNING, self.name, "init", "no multicast",
                    f"interface: {name} ({ip}), {trouble}: boards there must ask this address"
                    " itself (is there a route, as by: ip route add 224.0.0.0/4 dev NAME?)",
                )  # fmt: skip

    def _join(self, ip: str) -> str | None:
        """Join the group at an address; return why it failed, None if it is joined."""
        if self._group is None:
            return "closed"
        membership = socket.inet_aton(GROUP) + socket.inet_aton(ip)
        try:
            self._group.setsockopt(socket.IPPROTO_IP, socket.IP_ADD_MEMBERSHIP, membership)
        except OSError as error:
            if error.errno != errno.EADDRINUSE:  # joined already, with another address
                return error.strerror or str(error)
        return None

    def _own_socket(self, name: str, ip: str) -> None:
        """Listen on one address too.

        Of several sockets on all addresses, the newest gets unicast messages. DDS opens such a
        socket in domain 0, whose multicast port is 7400; a socket on the address takes precedence.
        """
        if sys.platform != "linux":
            return
        try:
            sock = _reusing_socket(ip, self.port)
        except OSError:
            return  # without DDS the socket on all addresses is enough
        self._own[name] = ip, sock
        self._host.watch(sock.fileno(), lambda: self._drain(sock))

    def close(self) -> None:
        """Close everything; idempotent."""
        if self._group is not None:
            for sock in [self._group, *(sock for _, sock in self._own.values())]:
                self._host.unwatch(sock.fileno())
                sock.close()
            self._group = None
            self._own.clear()
            self._joined.clear()

    # --- questions and answers ------------------------------------------------------

    def _drain(self, sock: socket.socket) -> None:
        for _ in range(MAX_BURST):
            if sock.fileno() < 0:
                return
            try:
                length, peer = sock.recvfrom_into(self._buf)
            except BlockingIOError:
                return
            except OSError as error:
                self._host.note(ERROR, self.name, "receive", "socket error", str(error))
                return
            if self.admits is not None and not self.admits(peer[0]):
                continue
            try:
                question = read_question(self._buf, length)
            except DecodeError as error:
                self._fault(peer, str(error))
                continue
            if self._limit.take(peer[0], self._host.clock.monotonic()):
                locators = self.locators(peer)
                if locators:
                    self._reply(sock, peer, write_answer(question, locators))

    def _reply(self, sock: socket.socket, peer: Address, answer: bytes) -> None:
        try:
            sock.sendto(answer, peer)
        except OSError:
            pass  # no room, no route, no receiver: the board asks again

    def _fault(self, peer: Address, about: str) -> None:
        self.faults += 1
        if self._fault_lines.admit("fault"):
            self._host.note(
                WARNING, self.name, "receive", "not a question for agents",
                f"address: {text_of(peer)}, {about} ({self.faults} so far;"
                f" this port tells where the agent is, boards talk to it at {self._ports()})",
            )  # fmt: skip

    def _ports(self) -> str:
        return ", ".join(f"{server.kind} {server.port}" for server in self._servers) or "no port"

    def locators(self, client: Address) -> list[tuple[bytes, int]]:
        """Return the agent's addresses that the asking board can reach."""
        own_address = addresses.own_address((client[0], client[1]))
        if own_address is None:
            return []
        local = own_address.startswith("127.") or client[0] == own_address
        entries: list[tuple[bytes, int]] = []
        for server in self._servers:
            address = self._address_of(server.listens_on, own_address, local)
            if address is not None and not addresses.is_link_local(address):
                locator = socket.inet_pton(family_of(address), address), server.port
                if locator not in entries:
                    entries.append(locator)
        return entries[:MAX_LOCATORS]

    def _address_of(self, listens_on: str, own_address: str, local: bool) -> str | None:
        """Return the address for a board that reaches this machine at ``own_address``, or None."""
        if listens_on in ("0.0.0.0", ""):
            return own_address
        if listens_on != "::":
            for_all = not listens_on.startswith("127.") and listens_on != "::1"
            return listens_on if for_all or local else None
        if own_address.startswith("127."):
            return "::1"
        names = [name for name, ip in addresses.ipv4_by_interface().items() if ip == own_address]
        return addresses.ipv6_of(names[0] if names else None)

    # --- the rest of a transport: it has no peers -------------------------------------

    def send(self, peer: Address, datagram: bytes) -> None:
        """Do nothing: it has no peers."""

    def address(self, peer: Address) -> str:
        """Return the peer as text."""
        return text_of(peer)


def _reusing_socket(address: str, port: int) -> socket.socket:
    """Make a UDP socket that shares its port with other agents and DDS."""
    sock = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    try:
        sock.setblocking(False)
        sock.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        if sys.platform == "linux":
            # Otherwise it receives all groups joined on this machine, such as that of DDS.
            sock.setsockopt(socket.IPPROTO_IP, _IP_MULTICAST_ALL, 0)
        sock.bind((address, port))
    except OSError:
        sock.close()
        raise
    return sock
