"""Eviction: which clients are deleted for a new one when the limit of clients is reached.

The limit (``--max-clients``) is the number of *places*. A session costs its creator one datagram,
so one socket could take all places. Therefore clients are counted by origin: the *network* (an IPv4
address, 64 bits of an IPv6 address, or one line: a serial device, a CAN bus) and the *socket* there
(an address and port, a connection, a board's number on the line). When no place is free for a new
client, clients are evicted from

1. one socket that has many sessions more than the new client's socket: those with the fewest
   objects and the youngest, active or not, since a board has one session;
2. one network that has many more than the new client's: of the silent ones, those with the fewest
   objects and the youngest;
3. all clients without objects, wherever they are, the longest silent first.

No others are evicted: a board in use never gives way to a new client. So at the usual limit one
network cannot take all places, however active its sessions are.
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
# A client with objects counts as silent after so long: boards send messages while they set up.
SILENT_MS: Final = 3000
# One place in so many is freed at a time, so that not every client of a flood causes a search.
_PART: Final = 16
# One place in so many is not available to one network, even if all its sessions are active. This
# holds from _MANY_PLACES on: so high a limit protects from attacks and does not count the owner's
# boards.
_RESERVED: Final = 16
_MANY_PLACES: Final = 1024
# How long a search without result is not repeated, in milliseconds, because it searches all clients
# and a flood of new clients would cause one after the other.
_PAUSE_MS: Final = 100


def network_of(transport: ServerTransport, peer: Any) -> Hashable:
    """Return the origin of a peer: an address or subnet, or its transport."""
    host = transport.host_of(peer)
    if host is None:
        return transport
    host = host.partition("%")[0]
    if ":" not in host:
        return host
    address = IPv6Address(host)
    return str(address.ipv4_mapped) if address.ipv4_mapped else int(address) >> 64


class EvictionPolicy:
    """Counts clients by origin and selects those to evict for a new one."""

    def __init__(self) -> None:
        self._networks: dict[Hashable, dict[Hashable, dict[ClientState, None]]] = {}
        self._counts: dict[Hashable, int] = {}  # clients of each network
        # Until when no search is repeated; by whether it was within one network.
        self._in_vain: dict[bool, int] = {}

    def add(self, client: ClientState, transport: ServerTransport, peer: Any) -> None:
        """Add a client."""
        network = network_of(transport, peer)
        sockets = self._networks.setdefault(network, {})
        sockets.setdefault((transport, peer), {})[client] = None
        self._counts[network] = self._counts.get(network, 0) + 1

    def remove(self, client: ClientState, transport: ServerTransport, peer: Any) -> None:
        """Remove a client."""
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
        """Return whether the peer's network has all that it may have of ``most`` places."""
        if most < _MANY_PLACES:
            return False
        return self._counts.get(network_of(transport, peer), 0) >= most - most // _RESERVED

    def select(
        self, transport: ServerTransport, peer: Any, most: int, now: int
    ) -> tuple[list[ClientState], str]:
        """Select clients to evict for a new one at ``peer``.

        Returns:
            The clients, none if the new one must wait; and the reason for the log.
        """
        network, part = network_of(transport, peer), max(1, most // _PART)
        over = self.is_over(transport, peer, most)
        if over:  # its own network gives way; the reserved places stay for others
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
        candidates = self._silent(largest, network, part, most, now)
        why = "one address has most of the sessions, and they are silent"
        if not candidates:
            candidates = self._without_objects([inside] if over else self._networks.values(), now)[
                :part
            ]
            why = "they have no objects"
        if not candidates:
            self._in_vain[over] = ticks_add(now, _PAUSE_MS)
        return candidates, why

    def _silent(
        self, largest: Hashable, network: Hashable, part: int, most: int, now: int
    ) -> list[ClientState]:
        """Select silent clients of the largest network, for a new one of ``network``."""
        count = self._counts[largest]
        spare = count - self._counts.get(network, 0) - 1
        if largest == network:  # it may evict its own clients only from _MANY_PLACES on
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
    def _without_objects(
        networks: Iterable[dict[Hashable, dict[ClientState, None]]], now: int
    ) -> list[ClientState]:
        """Return the clients without objects, the longest silent first."""
        candidates = [
            client
            for sockets in networks
            for clients in sockets.values()
            for client in clients
            if not client.objects
        ]
        return sorted(candidates, key=lambda client: ticks_diff(client.session.heard, now))


def _cheapest(clients: Iterable[ClientState], count: int) -> list[ClientState]:
    """Return the clients with the fewest objects, of them the youngest."""
    return sorted(clients, key=lambda client: (len(client.objects), -client.born))[:count]
