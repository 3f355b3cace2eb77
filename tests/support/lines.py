"""The client's end of each transport: sends and receives messages, and sends raw bytes."""

import os
import select
import socket
import time
import tty

from support.portable import framed
from uros.wire.framing import Deframer, LengthDeframer

SECONDS = 10.0
"""The limit for waiting, in seconds."""


class Line:
    """One client's line. ``address`` is the board's on serial lines."""

    def __init__(self, fd):
        self.fd = fd
        self._messages = []

    def send(self, message):
        self.send_raw(message)

    def send_raw(self, data):
        raise NotImplementedError

    def _read(self):
        """The messages that can be read now, without waiting; None: the line is closed."""
        raise NotImplementedError

    def receive(self, deadline):
        """The next message; None where none arrives until ``deadline`` (time.monotonic)."""
        while not self._messages:
            wait = max(0.0, deadline - time.monotonic())
            if not select.select([self.fd], [], [], wait)[0]:
                return None
            messages = self._read()
            if messages is None:
                return None
            self._messages.extend(messages)
        return self._messages.pop(0)

    def close(self):
        raise NotImplementedError


class UdpLine(Line):
    def __init__(self, port, host="127.0.0.1"):
        family = socket.AF_INET6 if ":" in host else socket.AF_INET
        self._socket = socket.socket(family, socket.SOCK_DGRAM)
        self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4 << 20)
        self._socket.connect((host, port))
        super().__init__(self._socket.fileno())

    def send_raw(self, data):
        self._socket.send(data)

    def _read(self):
        return [self._socket.recv(65536)]

    def close(self):
        self._socket.close()


class TcpLine(Line):
    def __init__(self, port, host="127.0.0.1"):
        self._socket = socket.create_connection((host, port), SECONDS)
        self._deframer = LengthDeframer()
        super().__init__(self._socket.fileno())

    def send(self, message):
        self.send_raw(len(message).to_bytes(2, "little") + message)

    def send_raw(self, data):
        self._socket.sendall(data)

    def _read(self):
        chunk = self._socket.recv(65536)
        return self._deframer.feed(chunk) if chunk else None

    def close(self):
        self._socket.close()


class TlsLine(TcpLine):
    """``context`` is the client's."""

    def __init__(self, port, context, host="127.0.0.1"):
        super().__init__(port, host)
        self._socket = context.wrap_socket(self._socket, server_hostname=host)
        self.fd = self._socket.fileno()

    def receive(self, deadline):
        while self._socket.pending():  # data in the TLS layer, which select does not report
            self._messages.extend(self._read())
        return super().receive(deadline)


class SerialLine(Line):
    """A board on the file descriptor of a terminal, which ``close`` closes if ``owned``."""

    def __init__(self, fd, address=1, owned=True):
        self._deframer = Deframer(address)
        self._address = address
        self._owned = owned
        super().__init__(fd)

    @classmethod
    def open(cls, device, address=1):
        fd = os.open(device, os.O_RDWR | os.O_NOCTTY)
        tty.setraw(fd)
        return cls(fd, address)

    def send(self, message):
        self.send_raw(framed(message, self._address))

    def send_raw(self, data):
        while data:
            data = data[os.write(self.fd, data) :]

    def _read(self):
        return self._deframer.feed(os.read(self.fd, 65536))

    def close(self):
        if self._owned:
            os.close(self.fd)


class SharedTerminal:
    """Several boards on one line, as on a bus: each receives the frames with its address."""

    def __init__(self, fd):
        self.fd = fd
        self._lines = []

    def line(self, address):
        line = SerialLine(self.fd, address, owned=False)
        line._read = self._read_for(line)
        self._lines.append(line)
        return line

    def _read_for(self, reader):
        def read():
            chunk = os.read(self.fd, 65536)
            for line in self._lines:
                if line is not reader:
                    line._messages.extend(line._deframer.feed(chunk))
            return reader._deframer.feed(chunk)

        return read
