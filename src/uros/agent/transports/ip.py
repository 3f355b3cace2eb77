"""What UDP and TCP at the agent's end share: sockets and addresses of IPv4 and IPv6."""

from __future__ import annotations

import errno
import socket
from typing import Any

from .base import WARNING, Host, TransportError

# As sockets give them: (host, port), and for IPv6 flow label and scope behind.
Address = tuple[Any, ...]

_NO_IPV6 = (
    "IPv6 is not available on this machine: turn it on"
    " (sysctl net.ipv6.conf.all.disable_ipv6=0 net.ipv6.conf.lo.disable_ipv6=0;"
    " in a container, by the options of its network), or listen on IPv4"
)


def family_of(host: str) -> socket.AddressFamily:
    """The family of an address to listen on: IPv6 is what has a colon."""
    return socket.AF_INET6 if ":" in host else socket.AF_INET


def listening_socket(protocol: str, host: str, port: int) -> socket.socket:
    """A socket of ``protocol`` ("UDP" or "TCP"), bound and non-blocking.

    One on IPv6 leaves IPv4 alone, so that there may be one of each on a port.
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
            said = address_trouble(protocol, host, port)
        elif error.errno in (errno.EAFNOSUPPORT, errno.EPROTONOSUPPORT):
            said = f"{protocol} port {port} cannot be opened: {_NO_IPV6}"
        else:
            said = bind_trouble(protocol, port, error)
        raise TransportError(error.errno, said) from error
    return sock


def bind_trouble(protocol: str, port: int, error: OSError, option: str = "--port") -> str:
    """Why a port cannot be bound, and what to do."""
    if error.errno == errno.EADDRINUSE:
        return (
            f"{protocol} port {port} is in use, perhaps by another agent:"
            f" stop it, or choose another port with {option}"
        )
    if error.errno == errno.EACCES:
        return f"{protocol} port {port} is not permitted: choose one from 1024 on with {option}"
    return f"{protocol} port {port} cannot be opened: {error.strerror}"


def address_trouble(protocol: str, host: str, port: int) -> str:
    """Why an address that this machine does not have cannot be listened on."""
    if family_of(host) == socket.AF_INET6 and not ipv6_works():
        return f"{protocol} port {port} cannot be opened: {_NO_IPV6}"
    everything = "::" if family_of(host) == socket.AF_INET6 else "0.0.0.0"
    return (
        f"{protocol} port {port} cannot be opened: this machine has no address {host}:"
        f" choose one that it has, or {everything} for all"
    )


def ipv6_works() -> bool:
    """Whether this machine can reach itself over IPv6. Nothing is sent."""
    try:
        with socket.socket(socket.AF_INET6, socket.SOCK_DGRAM) as sock:
            sock.connect(("::1", 9))
    except OSError:
        return False
    return True


def warn_without_ipv6(host: Host, name: str, listens_on: str) -> None:
    """Say that nobody will come: "::" can be listened on even where IPv6 is turned off."""
    if family_of(listens_on) == socket.AF_INET6 and not ipv6_works():
        host.note(WARNING, name, "init", "nobody can reach this port", _NO_IPV6)


def text_of(address: Address) -> str:
    """An address and port as a person reads it: 192.0.2.7:8888, [2001:db8::7]:8888."""
    host, port = address[:2]
    return f"[{host}]:{port}" if ":" in host else f"{host}:{port}"
