"""The group and the port of ``uros multicast``, as options and as sockets."""

from __future__ import annotations

import argparse
import errno
import ipaddress
import socket
import struct
from typing import Final

from ..errors import ToolError

# As in ros2.
GROUP: Final = "225.0.0.1"
PORT: Final = 49150
TEXT: Final = b"Hello World!"
_MAX: Final = 4096


def add_group(parser: argparse.ArgumentParser) -> None:
    """Declare ``--group`` and ``--port``."""
    parser.add_argument(
        "--group", metavar="ADDRESS", type=group, default=GROUP,
        help=f"multicast group (default: {GROUP})",
    )  # fmt: skip
    parser.add_argument(
        "--port", metavar="N", type=port, default=PORT, help=f"UDP port (default: {PORT})"
    )


def group(text: str) -> str:
    """Parse the IPv4 address of a multicast group."""
    try:
        address = ipaddress.IPv4Address(text)
    except ValueError:
        address = ipaddress.IPv4Address(0)
    if not address.is_multicast:
        raise argparse.ArgumentTypeError(
            f"{text!r} is not a multicast group: those are 224.0.0.0 to 239.255.255.255"
        )
    return str(address)


def port(text: str) -> int:
    """Parse a UDP port."""
    if not text.isdecimal() or len(text) > 5 or not 0 < int(text) < 65536:
        raise argparse.ArgumentTypeError(f"{text!r} is not a port (1 to 65535)")
    return int(text)


def ttl(text: str) -> int:
    """Parse a number of hops."""
    if not text.isdecimal() or len(text) > 3 or not 0 < int(text) < 256:
        raise argparse.ArgumentTypeError(f"{text!r} is not a TTL (1 to 255)")
    return int(text)


def send(to: str, at: int, hops: int | None = None) -> None:
    """Send one datagram with `TEXT`.

    Args:
        to: The group.
        at: The port.
        hops: How many routers may pass it on, plus one; the system's number by default.

    Raises:
        ToolError: It cannot be sent.
    """
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sock:
        if hops is not None:
            sock.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_TTL, hops)
        try:
            sock.sendto(TEXT, (to, at))
        except OSError as error:
            raise ToolError(f"nothing can be sent to {to}: {error.strerror}{_FIX}") from error


def receiver(of: str, at: int) -> socket.socket:
    """Return a socket that receives what is sent to a group.

    Args:
        of: The group.
        at: The port, which other sockets may use too.

    Raises:
        ToolError: The port or the group cannot be used.
    """
    sock = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    try:
        sock.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        if hasattr(socket, "SO_REUSEPORT"):
            sock.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEPORT, 1)
        sock.bind(("", at))
        request = struct.pack("=4sI", socket.inet_aton(of), socket.INADDR_ANY)
        sock.setsockopt(socket.IPPROTO_IP, socket.IP_ADD_MEMBERSHIP, request)
    except OSError as error:
        sock.close()
        if error.errno in (errno.EADDRINUSE, errno.EACCES):
            raise ToolError(
                f"port {at} cannot be used: {error.strerror}; choose another with --port"
            ) from error
        raise ToolError(f"the group {of} cannot be joined: {error.strerror}{_FIX}") from error
    return sock


def receive(sock: socket.socket) -> tuple[str, str]:
    """Wait for a datagram; return its text, and its sender as ``address:port``."""
    data, (host, at) = sock.recvfrom(_MAX)
    return data.decode("utf-8", "backslashreplace"), f"{host}:{at}"


_FIX: Final = "; 'uros multicast test' tells which network interface is at fault"
