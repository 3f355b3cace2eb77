"""Client transport over UDP. Runs on MicroPython ports that have a network."""

import select
import socket

try:
    from typing import Any

    from ..wire.cdr import Buffer
except ImportError:  # MicroPython
    pass


class UdpTransport:
    """Messages to and from the agent at ``host``, ``port``, of at most ``mtu`` bytes.

    ``host`` is a name, or an address of IPv4 or IPv6. If one of a name's addresses reports that
    its port is closed, the next one is tried: localhost may be 127.0.0.1 and ::1, with the agent on
    one of them. An address that has answered is kept until the next :meth:`open`: a restarted agent
    identifies the session by our port.

    With ``local_port`` the board always sends from this port, also after a reset or deep sleep. So
    the agent recognizes it at once, and need not ask its former port first, which takes half a
    second.
    """

    def __init__(self, host: str, port: int = 8888, mtu: int = 512, local_port: int = 0) -> None:
        self.mtu = mtu
        self._local_port = local_port
        self._agent = (host, port)
        self._turn = 0
        self._answered = False
        self._addresses: "Any" = ()
        self._socket: "Any" = None
        self._poll: "Any" = None

    def open(self) -> None:
        """Open the socket. Raises OSError if the host is unknown or the network is down."""
        self.close()
        self._answered = False
        self._addresses = socket.getaddrinfo(self._agent[0], self._agent[1], 0, socket.SOCK_DGRAM)
        self._connect()

    def _connect(self) -> None:
        """Connect to the first reachable address, beginning with the current one."""
        trouble = OSError("no address")
        for _ in self._addresses:
            address = self._addresses[self._turn % len(self._addresses)]
            sock = None
            try:
                sock = socket.socket(address[0], socket.SOCK_DGRAM)
                if self._local_port:
                    any_address = "0.0.0.0" if address[0] == socket.AF_INET else "::"
                    own = socket.getaddrinfo(any_address, self._local_port, 0, socket.SOCK_DGRAM)
                    sock.bind(own[0][-1])
                # Connected: datagrams from other sources are not received.
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
        """Close the transport; idempotent."""
        if self._socket is not None:
            self._socket.close()
            self._socket = None

    def send(self, message: "Buffer", size: int = -1) -> None:
        """See :class:`uros.client.protocols.Transport`. Without ``size``, all of the message.

        A message that cannot be sent now is lost: the socket stays open for an agent that is not
        running yet.
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
        except OSError:  # port unreachable: as if nothing had been received
            if len(self._addresses) > 1 and not self._answered:
                self._turn += 1
                try:
                    self._connect()
                except OSError:  # keep the current socket
                    pass
            return None
        self._answered = True
        return data
