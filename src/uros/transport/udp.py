"""UDP over IPv4 at the agent's end."""

from __future__ import annotations

import errno
import socket
from typing import Final

from .base import ERROR, INFO, MAX_BURST, MAX_BURST_BYTES, Host, ServerTransport, TransportError

_LARGEST: Final = 65536
# A burst of a hundred boards must fit; the kernel may grant less.
_SOCKET_BUFFER: Final = 4 * 1024 * 1024

Peer = tuple[str, int]


class UdpServer(ServerTransport):
    """Listens on one port of all addresses, or of one."""

    name = "UDPv4Agent"
    kind = "UDP"

    def __init__(self, port: int, host: str = "0.0.0.0") -> None:
        super().__init__()
        self.port = port
        self._host_address = host
        self._socket: socket.socket | None = None
        self._buf = bytearray(_LARGEST)
        self._view = memoryview(self._buf)

    def open(self, host: Host) -> None:
        sock = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        sock.setblocking(False)
        for option in (socket.SO_RCVBUF, socket.SO_SNDBUF):
            sock.setsockopt(socket.SOL_SOCKET, option, _SOCKET_BUFFER)
        try:
            sock.bind((self._host_address, self.port))
        except OSError as error:
            sock.close()
            raise TransportError(error.errno, bind_trouble("UDP", self.port, error)) from error
        self.port = sock.getsockname()[1]
        self._socket = sock
        self._host = host
        host.watch(sock.fileno(), self._drain)
        host.note(INFO, self.name, "init", "running...", f"port: {self.port}")

    def _drain(self) -> None:
        sock = self._socket
        if sock is None:
            return
        host, buf, view, sessions = self._host, self._buf, self._view, self.sessions
        recvfrom_into, now = sock.recvfrom_into, host.now()
        left = MAX_BURST_BYTES
        for _ in range(MAX_BURST):
            try:
                length, peer = recvfrom_into(buf)
            except BlockingIOError:
                return
            except OSError as error:  # an ICMP error of an earlier send, on some systems
                host.note(ERROR, self.name, "receive", "socket error", str(error))
                return
            session = sessions.get(peer)
            if session is not None and length > 7 and buf[0] == session.session_id:
                host.received(self, session, buf, view, length, now)
            else:
                host.stray(self, peer, buf, view, length)
            left -= length
            if left <= 0:
                return

    def send(self, peer: Peer, datagram: bytes) -> None:
        if self._socket is not None:
            try:
                self._socket.sendto(datagram, peer)
            except OSError:
                pass  # no room, no route, nobody there: the streams repeat what matters

    def address(self, peer: Peer) -> str:
        return f"{peer[0]}:{peer[1]}"

    def close(self) -> None:
        if self._socket is not None:
            self._host.unwatch(self._socket.fileno())
            self._socket.close()
            self._socket = None


def bind_trouble(protocol: str, port: int, error: OSError) -> str:
    """Why a port cannot be bound, and what to do."""
    if error.errno == errno.EADDRINUSE:
        return (
            f"{protocol} port {port} is in use, perhaps by another agent:"
            f" stop it, or choose another port with --port"
        )
    if error.errno == errno.EACCES:
        return f"{protocol} port {port} is not permitted: choose one from 1024 on with --port"
    return f"{protocol} port {port} cannot be opened: {error.strerror}"
