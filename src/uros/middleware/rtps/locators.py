"""Locators (RTPS 9.3.2): transport addresses, and the ports of domains and participants (9.6.2)."""

from __future__ import annotations

import socket
import struct
from typing import Final, NamedTuple

from ...addresses import is_link_local

UDPV4: Final = 1
UDPV6: Final = 2
SIZE: Final = 24
# The group of announcements (9.6.2.4.1). For IPv6 the specification has none: that of Fast DDS, and
# that of Cyclone, which stays on the link.
MULTICAST_GROUPS: Final = {
    UDPV4: ("239.255.0.1",),
    UDPV6: ("ff1e::ffff:efff:1", "ff02::ffff:efff:1"),
}

# The well-known ports: 7400 + 250 for each domain + 2 for each participant + an offset.
_BASE: Final = 7400
_PER_DOMAIN: Final = 250
_PER_PARTICIPANT: Final = 2
_METATRAFFIC_MULTICAST: Final = 0
_METATRAFFIC_UNICAST: Final = 10
_USER_UNICAST: Final = 11
MAX_PORT: Final = 0xFFFF
_IPV4_MAPPED: Final = bytes(10) + b"\xff\xff"


class Locator(NamedTuple):
    """A UDP address.

    Attributes:
        kind: :data:`UDPV4` or :data:`UDPV6`.
        port: The UDP port, 1 to 65535.
        address: The numeric IP address; a link-local one of IPv6 that datagrams came from has the
            number of its interface behind a ``%``, as the same address on another link is another
            host's.
    """

    kind: int
    port: int
    address: str

    @property
    def is_multicast(self) -> bool:
        """Whether the address is one of a multicast group."""
        if self.kind == UDPV4:
            return 224 <= int(self.address.partition(".")[0]) < 240
        first = self.address.partition(":")[0]
        return len(first) == 4 and first.lower().startswith("ff")

    @property
    def host(self) -> str:
        """The address without an interface."""
        return self.address.partition("%")[0]

    @property
    def scope(self) -> int:
        """The number of the interface behind the address; 0 without one."""
        return int(self.address.partition("%")[2] or 0)


def scoped(address: str, scope: int) -> str:
    """Return an IPv6 address with the number of its interface, if it is a link-local one.

    Args:
        address: The numeric address; what it has behind a ``%`` is replaced.
        scope: The number of the interface, 0 for none.
    """
    host = address.partition("%")[0]
    return f"{host}%{scope}" if scope and is_link_local(host) else host


def decode(raw: bytes, little: bool) -> Locator | None:
    """Read a locator of 24 octets.

    Returns:
        None for one of another transport, such as shared memory, and for an address that datagrams
        cannot be sent to: port 0, the unspecified address, broadcast, or IPv4 within IPv6.
    """
    kind, port = struct.unpack_from("<iI" if little else ">iI", raw)
    if not 0 < port <= MAX_PORT:
        return None
    if kind == UDPV4:
        packed = raw[20:24]
        if packed in (bytes(4), b"\xff\xff\xff\xff"):
            return None
        return Locator(kind, port, socket.inet_ntop(socket.AF_INET, packed))
    if kind == UDPV6:
        if raw[8:24] == bytes(16) or raw[8:20] == _IPV4_MAPPED:
            return None
        return Locator(kind, port, socket.inet_ntop(socket.AF_INET6, raw[8:24]))
    return None


def encode(locator: Locator) -> bytes:
    """Return a locator as 24 octets, little endian."""
    family = socket.AF_INET if locator.kind == UDPV4 else socket.AF_INET6
    packed = socket.inet_pton(family, locator.host)
    return struct.pack("<iI", locator.kind, locator.port) + packed.rjust(16, b"\0")


def multicast_port(domain: int) -> int:
    """Return the port on which all participants of a domain receive announcements."""
    return _BASE + _PER_DOMAIN * domain + _METATRAFFIC_MULTICAST


def metatraffic_port(domain: int, index: int) -> int:
    """Return the unicast port of a participant for discovery."""
    return _BASE + _PER_DOMAIN * domain + _METATRAFFIC_UNICAST + _PER_PARTICIPANT * index


def data_port(port: int) -> int:
    """Return the port of a participant for samples, by that for discovery; 0 for 0."""
    return port + _USER_UNICAST - _METATRAFFIC_UNICAST if port else 0
