"""A board's end of UDP. Runs on MicroPython ports that have a network."""

import select
import socket

try:
    from typing import Any

    from ..wire.cdr import Buffer
except ImportError:  # MicroPython
    pass


class UdpTransport:
    """Messages to and from the agent at ``host``, ``port``, of at most ``mtu`` bytes."""

    def __init__(self, host: str, port: int = 8888, mtu: int = 512) -> None:
        self.mtu = mtu
        self._agent = (host, port)
        self._socket: "Any" = None
        self._poll: "Any" = None

    def open(self) -> None:
        """Raises OSError where the host is not known or the network is down."""
        self.close()
        address = socket.getaddrinfo(self._agent[0], self._agent[1], 0, socket.SOCK_DGRAM)[0]
        self._socket = socket.socket(address[0], socket.SOCK_DGRAM)
        # Connected: what others send is not ours.
        self._socket.connect(address[-1])
        self._socket.setblocking(False)
        self._poll = select.poll()
        self._poll.register(self._socket, select.POLLIN)

    def close(self) -> None:
        """Twice is once."""
        if self._socket is not None:
            self._socket.close()
            self._socket = None

    def send(self, message: "Buffer") -> None:
        """See :class:`uros.client.connection.Transport`.

        What the network does not take now, or has nobody to take, is lost: an agent that is not
        there yet is no reason to close the socket.
        """
        try:
            self._socket.send(message)
        except OSError:
            pass

    def receive(self, timeout_ms: int) -> "bytes | None":
        """See :class:`uros.client.connection.Transport`."""
        if not self._poll.poll(timeout_ms):
            return None
        try:
            data: bytes = self._socket.recv(self.mtu)
        except OSError:  # the answer of a host with no agent: as if nothing had come
            return None
        return data
