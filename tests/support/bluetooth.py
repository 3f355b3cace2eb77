"""Bluetooth without an adapter: RFCOMM's addresses and channels, over TCP on loopback."""

import errno
import socket


class Air:
    """Who is on the air. ``errors`` are raised, one a call, by what is tried next."""

    def __init__(self):
        self.listening = {}  # (address, channel) or channel: the port that stands for it
        self.names = {}  # port of who connects: its Bluetooth address
        self.errors = {"make": [], "bind": [], "connect": [], "accept": []}
        self.tried = []

    def fail(self, call):
        if self.errors[call]:
            number = self.errors[call].pop(0)
            self.tried.append((call, number))
            raise OSError(number, "injected")

    def make(self):
        """The agent's sockets."""
        self.fail("make")
        return _Rfcomm(self)

    def board(self, address, channel=1):
        """A board connects to the channel that the agent listens on."""
        sock = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
        sock.bind(("127.0.0.1", 0))
        self.names[sock.getsockname()[1]] = address
        sock.connect(("127.0.0.1", self.listening[channel]))
        return sock

    def waiting_board(self, address, channel=1):
        """A board's socket that waits for the agent to connect."""
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
