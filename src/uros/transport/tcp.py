"""TCP over IPv4 or IPv6 at the agent's end: each message behind its 16-bit length."""

from __future__ import annotations

import socket
from typing import Final

from ..wire.framing import LengthDeframer
from .base import INFO, WARNING, Host, ServerTransport, TransportError
from .ip import (
    Address,
    bind_trouble,
    family_of,
    listening_socket,
    text_of,
    warn_without_ipv6,
)
from .worker import Tally

# What is handled before it is another socket's turn.
_CHUNK: Final = 16384
# How long nothing is accepted where no descriptors are left, in seconds.
_PAUSE: Final = 0.5
# A client that does not read what it asked for is cut off here.
MAX_UNSENT: Final = 4 * 1024 * 1024
# Attack: connections that say nothing, a descriptor each. (The C++ agent has 100.)
MAX_CONNECTIONS: Final = 1000
_TCP_QUICKACK: Final[int | None] = getattr(socket, "TCP_QUICKACK", None)


class _Connection:
    __slots__ = ("address", "deframer", "sock", "unsent")

    def __init__(self, sock: socket.socket, address: Address) -> None:
        self.sock = sock
        self.address = address
        self.deframer = LengthDeframer()
        self.unsent = bytearray()


def _acknowledge_at_once(sock: socket.socket) -> None:
    """Do not delay the next acknowledgement (Linux; the kernel forgets it soon).

    C clients write a message's length and the message apart, and their kernel holds
    the second back until the first is acknowledged: 40 ms, else.
    """
    if _TCP_QUICKACK is not None:
        sock.setsockopt(socket.IPPROTO_TCP, _TCP_QUICKACK, 1)


class TcpServer(ServerTransport):
    """Accepts connections on one port; a session ends with its connection.

    Of all addresses of IPv4 ("0.0.0.0") or IPv6 ("::"), or of one.
    """

    kind = "TCP"

    def __init__(self, port: int, host: str = "0.0.0.0") -> None:
        super().__init__()
        self.name = "TCPv6Agent" if family_of(host) == socket.AF_INET6 else "TCPv4Agent"
        self.port = port
        self.listens_on = host
        self._socket: socket.socket | None = None
        self._connections: set[_Connection] = set()
        self._refused = Tally()

    def open(self, host: Host) -> None:
        sock = listening_socket("TCP", self.listens_on, self.port)
        try:
            sock.listen(100)
        except OSError as error:
            sock.close()
            raise TransportError(error.errno, bind_trouble("TCP", self.port, error)) from error
        self.listens_on, self.port = sock.getsockname()[:2]
        self._socket = sock
        self._host = host
        self._listen()
        host.note(INFO, self.name, "init", "running...", f"port: {self.port}")
        warn_without_ipv6(host, self.name, self.listens_on)

    def _listen(self) -> None:
        if self._socket is not None:
            self._host.watch(self._socket.fileno(), self._accept)

    def _accept(self) -> None:
        if self._socket is None:
            return
        try:
            sock, address = self._socket.accept()
        except (BlockingIOError, ConnectionError):
            return  # gone again
        except OSError as error:
            # Out of descriptors. The connection stays ready: only waiting helps.
            listener = self._socket
            self._host.unwatch(listener.fileno())
            self._host.wake_at(_PAUSE, self._listen)
            self._host.note(
                WARNING, self.name, "tcp", "cannot accept", error.strerror or str(error)
            )
            return
        if len(self._connections) >= MAX_CONNECTIONS:
            sock.close()
            if self._refused.add():
                self._note(
                    "connection refused",
                    f"over {MAX_CONNECTIONS} connections, refused: {self._refused.count}", address,
                )  # fmt: skip
            return
        sock.setblocking(False)
        sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        _acknowledge_at_once(sock)
        connection = _Connection(sock, address)
        self._connections.add(connection)
        self._host.watch(sock.fileno(), lambda: self._ready(connection))

    def _note(self, what: str, about: str, address: Address) -> None:
        self._host.note(WARNING, self.name, "tcp", what, f"address: {text_of(address)}, {about}")

    def _ready(self, connection: _Connection) -> None:
        if connection.unsent:
            self._push(connection)
            if connection not in self._connections:
                return
        try:
            chunk = connection.sock.recv(_CHUNK)
        except BlockingIOError:
            return
        except OSError:
            chunk = b""
        if not chunk:
            self._drop(connection)
            return
        _acknowledge_at_once(connection.sock)
        now = self._host.now()
        for message in connection.deframer.feed(chunk):
            if connection not in self._connections:
                return  # cut off at an answer: what would be made now would never leave
            buf = bytearray(message)
            self.deliver(self._host, connection, buf, memoryview(buf), len(buf), now)

    def send(self, peer: _Connection, datagram: bytes) -> None:
        if peer not in self._connections:
            return
        if len(peer.unsent) + len(datagram) > MAX_UNSENT:
            self._note("connection dropped", "it does not read what it is sent", peer.address)
            self._drop(peer)
            return
        if len(datagram) > 0xFFFF:
            return  # the length has 16 bits; the MTU field too, so this is no session's
        waiting = bool(peer.unsent)
        peer.unsent += len(datagram).to_bytes(2, "little") + datagram
        if not waiting:
            self._push(peer)

    def _push(self, connection: _Connection) -> None:
        try:
            sent = connection.sock.send(connection.unsent)
        except BlockingIOError:
            sent = 0
        except OSError:
            self._drop(connection)
            return
        del connection.unsent[:sent]
        fileno = connection.sock.fileno()
        self._host.watch(fileno, lambda: self._ready(connection), bool(connection.unsent))

    def _drop(self, connection: _Connection) -> None:
        if connection in self._connections:
            self._connections.discard(connection)
            self._host.unwatch(connection.sock.fileno())
            connection.sock.close()
            self._host.gone(self, connection)

    def address(self, peer: _Connection) -> str:
        return text_of(peer.address)

    def close(self) -> None:
        for connection in list(self._connections):
            self._drop(connection)
        if self._socket is not None:
            self._host.unwatch(self._socket.fileno())
            self._socket.close()
            self._socket = None
