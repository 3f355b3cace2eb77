"""The kinds of serial lines besides a device and a pseudo-terminal, for RunningAgent."""

import os
import socket
import time
import tty

from support.bluetooth import Air
from support.lines import SECONDS, SerialLine, SharedTerminal

KINDS = ("multiserial", "pyserial", "socket", "rfcomm")


class Ends:
    """``transports`` are the agent's ends, ``line(n)`` the n-th client's."""

    def __init__(self):
        self.transports = []
        self.fds = []

    def pty(self):
        """A device's name; the board's end of it is the last of ``fds``."""
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
    """Two devices, and a board with the same address on each."""

    def __init__(self):
        from uros.agent.transports.multiserial import serial_servers

        super().__init__()
        self.transports = serial_servers([self.pty(), self.pty()])

    def line(self, number):
        return SerialLine(self.fds[2 * number + 1], owned=False)


class Shared(Ends):
    """A line that all clients share."""

    terminal = None

    def line(self, number):
        if self.terminal is None:
            self.terminal = SharedTerminal(self.board())
        return self.terminal.line(number + 1)

    def board(self):
        """The fd, once the agent has opened its end: it drops what came before."""
        deadline = time.monotonic() + SECONDS
        while self.transports[0].line.stream is None:
            assert time.monotonic() < deadline, "the agent does not open its line"
            time.sleep(0.002)  # a poll with a deadline: a thread opens, and tells only the agent
        return self.fds[1]


class ByPySerial(Shared):
    def __init__(self):
        from uros.agent.transports.portable_serial import PySerialServer

        super().__init__()
        self.transports = [PySerialServer(self.pty())]


class BySocket(Shared):
    """A line that another machine offers by TCP."""

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
    """Boards that connect, each on a connection of its own and with the same address there."""

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
