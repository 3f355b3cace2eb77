"""Sockets and addresses of IPv4 and IPv6, for UDP and TCP at the agent's end."""

from __future__ import annotations

import errno
import socket
from typing import Any

from .base import WARNING, Host, TransportError

# As sockets give them: (host, port), for IPv6 also flow label and scope.
Address = tuple[Any, ...]

_NO_IPV6 = (
    "IPv6 is not available on this machine: turn it on"
    " (sysctl net.ipv6.conf.all.disable_ipv6=0 net.ipv6.conf.lo.disable_ipv6=0;"
    " in a container, by the options of its network), or listen on IPv4"
)


def family_of(host: str) -> socket.AddressFamily:
    """Return the family of an address: IPv6 if it has a colon."""
    return socket.AF_INET6 if ":" in host else socket.AF_INET


def listening_socket(protocol: str, host: str, port: int) -> socket.socket:
    """Return a socket of ``protocol`` ("UDP" or "TCP"), bound and non-blocking.

    A socket on IPv6 does not receive IPv4, so that a port may have one of each.
    Raises TransportError.
    """
    family, sock = family_of(host), None
    kind = socket.SOCK_DGRAM if protocol == "UDP" else socket.SOCK_STREAM
    try:
        sock = socket.socket(family, kind)
        sock.setblocking(False)
        if family == socket.AF_INET6:
            sock.setsockopt(socket.IPPROTO_IPV6, socket.IPV6_V6ONLY, 1)
        if protocol == "TCP":
            sock.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        sock.bind((host, port))
    except OSError as error:
        if sock is not None:
            sock.close()
        if error.errno == errno.EADDRNOTAVAIL:
            reason = address_trouble(protocol, host, port)
        elif error.errno in (errno.EAFNOSUPPORT, errno.EPROTONOSUPPORT):
            reason = f"{protocol} port {port} cannot be opened: {_NO_IPV6}"
        else:
            reason = bind_trouble(protocol, port, error)
        raise TransportError(error.errno, reason) from error
    return sock


def bind_trouble(protocol: str, port: int, error: OSError, option: str = "--port") -> str:
    """Explain why a port cannot be bound, with the remedy."""
    if error.errno == errno.EADDRINUSE:
        return (
            f"{protocol} port {port} is in use, perhaps by another agent:"
            f" stop it, or choose another port with {option}"
        )
    if error.errno == errno.EACCES:
        return f"{protocol} port {port} is not permitted: choose one from 1024 on with {option}"
    return f"{protocol} port {port} cannot be opened: {error.strerror}"


def address_trouble(protocol: str, host: str, port: int) -> str:
    """Explain why an address that this machine does not have cannot be used."""
    if family_of(host) == socket.AF_INET6 and not ipv6_works():
        return f"{protocol} port {port} cannot be opened: {_NO_IPV6}"
    everything = "::" if family_of(host) == socket.AF_INET6 else "0.0.0.0"
    return (
        f"{protocol} port {port} cannot be opened: this machine has no address {host}:"
        f" choose one that it has, or {everything} for all"
    )


def ipv6_works() -> bool:
    """Return whether this machine can reach itself over IPv6; nothing is sent."""
    try:
        with socket.socket(socket.AF_INET6, socket.SOCK_DGRAM) as sock:
            sock.connect(("::1", 9))
    except OSError:
        return False
    return True


def warn_without_ipv6(host: Host, name: str, listens_on: str) -> None:
    """Log a warning if IPv6 is turned off: listening on "::" works even then."""
    if family_of(listens_on) == socket.AF_INET6 and not ipv6_works():
        host.note(WARNING, name, "init", "nobody can reach this port", _NO_IPV6)


def text_of(address: Address) -> str:
    """Return address and port as text: 192.0.2.7:8888, [2001:db8::7]:8888."""
    host, port = address[:2]
    return f"[{host}]:{port}" if ":" in host else f"{host}:{port}"
