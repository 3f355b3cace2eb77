"""Bluetooth without an adapter: addresses and channels of RFCOMM over TCP on loopback."""

import errno
import socket


class Air:
    """The simulated radio. Each call raises the next of its ``errors``."""

    def __init__(self):
        self.listening = {}  # (address, channel) or channel → the TCP port in its place
        self.names = {}  # TCP port of a connecting board → its Bluetooth address
        self.errors = {"make": [], "bind": [], "connect": [], "accept": []}
        self.tried = []

    def fail(self, call):
        if self.errors[call]:
            number = self.errors[call].pop(0)
            self.tried.append((call, number))
            raise OSError(number, "injected")

    def make(self):
        """Create a socket of the agent."""
        self.fail("make")
        return _Rfcomm(self)

    def board(self, address, channel=1):
        """Connect a board to the channel on which the agent listens; its socket."""
        sock = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
        sock.bind(("127.0.0.1", 0))
        self.names[sock.getsockname()[1]] = address
        sock.connect(("127.0.0.1", self.listening[channel]))
        return sock

    def waiting_board(self, address, channel=1):
        """A board's socket that listens for the agent."""
        sock = socket.create_server(("127.0.0.1", 0))
        self.listening[address, channel] = sock.getsockname()[1]
        return sock


class _Rfcomm(socket.socket):
    def __init__(self, air):
        super().__init__(socket.AF_INET, socket.SOCK_STREAM)
        self._air = air

    def bind(self, address):
        self._air.fail("bind")
        super().bind(("127.0.0.1", 0))
        self._air.listening[address[1]] = self.getsockname()[1]

    def accept(self):
        self._air.fail("accept")
        sock, address = super().accept()
        return sock, (self._air.names[address[1]], 1)

    def connect_ex(self, address):
        try:
            self._air.fail("connect")
        except OSError as error:
            return error.errno
        port = self._air.listening.get(address)
        return errno.EHOSTDOWN if port is None else super().connect_ex(("127.0.0.1", port))
