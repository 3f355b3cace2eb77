"""The sockets of one domain for one version of IP: for samples, for discovery, for multicast.

Samples have a port of their own: they must neither wait behind the announcements of a crowd of
participants, nor get lost because those have filled a buffer.

The unicast socket of discovery sends everything. It sends announcements out of each interface in
turn, so that they reach the network of each. Once its buffer is full, as a slow link does not take
what is sent to one host, each host that is sent to meanwhile gets a socket with a buffer of its
own, on the same port: the others must not wait for the slow one.
"""

from __future__ import annotations

import errno
import socket
import struct
import sys
from typing import Final

from ...addresses import Interface
from ..base import MiddlewareError
from . import locators
from .locators import UDPV4, Locator
from .network import LOOPBACK

# A burst of fragments is received as a whole where the system allows that much; Linux gives the
# most that net.core.rmem_max allows.
_RECEIVE_BUFFER: Final = 4 * 1024 * 1024
_SEND_BUFFER: Final = 1024 * 1024
# Hosts with a buffer of their own; the first one of them makes room for one more.
_MAX_OWN: Final = 64
# Attack: participants that announce ever new places.
_MAX_HOSTS: Final = 4096
# The port of the discard service: nobody sends from it.
_DISCARD: Final = 9
# Announcements stay on the link, as those of Fast DDS do.
_HOPS: Final = 1
# Linux: receive from groups that this socket has joined, not from all that anybody has.
_IP_MULTICAST_ALL: Final = 49
_IPV6_MULTICAST_ALL: Final = 29

_Address = tuple[str, int] | tuple[str, int, int, int]


class IpSockets:
    """The sockets of one version of IP.

    Attributes:
        kind: :data:`UDPV4` or :data:`UDPV6`.
        port: The unicast port for discovery.
        data_port: That for samples.
        joined: Interfaces on which announcements are received and sent, by index.

    Args:
        kind: The version.
        port: The unicast port for discovery; 0: any free one.
        data_port: That for samples; 0: any free one.
        stays_local: Whether the sockets are bound to loopback.

    Raises:
        OSError: A port is in use, or this version of IP is not there.
    """

    def __init__(self, kind: int, port: int, data_port: int, stays_local: bool) -> None:
        self.kind = kind
        self.joined: dict[int, Interface] = {}
        self._groups: tuple[str, ...] = locators.MULTICAST_GROUPS[kind]
        self._multicast: socket.socket | None = None
        self._bound_to = LOOPBACK[kind] if stays_local else ""
        self._own: dict[str, socket.socket] = {}  # sockets that send to one address alone
        self._hosts: dict[Locator, _Address] = {}  # places of no group, for each datagram
        self._unicast = self._socket()
        self._data = self._socket()
        try:
            # Without SO_REUSEADDR: a port of another participant must not be shared.
            for sock, number in ((self._unicast, port), (self._data, data_port)):
                sock.bind((self._bound_to, number))
        except OSError:
            self.close()
            raise
        self.port = int(self._unicast.getsockname()[1])
        self.data_port = int(self._data.getsockname()[1])
        _enlarge(self._unicast, socket.SO_SNDBUF, _SEND_BUFFER)
        if kind == UDPV4:
            self._unicast.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_LOOP, 1)
            self._unicast.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_TTL, _HOPS)
        else:
            self._unicast.setsockopt(socket.IPPROTO_IPV6, socket.IPV6_MULTICAST_LOOP, 1)
            self._unicast.setsockopt(socket.IPPROTO_IPV6, socket.IPV6_MULTICAST_HOPS, _HOPS)

    def _socket(self) -> socket.socket:
        family = socket.AF_INET if self.kind == UDPV4 else socket.AF_INET6
        sock = socket.socket(family, socket.SOCK_DGRAM)
        sock.setblocking(False)
        _enlarge(sock, socket.SO_RCVBUF, _RECEIVE_BUFFER)
        if self.kind != UDPV4:
            sock.setsockopt(socket.IPPROTO_IPV6, socket.IPV6_V6ONLY, 1)
        return sock

    def open_multicast(self, port: int) -> None:
        """Open the socket on which all participants of this machine receive announcements.

        Raises:
            MiddlewareError: The port cannot be shared.
        """
        sock = self._socket()
        sock.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        if hasattr(socket, "SO_REUSEPORT"):
            _set(sock, socket.SOL_SOCKET, socket.SO_REUSEPORT, 1)
        if sys.platform == "linux":
            if self.kind == UDPV4:
                _set(sock, socket.IPPROTO_IP, _IP_MULTICAST_ALL, 0)
            else:
                _set(sock, socket.IPPROTO_IPV6, _IPV6_MULTICAST_ALL, 0)
        try:
            sock.bind(("", port))
        except OSError as error:
            sock.close()
            raise MiddlewareError(
                f"UDP port {port}, for discovery by multicast, is in use by a program that does not"
                f" share it ({error}): end that program, or use another domain"
            ) from error
        self._multicast = sock

    @property
    def sockets(self) -> list[socket.socket]:
        """The sockets that receive, those of discovery first."""
        discovery = [] if self._multicast is None else [self._multicast]
        return [self._unicast, *discovery, self._data]

    @property
    def groups(self) -> list[Locator]:
        """The places of announcements by multicast; none where no interface carries them."""
        if self._multicast is None or not self.joined:
            return []
        port = int(self._multicast.getsockname()[1])
        return [Locator(self.kind, port, group) for group in self._groups]

    def join(self, interfaces: list[Interface]) -> None:
        """Receive announcements on these interfaces, and no longer on others.

        One that cannot be joined is left out; the next call tries again.
        """
        if self._multicast is None:
            return
        wanted = {one.index: one for one in interfaces if self._carries_groups(one)}
        for index in self.joined.keys() - wanted.keys():
            self._member(self.joined.pop(index), False)
        for index, interface in wanted.items():
            if index in self.joined or self._member(interface, True):
                self.joined[index] = interface

    def _carries_groups(self, interface: Interface) -> bool:
        """Whether an interface has this version of IP; Linux's loopback has no groups of IPv6."""
        if self.kind == UDPV4:
            return bool(interface.address)
        return bool(interface.ipv6) and not interface.is_loopback

    def _member(self, interface: Interface, joins: bool) -> bool:
        """Join or leave the groups on an interface; return whether that was possible."""
        assert self._multicast is not None
        done = False
        for group in self._groups:
            if self.kind == UDPV4:
                level = socket.IPPROTO_IP
                option = socket.IP_ADD_MEMBERSHIP if joins else socket.IP_DROP_MEMBERSHIP
                value = socket.inet_aton(group) + _interface_ipv4(interface)
            else:
                level = socket.IPPROTO_IPV6
                option = socket.IPV6_JOIN_GROUP if joins else socket.IPV6_LEAVE_GROUP
                packed = socket.inet_pton(socket.AF_INET6, group)
                value = packed + struct.pack("@I", interface.index)
            done |= _set(self._multicast, level, option, value)
        return done

    def send(self, datagram: bytes, place: Locator) -> None:
        """Send a datagram; to a group out of each interface that has joined it.

        Raises:
            BlockingIOError: There is no room now.
            OSError: It cannot be sent; others than the last interface may have taken it.
        """
        to = self._hosts.get(place)
        if to is None:
            if place.is_multicast:
                self._send_to_group(datagram, place)
                return
            if len(self._hosts) >= _MAX_HOSTS:
                self._hosts.clear()
            to = self._hosts[place] = _sockaddr(place, place.port)
        if self._own and (own := self._own.get(place.address)) is not None:
            try:
                own.sendto(datagram, to)
                return
            except BlockingIOError:
                raise
            except OSError:  # our address towards that one is no longer ours
                self._own.pop(place.address).close()
        try:
            self._unicast.sendto(datagram, to)
        except BlockingIOError:
            self._open_own(place).sendto(datagram, to)

    def _send_to_group(self, datagram: bytes, place: Locator) -> None:
        to = _sockaddr(place, place.port)
        fault: OSError | None = None
        for interface in self.joined.values():
            try:
                if self.kind == UDPV4:
                    value = _interface_ipv4(interface)
                    if len(value) > 4:
                        value = bytes(4) + value
                    self._unicast.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_IF, value)
                else:
                    self._unicast.setsockopt(
                        socket.IPPROTO_IPV6, socket.IPV6_MULTICAST_IF, interface.index
                    )
                self._unicast.sendto(datagram, to)
            except OSError as error:
                fault = error
        if fault is not None:
            raise fault

    def _open_own(self, place: Locator) -> socket.socket:
        """Open a socket that sends to one address, from the same port as all others.

        Firewalls and translations of addresses know that port. It is connected, and so receives
        nothing but what that address sends from the discard port.

        Raises:
            BlockingIOError: There is none; the caller waits for room in the common buffer.
        """
        try:
            sock = self._socket()
        except OSError as error:
            raise BlockingIOError(error.errno, error.strerror) from error
        try:
            _enlarge(sock, socket.SO_SNDBUF, _SEND_BUFFER)
            # The port may be shared at this moment alone: all others must have the option for that.
            for each in (self._unicast, sock):
                each.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            sock.bind((self._bound_to, self.port))
            sock.connect(_sockaddr(place, _DISCARD))
        except OSError as error:
            sock.close()
            raise BlockingIOError(error.errno, error.strerror) from error
        finally:
            self._unicast.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 0)
        if len(self._own) >= _MAX_OWN:
            self._own.pop(next(iter(self._own))).close()
        self._own[place.address] = sock
        return sock

    def close(self) -> None:
        """Close the sockets; idempotent."""
        for sock in (*self.sockets, *self._own.values()):
            sock.close()
        self._own.clear()


def _sockaddr(place: Locator, port: int) -> _Address:
    """The address of a place in the form of its version of IP, with a port."""
    return (place.address, port) if place.kind == UDPV4 else (place.host, port, 0, place.scope)


def _interface_ipv4(interface: Interface) -> bytes:
    """An interface in an option of IPv4: by address and index, or by address alone.

    The index is that of ``struct ip_mreqn``, which only Linux is known to have here.
    """
    address = socket.inet_aton(interface.address)
    return address + struct.pack("=i", interface.index) if sys.platform == "linux" else address


def _set(sock: socket.socket, level: int, option: int, value: int | bytes) -> bool:
    """Set an option; return whether it is set."""
    try:
        sock.setsockopt(level, option, value)
    except OSError as error:
        return error.errno == errno.EADDRINUSE  # a member already
    return True


def _enlarge(sock: socket.socket, option: int, octets: int) -> None:
    """Ask for a larger buffer; the system's own size stays where it does not allow that."""
    if sock.getsockopt(socket.SOL_SOCKET, option) < octets:
        _set(sock, socket.SOL_SOCKET, option, octets)
