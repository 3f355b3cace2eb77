"""TCP over IPv4 or IPv6 at the agent's end: each message follows its 16-bit length."""

from __future__ import annotations

import socket
from collections import Counter
from ipaddress import IPv6Address
from typing import Final

from ...wire.framing import LengthDeframer
from .base import INFO, WARNING, Host, ServerTransport, TransportError
from .fault_counter import FaultCounter
from .ip import (
    Address,
    bind_trouble,
    family_of,
    listening_socket,
    text_of,
    warn_without_ipv6,
)

# Bytes that are read from a connection before the next socket is read.
_CHUNK: Final = 16384
# How long accepting pauses if no descriptors are left, in seconds.
_PAUSE: Final = 0.5
# Bytes that wait for a client; one that does not read them is disconnected.
MAX_UNSENT: Final = 4 * 1024 * 1024
# The most connections, because each takes a descriptor, even a silent one. (The C++ agent has 100.)
MAX_CONNECTIONS: Final = 1000
# The most connections from one address; with IPv6 from one network of 64 bits, all of whose
# addresses one machine may have.
MAX_FROM_ONE: Final = 250
# Bytes that wait for all clients together, because a thousand clients may read slowly.
MAX_UNSENT_OF_ALL: Final = 64 * 1024 * 1024
# How long a connection without a session may be silent, and how long a message may be incomplete,
# in seconds. A client sends CREATE_CLIENT at once; one that only pings may be this slow.
IDLE_SECONDS: Final = 30.0
_SWEEP_SECONDS: Final = 5.0
_NO_TLS_HERE: Final = (
    "it begins TLS, which this port does not speak: start the agent with --tls-cert and"
    " --tls-key, or remove TLS from the board's program"
)
_TCP_QUICKACK: Final[int | None] = getattr(socket, "TCP_QUICKACK", None)


class _Deframer(LengthDeframer):
    __slots__ = ()

    @property
    def pending(self) -> bool:
        """Whether a message has begun that is not complete."""
        return bool(self._buf)


class _Connection:
    __slots__ = ("address", "begun", "deframer", "network", "sock", "spoke", "unsent", "whole")

    def __init__(self, sock: socket.socket, address: Address, now: float) -> None:
        self.sock = sock
        self.address = address
        self.network = _network(address)
        self.deframer = _Deframer()
        self.unsent = bytearray()
        self.whole = now  # when the last message was complete
        self.spoke = 0  # the session id of that message
        self.begun = 0.0  # when the incomplete message began; 0: there is none


def _network(address: Address) -> str:
    """Return the network of an address; its connections share :data:`MAX_FROM_ONE`."""
    host = str(address[0]).partition("%")[0]
    if ":" not in host:
        return host
    ipv6 = IPv6Address(host)
    return str(ipv6.ipv4_mapped or int(ipv6) >> 64)


def is_client_hello(chunk: bytes) -> bool:
    """Return whether TLS begins: a handshake record with a whole ClientHello, by both lengths.

    If it were read as a message, that message would never end, and the board would wait in vain.
    """
    return (
        chunk[:2] == b"\x16\x03"
        and chunk[5:6] == b"\x01"
        and int.from_bytes(chunk[3:5], "big") == int.from_bytes(chunk[6:9], "big") + 4
    )


def _acknowledge_at_once(sock: socket.socket) -> None:
    """Do not delay the next acknowledgement (Linux; the kernel forgets the setting soon).

    C clients write a message's length and the message separately, and their kernel holds the
    message back until the length is acknowledged, which would take 40 ms otherwise.
    """
    if _TCP_QUICKACK is not None:
        sock.setsockopt(socket.IPPROTO_TCP, _TCP_QUICKACK, 1)


class TcpServer(ServerTransport):
    """Accepts connections on one port; a session ends with its connection.

    It listens on all IPv4 addresses ("0.0.0.0"), all of IPv6 ("::"), or one.
    """

    kind = "TCP"
    lasting = False

    def __init__(self, port: int, host: str = "0.0.0.0") -> None:
        super().__init__()
        self.name = "TCPv6Agent" if family_of(host) == socket.AF_INET6 else "TCPv4Agent"
        self.port = port
        self.listens_on = host
        self._socket: socket.socket | None = None
        self._connections: set[_Connection] = set()
        self._refused = FaultCounter()
        self._idle = FaultCounter()
        self._greeted = FaultCounter()  # those who begin TLS
        self._from: Counter[str] = Counter()  # connections of each network
        self._unsent = 0  # bytes, of all connections
        self._sweeping = False

    def open(self, host: Host) -> None:
        """Open and start watching; raises TransportError."""
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
            return  # the connection was closed before it was accepted
        except OSError as error:
            # Out of descriptors. The connection stays ready: only waiting helps.
            listener = self._socket
            self._host.unwatch(listener.fileno())
            self._host.wake_at(_PAUSE, self._listen)
            self._host.note(
                WARNING, self.name, "tcp", "cannot accept",
                f"{error.strerror or error}; connections wait (out of descriptors? raise ulimit -n,"
                " or LimitNOFILE= of a systemd unit)",
            )  # fmt: skip
            return
        network = _network(address)
        if self.admits is not None and not self.admits(str(address[0])):
            sock.close()
            self.on_refused("allow_net", text_of(address), "address not allowed")
            if self._refused.add():
                about = f"it is in no allowed network, refused: {self._refused.count}"
                self._note("connection refused", about, address)
            return
        full = len(self._connections) >= MAX_CONNECTIONS
        if full or self._from[network] >= MAX_FROM_ONE:
            sock.close()
            over = f"{MAX_CONNECTIONS} connections"
            if not full:
                over = f"{MAX_FROM_ONE} connections from one address"
            self.on_refused("connections", text_of(address), f"over {over}")
            if self._refused.add():
                self._note(
                    "connection refused", f"over {over}, refused: {self._refused.count}", address
                )
            return
        self._from[network] += 1
        sock.setblocking(False)
        sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        _acknowledge_at_once(sock)
        connection = _Connection(sock, address, self._host.clock.monotonic())
        self._connections.add(connection)
        if not self._sweeping:
            self._sweeping = True
            self._host.wake_at(_SWEEP_SECONDS, self._sweep)
        self._host.watch(sock.fileno(), lambda: self._ready(connection))

    def _sweep(self) -> None:
        """Close idle connections."""
        before = self._host.clock.monotonic() - IDLE_SECONDS
        for connection in list(self._connections):
            if connection.whole > before:
                continue
            if 0.0 < connection.begun <= before:
                why = f"a message that was not whole after {IDLE_SECONDS:.0f} s"
            elif connection in self.sessions or (
                connection.spoke & 0x7F and self._host.has_client(self, connection)
            ):
                continue  # a session may be silent: the agent probes it
            else:
                why = f"no session, and silent for {IDLE_SECONDS:.0f} s"
            if self._idle.add():
                self._note("connection closed", f"{why}, closed: {self._idle.count}",
                           connection.address)  # fmt: skip
            self._drop(connection)
        self._sweeping = bool(self._connections)
        if self._sweeping:
            self._host.wake_at(_SWEEP_SECONDS, self._sweep)

    def _note(self, event: str, about: str, address: Address) -> None:
        self._host.note(WARNING, self.name, "tcp", event, f"address: {text_of(address)}, {about}")

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
        if not connection.spoke and is_client_hello(chunk):
            if self._greeted.add():
                about = f"{_NO_TLS_HERE}, dropped: {self._greeted.count}"
                self._note("connection dropped", about, connection.address)
            self._drop(connection)
            return
        _acknowledge_at_once(connection.sock)
        now = self._host.now()
        messages = connection.deframer.feed(chunk)
        if messages:
            connection.whole = self._host.clock.monotonic()
            connection.spoke = messages[-1][0]
        if not connection.deframer.pending:
            connection.begun = 0.0
        elif messages or not connection.begun:
            connection.begun = self._host.clock.monotonic()
        for message in messages:
            if connection not in self._connections:
                return  # disconnected meanwhile: further answers could not be sent
            buf = bytearray(message)
            self.deliver(self._host, connection, buf, memoryview(buf), len(buf), now)

    def send(self, peer: _Connection, datagram: bytes) -> None:
        """Send one message; it is lost if it cannot be sent."""
        if peer not in self._connections:
            return
        if len(peer.unsent) + len(datagram) > MAX_UNSENT:
            self._note("connection dropped", "it does not read its messages", peer.address)
            self._drop(peer)
            return
        if len(datagram) > 0xFFFF:
            return  # longer than the length field; no session sends such a message
        waiting = bool(peer.unsent)
        peer.unsent += len(datagram).to_bytes(2, "little") + datagram
        self._unsent += 2 + len(datagram)
        if not waiting:
            self._push(peer)
        if self._unsent > MAX_UNSENT_OF_ALL:
            worst = max(self._connections, key=lambda connection: len(connection.unsent))
            self._note(
                "connection dropped",
                f"{MAX_UNSENT_OF_ALL} bytes wait for clients that do not read, most for this one",
                worst.address,
            )
            self._drop(worst)

    def _push(self, connection: _Connection) -> None:
        try:
            sent = connection.sock.send(connection.unsent)
        except BlockingIOError:
            sent = 0
        except OSError:
            self._drop(connection)
            return
        del connection.unsent[:sent]
        self._unsent -= sent
        fileno = connection.sock.fileno()
        self._host.watch(fileno, lambda: self._ready(connection), bool(connection.unsent))

    def _drop(self, connection: _Connection) -> None:
        if connection in self._connections:
            self._connections.discard(connection)
            self._from[connection.network] -= 1
            if not self._from[connection.network]:
                del self._from[connection.network]
            self._unsent -= len(connection.unsent)
            self._host.unwatch(connection.sock.fileno())
            connection.sock.close()
            self._host.gone(self, connection)

    def label(self) -> str:
        """Return what it listens on, as text."""
        return f"port {self.port}"

    def counters(self) -> dict[str, int]:
        """Return the counters."""
        return {
            **super().counters(), "connections": len(self._connections),
            "refused": self._refused.count,
        }  # fmt: skip

    def host_of(self, peer: _Connection) -> str | None:
        """Return the peer's IP address."""
        return str(peer.address[0])

    def address(self, peer: _Connection) -> str:
        """Return the peer as text."""
        return text_of(peer.address)

    def close(self) -> None:
        """Close everything; idempotent."""
        for connection in list(self._connections):
            self._drop(connection)
        if self._socket is not None:
            self._host.unwatch(self._socket.fileno())
            self._socket.close()
            self._socket = None
