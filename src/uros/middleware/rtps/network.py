"""What a domain uses of the network, as the environment says: versions of IP, interfaces, peers.

Nothing here opens a socket. ROS's discovery range comes first; ``CYCLONEDDS_URI`` chooses within it
(:mod:`uros.middleware.cyclonedds_uri`).
"""

from __future__ import annotations

import socket
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Final

from ...addresses import RUNNING, Interface, is_link_local
from .. import cyclonedds_uri
from ..cyclonedds_uri import CycloneSettings, InterfaceChoice
from ..environment import discovery_range
from . import locators
from .locators import UDPV4, UDPV6, Locator
from .outbox import MESSAGE_SIZE

# Peers are looked for at these participant indices at least, as Fast DDS does.
PROBED: Final = 32
LOOPBACK: Final = {UDPV4: "127.0.0.1", UDPV6: "::1"}
_LOOPBACK_NAMES: Final = ("lo", "lo0", "localhost", "::1")
# Octets of a datagram that CYCLONEDDS_URI may ask for: every host accepts the least (RFC 791), and
# the most is Cyclone's own default.
_LEAST_MESSAGE: Final = 576
_MOST_MESSAGE: Final = 14_720
# Attack and accident: a machine with hundreds of virtual interfaces, whose announcement would
# exceed a message. Others read no more either (parameters.MAX_LOCATORS).
_MAX_ADDRESSES: Final = 16
# Octets of an announcement: for an address, where discovery data and samples are received; and for
# the rest, with the multicast groups of both versions of IP.
_ADDRESS_OCTETS: Final = 2 * (4 + locators.SIZE)
_OTHER_OCTETS: Final = 240


@dataclass(frozen=True)
class NetworkSettings:
    """What a domain uses of the network.

    Attributes:
        is_off: Whether it uses no network at all.
        kinds: Its versions of IP: :data:`UDPV4`, :data:`UDPV6`.
        stays_local: Whether its sockets are bound to loopback, so that no datagram leaves or enters
            this machine.
        multicast: Whether it announces itself by multicast.
        choices: The interfaces that the user named; empty: all of them.
        automatic: The choice of those that nobody named; with it all are used.
        index: The participant index; None: the lowest free one; -1: none, but any free port.
        peers: Places to announce to besides multicast.
        message_size: The most octets of a datagram.
        notices: What the user should know about the configuration.
    """

    is_off: bool = False
    kinds: tuple[int, ...] = (UDPV4,)
    stays_local: bool = False
    multicast: bool = True
    choices: tuple[InterfaceChoice, ...] = ()
    automatic: InterfaceChoice | None = None
    index: int | None = None
    peers: tuple[Locator, ...] = ()
    message_size: int = MESSAGE_SIZE
    notices: tuple[str, ...] = field(default=(), compare=False)

    def usable(self, found: Iterable[Interface]) -> list[Interface]:
        """Return those of the interfaces that the domain uses.

        They have a carrier and an address. Loopback is used where there is no other: its address
        is that of another machine to each peer that is not on this one, and peers on this one reach
        any of our addresses. Fast DDS and Cyclone do the same.
        """
        here = [
            one
            for one in found
            if one.flags & RUNNING and any(addresses_of(one, kind) for kind in self.kinds)
        ]
        loopback = [one for one in here if one.is_loopback]
        if self.stays_local:
            return loopback
        if self.choices and self.automatic is None:
            return [one for one in here if self._choice(one) is not None]
        return [one for one in here if not one.is_loopback] or loopback

    def allows_multicast(self, interface: Interface) -> bool:
        """Return whether announcements go out of an interface.

        Linux does not list loopback among those with multicast, but it carries it.
        """
        choice = self._choice(interface)
        if choice is not None and choice.multicast is not None:
            return choice.multicast
        return interface.has_multicast or interface.is_loopback

    def _choice(self, interface: Interface) -> InterfaceChoice | None:
        known = (interface.name, interface.address, *interface.ipv6)
        return next((choice for choice in self.choices if choice.name in known), self.automatic)


def addresses_of(interface: Interface, kind: int) -> list[str]:
    """Return an interface's addresses of one version of IP, for announcements.

    A link-local address of IPv6 is among them only where there is no other.
    """
    if kind == UDPV4:
        return [interface.address] if interface.address else []
    wide = [address for address in interface.ipv6 if not is_link_local(address)]
    return wide or list(interface.ipv6)


def announced(
    interfaces: Iterable[Interface], kinds: Iterable[int], port: int, message_size: int
) -> list[Locator]:
    """Return the locators of interfaces at a port; loopback's where there is no address.

    They are so few that the announcement fits into a message of ``message_size`` octets.
    """
    found = list(interfaces)
    places = [
        Locator(kind, port, address)
        for kind in kinds
        for one in found
        for address in addresses_of(one, kind)
    ]
    most = min(_MAX_ADDRESSES, (message_size - _OTHER_OCTETS) // _ADDRESS_OCTETS)
    return places[:most] or [Locator(kind, port, LOOPBACK[kind]) for kind in kinds]


def read_settings(environment: Mapping[str, str], domain: int) -> NetworkSettings:
    """Read what a domain uses of the network. Peers that are names are looked up.

    Raises:
        MiddlewareError: The discovery range does not exist, or CYCLONEDDS_URI is wrong.
    """
    reach = discovery_range(environment)
    cyclone = cyclonedds_uri.read_settings(environment.get(cyclonedds_uri.NAME, ""), domain)
    if reach == "OFF":
        return NetworkSettings(is_off=True)
    notices = []
    if cyclone.unknown:
        notices.append(
            "of CYCLONEDDS_URI the rtps middleware uses interfaces, Peers, AllowMulticast,"
            " Transport, UseIPv6, MaxMessageSize, ParticipantIndex and MaxAutoParticipantIndex; it"
            f" leaves out {', '.join(cyclone.unknown)}"
        )
    named = [*_static_peers(environment, reach), *cyclone.peers]
    hosts = {peer: _resolve(peer) for peer in dict.fromkeys(named)}
    notices += [
        f"the peer {peer!r} has no address: correct it in ROS_STATIC_PEERS or CYCLONEDDS_URI, or"
        " give its address, and start again"
        for peer, found in hosts.items()
        if not found
    ]
    kinds = _kinds(cyclone, hosts.values())
    peers = [place for found in hosts.values() for place in found if place.kind in kinds]
    choices = tuple(choice for choice in cyclone.interfaces if choice.name)
    # Cyclone chooses one automatically; ours are all of them.
    automatic = next((choice for choice in cyclone.interfaces if not choice.name), None)
    if choices and automatic is None:
        stays_local = all(_is_loopback(choice.name) for choice in choices)
    else:
        stays_local = reach == "LOCALHOST" and all(_is_loopback(one.address) for one in peers)
    multicast = reach != "LOCALHOST" and cyclone.multicast is not False
    if cyclone.interfaces and all(choice.multicast is False for choice in cyclone.interfaces):
        multicast = False
    if not multicast or (stays_local and UDPV6 in kinds):
        peers = [Locator(kind, 0, LOOPBACK[kind]) for kind in kinds] + peers
    probed = range(max(PROBED, (cyclone.max_index or 0) + 1))
    places = dict.fromkeys(place for peer in peers for place in _ports(peer, domain, probed))
    return NetworkSettings(
        kinds=kinds, stays_local=stays_local, multicast=multicast, choices=choices,
        automatic=automatic, index=-1 if cyclone.index == "none" else _number(cyclone.index),
        peers=tuple(places), message_size=_message_size(cyclone.max_message),
        notices=tuple(notices),
    )  # fmt: skip


def stays_local(environment: Mapping[str, str], domain: int) -> bool:
    """Return whether no datagram of a domain can leave this machine."""
    settings = read_settings(environment, domain)
    return settings.is_off or settings.stays_local


def _message_size(configured: int | None) -> int:
    if configured is None:
        return MESSAGE_SIZE
    return min(max(configured, _LEAST_MESSAGE), _MOST_MESSAGE)


def _number(index: int | str | None) -> int | None:
    return index if isinstance(index, int) else None


def _static_peers(environment: Mapping[str, str], reach: str) -> list[str]:
    """The peers of ROS_STATIC_PEERS, where they count.

    SYSTEM_DEFAULT leaves peers to the configuration of DDS, and ROS_LOCALHOST_ONLY excludes them.
    """
    if reach == "SYSTEM_DEFAULT":
        return []
    if reach == "LOCALHOST" and not environment.get("ROS_AUTOMATIC_DISCOVERY_RANGE"):
        return []
    listed = environment.get("ROS_STATIC_PEERS", "").split(";")
    return [peer.strip() for peer in listed if peer.strip()]


def _kinds(cyclone: CycloneSettings, hosts: Iterable[list[Locator]]) -> tuple[int, ...]:
    """The versions of IP: IPv4, unless IPv6 is configured or a peer has nothing else."""
    if cyclone.ipv6 is not None:
        return (UDPV6,) if cyclone.ipv6 else (UDPV4,)
    chosen = any(":" in choice.name for choice in cyclone.interfaces)
    alone = any(found and all(one.kind == UDPV6 for one in found) for found in hosts)
    return (UDPV4, UDPV6) if chosen or alone else (UDPV4,)


def _is_loopback(name: str) -> bool:
    return name in _LOOPBACK_NAMES or name.startswith("127.")


def _resolve(peer: str) -> list[Locator]:
    """The addresses of a peer, with its port or port 0."""
    host, port = _split(peer)
    try:
        found = socket.getaddrinfo(host, None, socket.AF_UNSPEC, socket.SOCK_DGRAM)
    except (OSError, UnicodeError):
        return []
    places = []
    for family, _, _, _, sockaddr in found:
        if family == socket.AF_INET:
            places.append(Locator(UDPV4, port, str(sockaddr[0])))
        elif family == socket.AF_INET6:
            scope = int(sockaddr[3]) if len(sockaddr) > 3 else 0
            places.append(Locator(UDPV6, port, locators.scoped(str(sockaddr[0]), scope)))
    return list(dict.fromkeys(places))


def _split(peer: str) -> tuple[str, int]:
    """Host and port of a peer; port 0 without one. An IPv6 address with a port has brackets."""
    if peer.startswith("["):
        host, _, rest = peer[1:].partition("]")
        port = rest.removeprefix(":")
    elif peer.count(":") == 1:
        host, _, port = peer.partition(":")
    else:
        host, port = peer, ""
    usable = port.isascii() and port.isdecimal() and int(port) <= locators.MAX_PORT
    return host, int(port) if usable else 0


def _ports(peer: Locator, domain: int, indices: range) -> list[Locator]:
    """The places at which participants on a peer's machine may be."""
    if peer.port:
        return [peer]
    ports = [locators.metatraffic_port(domain, index) for index in indices]
    return [peer._replace(port=port) for port in ports if port <= locators.MAX_PORT]
