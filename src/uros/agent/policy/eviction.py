"""Whose turn it is to leave where there are no places left: a share for each address.

A session costs its maker one datagram, and one socket can make as many as there are places. So
clients are counted by where they come from: the *network* (an IPv4 address, 64 bits of an IPv6
address, or one line: a serial device, a CAN bus) and the *socket* there (an address and port, a
connection, a board's number on the line). When a newcomer finds no place, room is made for it:

1. by one socket that has many sessions more than the newcomer's socket: its cheapest and youngest
   go, whether they talk or not, since a board has one session;
2. by one network that has many more than the newcomer's: of those that are silent, the cheapest and
   youngest go;
3. by those that have made nothing, wherever they are, the longest silent first.

Nobody else goes: a board that works does not leave for a newcomer. So at the usual limit one
network cannot have all places, however lively its sessions are.
"""

from __future__ import annotations

from collections.abc import Hashable, Iterable
from ipaddress import IPv6Address
from typing import Any, Final

from ...ticks import ticks_add, ticks_diff
from ..context import ClientState
from ..transports.base import ServerTransport

# Fewer sessions than this of one socket or network are no attack, whatever the limit is.
LEAST: Final = 16
# A client that made something is silent, for this purpose, after so long: boards say something
# while they set up.
SILENT_MS: Final = 3000
# So many places leave at a time, as a part of all: a flood must not make us search each time.
_PART: Final = 16
# Attack: lively sessions of one network. A part of all places is for others, where there are so
# many places that the limit is there for attacks and not for the owner's boards.
_RESERVED: Final = 16
_MANY_PLACES: Final = 1024
# Attack: newcomers in vain, each of which has all clients looked at. How long that is not repeated.
_PAUSE_MS: Final = 100


def network_of(transport: ServerTransport, peer: Any) -> Hashable:
    """Those who share this share the places that one machine may have."""
    host = transport.host_of(peer)
    if host is None:
        return transport
    host = host.partition("%")[0]
    if ":" not in host:
        return host
    address = IPv6Address(host)
    return str(address.ipv4_mapped) if address.ipv4_mapped else int(address) >> 64


class EvictionPolicy:
    """See the module. Where each client is, and who goes for a newcomer."""

    def __init__(self) -> None:
        self._networks: dict[Hashable, dict[Hashable, dict[ClientState, None]]] = {}
        self._counts: dict[Hashable, int] = {}  # clients of each network
        # Until when nobody is silent or bare, as was just seen; and the same within one network.
        self._in_vain: dict[bool, int] = {}

    def add(self, client: ClientState, transport: ServerTransport, peer: Any) -> None:
        """The client is there from now on."""
        network = network_of(transport, peer)
        sockets = self._networks.setdefault(network, {})
        sockets.setdefault((transport, peer), {})[client] = None
        self._counts[network] = self._counts.get(network, 0) + 1

    def remove(self, client: ClientState, transport: ServerTransport, peer: Any) -> None:
        """It is there no more."""
        network = network_of(transport, peer)
        sockets = self._networks[network]
        clients = sockets[transport, peer]
        del clients[client]
        if not clients:
            del sockets[transport, peer]
        self._counts[network] -= 1
        if not sockets:
            del self._networks[network], self._counts[network]

    def is_over(self, transport: ServerTransport, peer: Any, most: int) -> bool:
        """Whether the newcomer's network has all of the ``most`` places that one may have."""
        if most < _MANY_PLACES:
            return False
        return self._counts.get(network_of(transport, peer), 0) >= most - most // _RESERVED

    def leaving(
        self, transport: ServerTransport, peer: Any, most: int, now: int
    ) -> tuple[list[ClientState], str]:
        """Who goes for a newcomer from there, and why; nobody: it must wait."""
        network, part = network_of(transport, peer), max(1, most // _PART)
        over = self.is_over(transport, peer, most)
        if over:  # its own network makes the room; others keep what is reserved for them
            largest = network
        else:
            largest = max(self._counts, key=self._counts.__getitem__)
        inside = self._networks[largest]
        own = self._networks.get(network, {}).get((transport, peer), {})
        greedy = max(inside.values(), key=len)
        spare = len(greedy) - len(own) - 1
        if len(greedy) >= LEAST and spare > 0:
            return _cheapest(greedy, min(part, spare)), "one socket has most of the sessions"
        until = self._in_vain.get(over)
        if until is not None and 0 < ticks_diff(until, now) <= _PAUSE_MS:
            return [], ""
        found = self._silent(largest, network, part, most, now)
        why = "one address has most of the sessions, and they are silent"
        if not found:
            found = self._bare([inside] if over else self._networks.values(), now)[:part]
            why = "they have made nothing"
        if not found:
            self._in_vain[over] = ticks_add(now, _PAUSE_MS)
        return found, why

    def _silent(
        self, largest: Hashable, network: Hashable, part: int, most: int, now: int
    ) -> list[ClientState]:
        """Those of the largest network that go for a newcomer from ``network``."""
        count = self._counts[largest]
        spare = count - self._counts.get(network, 0) - 1
        if largest == network:  # equals: only where the limit is not one of the owner's boards
            spare = part if most >= _MANY_PLACES else 0
        if count < LEAST or spare <= 0:
            return []
        return _cheapest(
            (
                client
                for clients in self._networks[largest].values()
                for client in clients
                if ticks_diff(now, client.session.heard) >= SILENT_MS
            ),
            min(part, spare),
        )

    @staticmethod
    def _bare(
        networks: Iterable[dict[Hashable, dict[ClientState, None]]], now: int
    ) -> list[ClientState]:
        """Those that have made nothing, the longest silent first."""
        bare = [
            client
            for sockets in networks
            for clients in sockets.values()
            for client in clients
            if not client.objects
        ]
        return sorted(bare, key=lambda client: ticks_diff(client.session.heard, now))


def _cheapest(clients: Iterable[ClientState], count: int) -> list[ClientState]:
    """Those that have made the least, of them the youngest."""
    return sorted(clients, key=lambda it: (len(it.objects), -it.born))[:count]
