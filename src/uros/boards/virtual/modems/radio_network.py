"""What radio modems of virtual boards reach: access points, and hosts behind them.

Runs on MicroPython too, where tests of modems do; the sockets of :class:`HostAir` do not.
"""

import sys

try:
    from typing import Any
except ImportError:  # MicroPython
    pass


class Link:
    """A UDP link to one host and port, in memory: ``sent`` is what the board has sent, ``come``
    what the host has for it.
    """

    def __init__(self, host: str = "", port: int = 0, local_port: int = 0) -> None:
        self.where = (host, port, local_port)
        self.sent: list[bytes] = []
        self.come: list[bytes] = []
        self.closed = False

    def send(self, data: bytes) -> bool:
        """Whether the network takes it."""
        self.sent.append(data)
        return True

    def recv(self) -> "bytes | None":
        """What has come, one datagram a call."""
        return self.come.pop(0) if self.come else None

    def close(self) -> None:
        self.closed = True


class Air:
    """``networks`` are the access points in reach, by their names, with the passwords. ``address``
    is the board's own, "" for any.

    ``hosts`` are the names and addresses that they know the way to, None for any; ``links`` are
    all that was ever opened.
    """

    def __init__(self, networks: "dict[str, str]", hosts: "tuple[str, ...] | None" = None) -> None:
        self.networks = networks
        self.hosts = hosts
        self.address = ""
        self.links: list[Any] = []

    def link(self, host: str, port: int, local_port: int) -> "Any":
        """A link, or None: nobody knows the way."""
        if self.hosts is not None and host not in self.hosts:
            return None
        self.links.append(self._link(host, port, local_port))
        return self.links[-1]

    def _link(self, host: str, port: int, local_port: int) -> "Any":
        return Link(host, port, local_port)

    def close(self) -> None:
        for link in self.links:
            link.close()


if sys.implementation.name != "micropython":
    import socket

    class HostLink(Link):
        """The same over the host's own UDP."""

        def __init__(self, host: str, port: int, local_port: int, address: str = "") -> None:
            super().__init__(host, port, local_port)
            self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
            self._socket.setblocking(False)
            if address:
                self._socket.bind((address, 0))
            self._socket.connect((host, port))

        def send(self, data: bytes) -> bool:
            try:
                self._socket.send(data)
            except OSError:
                return False
            return True

        def recv(self) -> "bytes | None":
            try:
                return self._socket.recv(65536)
            except OSError:
                return None

        def close(self) -> None:
            super().close()
            self._socket.close()

    class HostAir(Air):
        """Access points whose network is the host's own. A port of the board's own choice is not
        kept: many virtual boards would choose the same. ``routes`` says where a "host:port" of
        that network really is, ``address`` is the board's own on this host, "" for any.
        """

        def __init__(
            self, networks: "dict[str, str]", hosts: "tuple[str, ...] | None" = None,
            routes: "dict[str, tuple[str, int]] | None" = None, address: str = "",
        ) -> None:  # fmt: skip
            super().__init__(networks, hosts)
            self.address = address
            self._routes = routes or {}

        def route(self, host: str, port: int) -> "tuple[str, int]":
            """Where that is on this host."""
            return self._routes.get(f"{host}:{port}", (host, port))

        def _link(self, host: str, port: int, local_port: int) -> HostLink:
            return HostLink(*self.route(host, port), local_port, self.address)
