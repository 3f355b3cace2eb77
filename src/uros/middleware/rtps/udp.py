"""The UDP sockets of one domain, by ROS's discovery range.

One socket receives discovery and data by unicast: its port is the well-known one of the lowest free
participant index (RTPS 9.6.2.3), so that peers which know only the address find it. Where multicast
is allowed, a second socket receives the announcements of all participants.
"""

from __future__ import annotations

import errno
import socket
import struct
from collections.abc import Iterator
from typing import Final

from ...addresses import ipv4_by_interface, own_address
from ..base import MiddlewareError
from . import locators
from .locators import UDPV4, Locator

# Two hundred ROS processes on one machine; RTPS ports allow no more.
MAX_INDEX: Final = 119
# Participants without multicast are looked for at these indices of each peer; Fast DDS too.
_PEER_INDICES: Final = range(32)
LOOPBACK: Final = "127.0.0.1"
# A burst of fragments is received as a whole where the system allows that much.
_BUFFER: Final = 4 * 1024 * 1024
_LARGEST: Final = 65536
# Attack: a flood of datagrams. A socket is drained up to so many, then others have their turn.
_MAX_BURST: Final = 64


class DomainSockets:
    """The sockets of a domain.

    Attributes:
        unicast: Where peers reach us.
        multicast: Where all participants of the domain receive announcements; empty without.
        peers: Further places to announce to.

    Args:
        domain: The domain.
        reach: ROS's discovery range, one of ``environment.RANGES``.
        static_peers: The peers of ROS_STATIC_PEERS, as addresses or host names.

    Raises:
        MiddlewareError: No index is free, or there is no address.
    """

    def __init__(self, domain: int, reach: str, static_peers: list[str]) -> None:
        self.unicast: list[Locator] = []
        self.multicast: list[Locator] = []
        self.peers: list[Locator] = []
        self._sockets: list[socket.socket] = []
        self._senders: dict[str, socket.socket] = {}  # for multicast, by interface's address
        self._buffer = bytearray(_LARGEST)
        self._view = memoryview(self._buffer)
        if reach == "OFF":
            return
        addresses = [LOOPBACK] if reach == "LOCALHOST" else _own_addresses()
        bind_to = LOOPBACK if reach == "LOCALHOST" else "0.0.0.0"
        self._main, port = self._open_unicast(domain, bind_to)
        self.unicast = [Locator(UDPV4, port, address) for address in addresses]
        if reach in ("SUBNET", "SYSTEM_DEFAULT"):
            self._open_multicast(domain, addresses)
        wanted = [LOOPBACK] if reach == "LOCALHOST" else []
        if reach != "SYSTEM_DEFAULT":
            wanted += static_peers
        for peer in wanted:
            self.peers += _places(peer, domain)

    def _open_unicast(self, domain: int, address: str) -> tuple[socket.socket, int]:
        """The socket on the port of the lowest free index."""
        for index in range(MAX_INDEX + 1):
            port = locators.metatraffic_port(domain, index)
            sock = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
            try:
                # Without SO_REUSEADDR: a port of another participant must not be shared.
                sock.bind((address, port))
            except OSError as error:
                sock.close()
                if error.errno != errno.EADDRINUSE:
                    raise MiddlewareError(f"domain {domain}: UDP port {port}: {error}") from error
                continue
            self._adopt(sock)
            return sock, port
        raise MiddlewareError(
            f"domain {domain} has {MAX_INDEX + 1} participants on this machine already: use another"
            " domain"
        )

    def _open_multicast(self, domain: int, addresses: list[str]) -> None:
        port = locators.multicast_port(domain)
        sock = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        sock.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        if hasattr(socket, "SO_REUSEPORT"):
            try:
                sock.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEPORT, 1)
            except OSError:
                pass
        try:
            sock.bind(("", port))
        except OSError as error:
            sock.close()
            raise MiddlewareError(f"domain {domain}: UDP port {port}: {error}") from error
        self._adopt(sock)
        group = socket.inet_aton(locators.MULTICAST_GROUP)
        for address in addresses:
            own = socket.inet_aton(address)
            try:
                sock.setsockopt(socket.IPPROTO_IP, socket.IP_ADD_MEMBERSHIP, group + own)
            except OSError:
                continue  # an interface without multicast
            sender = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
            sender.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_IF, own)
            sender.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_LOOP, 1)
            sender.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_TTL, struct.pack("b", 1))
            sender.setblocking(False)
            self._senders[address] = sender
        if self._senders:
            self.multicast = [Locator(UDPV4, port, locators.MULTICAST_GROUP)]

    def _adopt(self, sock: socket.socket) -> None:
        sock.setblocking(False)
        try:
            sock.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, _BUFFER)
        except OSError:
            pass  # the system's own size then
        self._sockets.append(sock)

    def filenos(self) -> list[int]:
        """Return the descriptors that are readable when datagrams have come."""
        return [sock.fileno() for sock in self._sockets]

    def receive(self) -> Iterator[tuple[memoryview, str]]:
        """Yield datagrams that have come, with the addresses of their senders.

        A datagram is valid until the next one. At most a burst is taken of each socket; the rest
        leaves its descriptor readable.
        """
        for sock in self._sockets:
            for _ in range(_MAX_BURST):
                try:
                    size, source = sock.recvfrom_into(self._buffer)
                except OSError:  # none, or an ICMP error of a datagram sent earlier
                    break
                yield self._view[:size], source[0]

    def send(self, datagram: bytes, place: Locator) -> None:
        """Send a datagram; it is lost where the system does not take it."""
        if place.is_multicast:
            for sender in self._senders.values():
                try:
                    sender.sendto(datagram, (place.address, place.port))
                except OSError:
                    pass  # an interface that is down
        elif self._sockets:
            try:
                self._main.sendto(datagram, (place.address, place.port))
            except OSError:
                pass

    def close(self) -> None:
        """Close the sockets; idempotent."""
        for sock in (*self._sockets, *self._senders.values()):
            sock.close()
        self._sockets.clear()
        self._senders.clear()


def _own_addresses() -> list[str]:
    """The addresses of this machine, loopback last and only where there is no other."""
    found = [address for address in ipv4_by_interface().values() if not address.startswith("127.")]
    if not found:  # other systems than Linux tell the one towards the network
        address = own_address((locators.MULTICAST_GROUP, locators.multicast_port(0)))
        found = [address] if address is not None else []
    return found or [LOOPBACK]


def _places(peer: str, domain: int) -> list[Locator]:
    """The places at which participants on a peer's machine may be."""
    try:
        found = socket.getaddrinfo(peer, None, socket.AF_INET, socket.SOCK_DGRAM)
    except OSError:
        return []
    address = str(found[0][4][0])
    return [
        Locator(UDPV4, locators.metatraffic_port(domain, index), address) for index in _PEER_INDICES
    ]
