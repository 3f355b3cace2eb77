"""A board's end of UDP. Runs on MicroPython ports that have a network."""

import select
import socket

try:
    from typing import Any

    from ..wire.cdr import Buffer
except ImportError:  # MicroPython
    pass


class UdpTransport:
    """Messages to and from the agent at ``host``, ``port``, of at most ``mtu`` bytes.

    ``host`` is a name, or an address of IPv4 or IPv6. Of a name's addresses, the next is tried
    where one says that nobody is there: localhost can be 127.0.0.1 and ::1, the agent on one.
    An address that has answered is kept until the next :meth:`open`: a restarted agent knows the
    session by our port.
    """

    def __init__(self, host: str, port: int = 8888, mtu: int = 512) -> None:
        self.mtu = mtu
        self._agent = (host, port)
        self._turn = 0
        self._answered = False
        self._addresses: "Any" = ()
        self._socket: "Any" = None
        self._poll: "Any" = None

    def open(self) -> None:
        """Raises OSError where the host is not known or the network is down."""
        self.close()
        self._answered = False
        self._addresses = socket.getaddrinfo(self._agent[0], self._agent[1], 0, socket.SOCK_DGRAM)
        self._connect()

    def _connect(self) -> None:
        """To the first address from the one in turn on that there is a way to."""
        trouble = OSError("no address")
        for _ in self._addresses:
            address = self._addresses[self._turn % len(self._addresses)]
            sock = None
            try:
                sock = socket.socket(address[0], socket.SOCK_DGRAM)
                # Connected: what others send is not ours.
                sock.connect(address[-1])
            except OSError as error:
                if sock is not None:
                    sock.close()
                trouble = error
                self._turn += 1
                continue
            self.close()
            sock.setblocking(False)
            self._socket = sock
            self._poll = select.poll()
            self._poll.register(sock, select.POLLIN)
            return
        raise trouble

    def close(self) -> None:
        """Twice is once."""
        if self._socket is not None:
            self._socket.close()
            self._socket = None

    def send(self, message: "Buffer", size: int = -1) -> None:
        """See :class:`uros.client.protocols.Transport`. Without a size, all of it.

        What the network does not take now, or has nobody to take, is lost: an agent that is not
        there yet is no reason to close the socket.
        """
        try:
            self._socket.send(message if size < 0 else memoryview(message)[:size])
        except OSError:
            pass

    def receive(self, timeout_ms: int) -> "bytes | None":
        """See :class:`uros.client.protocols.Transport`."""
        if not self._poll.poll(timeout_ms):
            return None
        try:
            data: bytes = self._socket.recv(self.mtu)
        except OSError:  # the answer of a host with no agent: as if nothing had come
            if len(self._addresses) > 1 and not self._answered:
                self._turn += 1
                try:
                    self._connect()
                except OSError:  # the socket that was there stays
                    pass
            return None
        self._answered = True
        return data
