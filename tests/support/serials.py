"""Serial lines for RunningAgent besides a device and a pseudo-terminal."""

import os
import socket
import time
import tty

from support.bluetooth import Air
from support.lines import SECONDS, SerialLine, SharedTerminal

KINDS = ("multiserial", "pyserial", "socket", "rfcomm")


class Ends:
    """A kind of line: ``transports`` has the agent's ends, ``line(n)`` is the n-th client's."""

    def __init__(self):
        self.transports = []
        self.fds = []

    def pty(self):
        """Open a pseudo-terminal; its device name. The board's end is the last of ``fds``."""
        master, slave = os.openpty()
        tty.setraw(slave)
        self.fds += [slave, master]
        return os.ttyname(slave)

    def line(self, number):
        raise NotImplementedError

    def close(self):
        for fd in self.fds:
            os.close(fd)
        self.fds.clear()


class Several(Ends):
    """Two devices, each with a board; both boards have the same address."""

    def __init__(self):
        from uros.agent.transports.multiserial import serial_servers

        super().__init__()
        self.transports = serial_servers([self.pty(), self.pty()])

    def line(self, number):
        return SerialLine(self.fds[2 * number + 1], owned=False)


class Shared(Ends):
    """One line that all clients share."""

    terminal = None

    def line(self, number):
        if self.terminal is None:
            self.terminal = SharedTerminal(self.board())
        return self.terminal.line(number + 1)

    def board(self):
        """The board's fd, after the agent has opened its end: the agent drops earlier input."""
        deadline = time.monotonic() + SECONDS
        while self.transports[0].line.stream is None:
            assert time.monotonic() < deadline, "the agent does not open its line"
            time.sleep(
                0.002
            )  # a poll with a deadline: the thread that opens it notifies only the agent
        return self.fds[1]


class ByPySerial(Shared):
    """A device that the agent opens with pyserial."""

    def __init__(self):
        from uros.agent.transports.portable_serial import PySerialServer

        super().__init__()
        self.transports = [PySerialServer(self.pty())]


class BySocket(Shared):
    """A serial line that another machine serves over TCP."""

    def __init__(self):
        from uros.agent.transports.serial import serial_server

        super().__init__()
        self.listener = socket.create_server(("127.0.0.1", 0))
        port = self.listener.getsockname()[1]
        self.transports = [serial_server(f"socket://127.0.0.1:{port}")]

    def board(self):
        self.listener.settimeout(SECONDS)
        sock = self.listener.accept()[0]
        sock.setblocking(True)
        self.fds.append(sock.detach())
        return self.fds[-1]

    def close(self):
        self.listener.close()
        super().close()


class OverBluetooth(Ends):
    """Boards that connect by RFCOMM: one connection each, the same address on each."""

    def __init__(self):
        from uros.agent.transports.rfcomm import RfcommListener

        super().__init__()
        self.air = Air()
        self.transports = [RfcommListener(3, make=self.air.make)]

    def line(self, number):
        sock = self.air.board(f"AA:BB:CC:DD:EE:{number:02X}", 3)
        self.fds.append(sock.detach())
        return SerialLine(self.fds[-1], owned=False)


def make(kind):
    return {
        "multiserial": Several,
        "pyserial": ByPySerial,
        "socket": BySocket,
        "rfcomm": OverBluetooth,
    }[kind]()
