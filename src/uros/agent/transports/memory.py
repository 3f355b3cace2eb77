"""Boards and agent in one process: each board a pair of sockets, with no network between them."""

from __future__ import annotations

import select
import socket

from .base import Host, ServerTransport

_LARGEST = 65536


class MemoryServer(ServerTransport):
    """The agent's end; a peer is the number that :meth:`connect` gave it."""

    name = "MemoryAgent"
    kind = "MEMORY"

    def __init__(self) -> None:
        super().__init__()
        self._host: Host | None = None
        self._peers: dict[int, socket.socket] = {}
        self._buf = bytearray(_LARGEST)
        self._view = memoryview(self._buf)
        self._count = 0

    def open(self, host: Host) -> None:
        """Open and start watching; raises TransportError."""
        self._host = host
        for number in self._peers:
            self._watch(number)

    def connect(self, mtu: int = 512) -> MemoryTransport:
        """Add a line for a board; call it before the agent runs, or in its thread."""
        agent_end, client_end = socket.socketpair(socket.AF_UNIX, socket.SOCK_DGRAM)
        for end in (agent_end, client_end):
            end.setblocking(False)
        self._count += 1
        self._peers[self._count] = agent_end
        if self._host is not None:
            self._watch(self._count)
        return MemoryTransport(client_end, mtu)

    def _watch(self, number: int) -> None:
        assert self._host is not None
        self._host.watch(self._peers[number].fileno(), lambda: self._ready(number))

    def _ready(self, number: int) -> None:
        host = self._host
        assert host is not None
        try:
            length = self._peers[number].recv_into(self._buf)
        except BlockingIOError:
            return
        except OSError:
            length = 0
        if length:
            self.deliver(host, number, self._buf, self._view, length, host.now())

    def send(self, peer: int, datagram: bytes) -> None:
        """Send one message; it is lost if it cannot be sent."""
        try:
            self._peers[peer].send(datagram)
        except OSError:  # the buffer is full, or the board has closed its end
            pass

    def address(self, peer: int) -> str:
        """Return the peer as text."""
        return f"memory:{peer}"

    def close(self) -> None:
        """Close everything; idempotent."""
        for end in self._peers.values():
            if self._host is not None:
                self._host.unwatch(end.fileno())
            end.close()
        self._peers.clear()


class MemoryTransport:
    """The board's end."""

    def __init__(self, end: socket.socket, mtu: int) -> None:
        self.mtu = mtu
        self._socket = end

    def open(self) -> None:
        """Do nothing: it is open."""

    def close(self) -> None:
        """Drop received messages; the socket stays open for the next session."""
        while self.receive(0) is not None:
            pass

    def send(self, message: bytes | bytearray | memoryview, size: int = -1) -> None:
        """Send one message; see :class:`uros.client.protocols.Transport`."""
        try:
            self._socket.send(message if size < 0 else memoryview(message)[:size])
        except OSError:  # full, or there is no agent
            pass

    def receive(self, timeout_ms: int) -> bytes | None:
        """Receive one message; see :class:`uros.client.protocols.Transport`."""
        if not select.select([self._socket], [], [], timeout_ms / 1000)[0]:
            return None
        try:
            return self._socket.recv(_LARGEST) or None
        except OSError:
            return None
