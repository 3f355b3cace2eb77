"""The addresses of this machine, as the kernel knows them. Nothing is sent to find them."""

from __future__ import annotations

import socket
import struct
import sys
from typing import Final

# The kernel's: ask for an interface's IPv4 address; lengths of struct ifreq and of a name in it.
_SIOCGIFADDR: Final = 0x8915
_IFREQ: Final = 256
_NAME: Final = 15
# Flags of an IPv6 address that is not to be given out: tentative, deprecated, a duplicate; and
# of one that will be another soon.
_UNFIT: Final = 0x40 | 0x20 | 0x08
_TEMPORARY: Final = 0x01
_IF_INET6: Final = "/proc/net/if_inet6"
# From the block for documentation: nobody has it, and a way to it is one to the Internet.
_FAR_AWAY: Final = ("2001:db8::1", 9)


def ipv4_by_interface() -> dict[str, str]:
    """The first IPv4 address of each interface that has one; empty where only Linux could say."""
    if sys.platform != "linux":
        return {}
    import fcntl

    found = {}
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sock:
        for _, name in socket.if_nameindex():
            request = struct.pack(f"{_IFREQ}s", name.encode()[:_NAME])
            try:
                answer = fcntl.ioctl(sock.fileno(), _SIOCGIFADDR, request)
            except OSError:  # it has none, or is gone again
                continue
            found[name] = socket.inet_ntoa(answer[20:24])
    return found


def ipv6_of(interface: str | None) -> str | None:
    """An IPv6 address of an interface that others can be told, if it has one.

    Not a link-local one: it means nothing without the name that the interface has with the other.
    ``None`` is the interface towards the Internet.
    """
    best, best_rank = None, 2
    for name, flags, address in _ipv6_addresses() if interface is not None else []:
        rank = flags & _TEMPORARY
        if name == interface and not flags & _UNFIT and rank < best_rank:
            if not is_link_local(address):
                best, best_rank = address, rank
    return best if interface is not None else own_address(_FAR_AWAY)


def _ipv6_addresses() -> list[tuple[str, int, str]]:
    """(interface, flags, address) of each, as far as this system says."""
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
    """Whether an address in numbers is good on one link only, and on IPv6."""
    return address[:3] in ("fe8", "fe9", "fea", "feb")


def own_address(peer: tuple[str, int]) -> str | None:
    """The address that this machine has towards a peer; None: there is no way there."""
    family = socket.AF_INET6 if ":" in peer[0] else socket.AF_INET
    try:
        with socket.socket(family, socket.SOCK_DGRAM) as sock:
            sock.connect(peer)
            address: str = sock.getsockname()[0]
    except OSError:
        return None
    return address
