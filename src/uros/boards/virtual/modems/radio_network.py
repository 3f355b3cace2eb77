"""The network that virtual radio modems reach: access points, and UDP links to hosts behind them.

Runs on MicroPython too, as the tests of modems do, except for :class:`HostRadioNetwork` and its
sockets.
"""

import sys

try:
    from typing import Any
except ImportError:  # MicroPython
    pass


class Link:
    """A UDP link to one host and port, in memory.

    Attributes:
        address: The host, its port and the local port.
        sent: The datagrams that the board has sent.
        incoming: The datagrams that the board has not received yet.
        closed: Whether the link is closed.
    """

    def __init__(self, host: str = "", port: int = 0, local_port: int = 0) -> None:
        self.address = (host, port, local_port)
        self.sent: list[bytes] = []
        self.incoming: list[bytes] = []
        self.closed = False

    def send(self, data: bytes) -> bool:
        """Send a datagram; return whether the network took it."""
        self.sent.append(data)
        return True

    def recv(self) -> "bytes | None":
        """Return the next datagram received, None when there is none."""
        return self.incoming.pop(0) if self.incoming else None

    def close(self) -> None:
        """Close the link."""
        self.closed = True


class RadioNetwork:
    """The access points in range and the hosts behind them, in memory.

    Attributes:
        access_points: The passwords of the access points by their names.
        hosts: The host names and addresses that can be reached, None for all.
        address: The board's own address on this host, "" for any.
        links: All links ever opened.
    """

    def __init__(
        self, access_points: "dict[str, str]", hosts: "tuple[str, ...] | None" = None
    ) -> None:
        self.access_points = access_points
        self.hosts = hosts
        self.address = ""
        self.links: list[Any] = []

    def link(self, host: str, port: int, local_port: int) -> "Any":
        """Open a UDP link; return None when the host cannot be reached."""
        if self.hosts is not None and host not in self.hosts:
            return None
        self.links.append(self._link(host, port, local_port))
        return self.links[-1]

    def _link(self, host: str, port: int, local_port: int) -> "Any":
        return Link(host, port, local_port)

    def close(self) -> None:
        """Close all links."""
        for link in self.links:
            link.close()


if sys.implementation.name != "micropython":
    import socket

    class HostLink(Link):
        """A UDP link over a socket of this host."""

        def __init__(self, host: str, port: int, local_port: int, address: str = "") -> None:
            super().__init__(host, port, local_port)
            self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
            self._socket.setblocking(False)
            if address:
                self._socket.bind((address, 0))
            self._socket.connect((host, port))

        def send(self, data: bytes) -> bool:
            """Send a datagram; return whether the socket took it."""
            try:
                self._socket.send(data)
            except OSError:
                return False
            return True

        def recv(self) -> "bytes | None":
            """Return the next datagram received, None when there is none."""
            try:
                return self._socket.recv(65536)
            except OSError:
                return None

        def close(self) -> None:
            """Close the link and its socket."""
            super().close()
            self._socket.close()

    class HostRadioNetwork(RadioNetwork):
        """Access points whose network is that of this host.

        The local port that a board chooses is not bound: many virtual boards would choose the
        same one.

        Args:
            access_points: The passwords of the access points by their names.
            hosts: The host names and addresses that can be reached, None for all.
            routes: The address on this host for a "host:port" of the virtual network.
            address: The board's own address on this host, "" for any.
        """

        def __init__(
            self, access_points: "dict[str, str]", hosts: "tuple[str, ...] | None" = None,
            routes: "dict[str, tuple[str, int]] | None" = None, address: str = "",
        ) -> None:  # fmt: skip
            super().__init__(access_points, hosts)
            self.address = address
            self._routes = routes or {}

        def route(self, host: str, port: int) -> "tuple[str, int]":
            """Return the address on this host for a host and port of the virtual network."""
            return self._routes.get(f"{host}:{port}", (host, port))

        def _link(self, host: str, port: int, local_port: int) -> HostLink:
            return HostLink(*self.route(host, port), local_port, self.address)
