"""Custom transports, written as a user of uros writes them."""

import select
import socket

from uros.agent.transports.custom import CustomTransport


class Datagrams(CustomTransport):
    """A message-oriented transport whose boards have addresses."""

    def __init__(self):
        self.port = 0
        self.socket = None

    def open(self):
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4 << 20)
        self.socket.bind(("127.0.0.1", self.port))
        self.port = self.socket.getsockname()[1]

    def close(self):
        if self.socket is not None:
            self.socket.close()
            self.socket = None

    def read(self, timeout):
        if select.select([self.socket], [], [], timeout)[0]:
            return self.socket.recvfrom(65536)
        return None

    def write(self, data, peer):
        self.socket.sendto(data, peer)


class Stream:
    """A framed byte stream without the base class; it blocks when the other end does not read."""

    framed = True

    def __init__(self):
        self.ours, self.theirs = socket.socketpair()

    def open(self):
        pass

    def close(self):
        pass

    def read(self, timeout):
        if select.select([self.ours], [], [], timeout)[0]:
            return self.ours.recv(1000)
        return None

    def write(self, data, peer):
        assert peer is None
        self.ours.sendall(data)

    def end(self):
        self.ours.close()
        self.theirs.close()
