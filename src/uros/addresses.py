"""The addresses of this machine, from the kernel; nothing is sent to find them."""

from __future__ import annotations

import socket
import struct
import sys
from dataclasses import dataclass
from typing import Final

# Linux: the ioctls for an interface's flags and IPv4 address; lengths of struct ifreq and of a name
# in it.
_SIOCGIFFLAGS: Final = 0x8913
_SIOCGIFADDR: Final = 0x8915
_IFREQ: Final = 256
_NAME: Final = 15
# Flags of an IPv6 address that must not be given out: tentative, deprecated, duplicate; and of a
# temporary one.
_UNFIT: Final = 0x40 | 0x20 | 0x08
_TEMPORARY: Final = 0x01
_IF_INET6: Final = "/proc/net/if_inet6"
# From the block for documentation (RFC 3849): a route to it is one to the Internet.
_FAR_AWAY: Final = ("2001:db8::1", 9)

# Linux: the groups of rtnetlink for links and for addresses of IPv4 and IPv6.
_CHANGES: Final = 0x1 | 0x10 | 0x100

# Flags of an interface.
UP: Final = 0x1
LOOPBACK: Final = 0x8
POINT_TO_POINT: Final = 0x10
RUNNING: Final = 0x40
MULTICAST: Final = 0x1000


@dataclass(frozen=True)
class Interface:
    """A network interface that is up.

    Attributes:
        name: Its name.
        index: The kernel's number of it.
        flags: :data:`UP`, :data:`RUNNING` (it has a carrier) and others of the kernel.
        address: Its first IPv4 address, or empty.
        ipv6: Its IPv6 addresses that other machines can use.
    """

    name: str
    index: int
    flags: int
    address: str
    ipv6: tuple[str, ...] = ()

    @property
    def is_loopback(self) -> bool:
        """Whether it is the loopback interface."""
        return bool(self.flags & LOOPBACK)

    @property
    def has_multicast(self) -> bool:
        """Whether multicast is enabled."""
        return bool(self.flags & MULTICAST)


def interfaces() -> list[Interface]:
    """Return the interfaces that are up, by index; on other systems than Linux none."""
    if sys.platform != "linux":
        return []
    import fcntl

    ipv6: dict[str, tuple[str, ...]] = {}
    for name, flags, address in _ipv6_addresses():
        if not flags & _UNFIT:
            ipv6[name] = (*ipv6.get(name, ()), address)
    found = []
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sock:
        for index, name in socket.if_nameindex():
            request = struct.pack(f"{_IFREQ}s", name.encode()[:_NAME])
            try:
                answer = fcntl.ioctl(sock.fileno(), _SIOCGIFFLAGS, request)
            except OSError:
                continue  # it was removed
            (flags,) = struct.unpack_from("=H", answer, 16)
            try:
                answer = fcntl.ioctl(sock.fileno(), _SIOCGIFADDR, request)
                address = socket.inet_ntoa(answer[20:24])
            except OSError:
                address = ""
            if flags & UP:
                found.append(Interface(name, index, flags, address, ipv6.get(name, ())))
    return found


def change_socket() -> socket.socket | None:
    """Return a socket that receives something when interfaces or addresses have changed.

    It does not block; what it receives does not matter. None where the system has no such socket:
    on systems other than Linux, and for programs on Android.
    """
    if sys.platform != "linux":
        return None
    sock = None
    try:
        sock = socket.socket(socket.AF_NETLINK, socket.SOCK_RAW, socket.NETLINK_ROUTE)
        sock.bind((0, _CHANGES))
    except OSError:
        if sock is not None:
            sock.close()
        return None
    sock.setblocking(False)
    return sock


def ipv4_by_interface() -> dict[str, str]:
    """Return the first IPv4 address of each interface; empty on systems other than Linux."""
    if sys.platform != "linux":
        return {}
    import fcntl

    by_interface = {}
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sock:
        for _, name in socket.if_nameindex():
            request = struct.pack(f"{_IFREQ}s", name.encode()[:_NAME])
            try:
                answer = fcntl.ioctl(sock.fileno(), _SIOCGIFADDR, request)
            except OSError:  # it has none, or was removed
                continue
            by_interface[name] = socket.inet_ntoa(answer[20:24])
    return by_interface


def ipv6_of(interface: str | None) -> str | None:
    """Return an IPv6 address of an interface that can be given to other machines, if it has one.

    Not a link-local one: it needs the name of the other machine's interface. ``None`` is the
    interface towards the Internet.
    """
    best, best_rank = None, 2
    for name, flags, address in _ipv6_addresses() if interface is not None else []:
        rank = flags & _TEMPORARY
        if name == interface and not flags & _UNFIT and rank < best_rank:
            if not is_link_local(address):
                best, best_rank = address, rank
    return best if interface is not None else own_address(_FAR_AWAY)


def _ipv6_addresses() -> list[tuple[str, int, str]]:
    """Return ``(interface, flags, address)`` of each, on Linux."""
    try:
        with open(_IF_INET6, encoding="ascii") as file:
            lines = [line.split() for line in file]
    except OSError:
        return []
    return [
        (line[5], int(line[4], 16), socket.inet_ntop(socket.AF_INET6, bytes.fromhex(line[0])))
        for line in lines
    ]


def is_link_local(address: str) -> bool:
    """Return whether a numeric address is a link-local one of IPv6."""
    return address[:3] in ("fe8", "fe9", "fea", "feb")


def own_address(peer: tuple[str, int]) -> str | None:
    """Return the address that this machine has towards a peer; None without a route."""
    family = socket.AF_INET6 if ":" in peer[0] else socket.AF_INET
    try:
        with socket.socket(family, socket.SOCK_DGRAM) as sock:
            sock.connect(peer)
            address: str = sock.getsockname()[0]
    except OSError:
        return None
    return address
