"""CAN buses for tests, with an agent and boards: python-can's virtual bus and a fake SocketCAN.

On the fake one, python-can's SocketCAN code sends and receives the kernel's frames as bytes. A pair
of UDP sockets takes the place of the kernel: its datagrams and time stamps are the same. The frames
are packed by hand here, after struct canfd_frame in linux/can.h.
"""

import itertools
import os
import socket
import struct
import time
from unittest.mock import patch

import can

from support.lines import Line
from uros.agent.transports.can import CanServer

FRAME = struct.Struct("=IBB2x64s")
EXTENDED, REMOTE, ERROR = 0x80000000, 0x40000000, 0x20000000
FDF = 4
_count = itertools.count()


def virtual():
    """An agent's end on a new virtual bus."""
    return CanServer(f"uros-{os.getpid()}-{next(_count)}", "virtual")


class VirtualLine(Line):
    """A board on the bus of a server from :func:`virtual`."""

    mtu = 63

    def __init__(self, channel, can_id):
        super().__init__(-1)
        self.can_id = can_id
        self.bus = can.Bus(channel, interface="virtual", fd=True)

    def send(self, message):
        self.send_raw(bytes([len(message)]) + message)

    def send_raw(self, data):
        """Send frames of at most 64 bytes."""
        for at in range(0, len(data), 64):
            self.frame(data[at : at + 64])

    def frame(self, data, can_id=None, **options):
        options = {"is_extended_id": True, "is_fd": True} | options
        can_id = self.can_id if can_id is None else can_id
        self.bus.send(can.Message(arbitration_id=can_id, data=data, check=False, **options))

    def receive(self, deadline):
        while (message := self.bus.recv(max(0.0, deadline - time.monotonic()))) is not None:
            if message.arbitration_id == self.can_id and message.is_extended_id:
                return bytes(message.data[1 : message.data[0] + 1])
        return None

    def close(self):
        self.bus.shutdown()


class KernelCan(CanServer):
    """An agent's end on the fake SocketCAN; ``bus`` is the boards' end."""

    def __init__(self, device="can0"):
        super().__init__(device)
        self.bus = self.missing = None

    def _make(self):
        if self.missing is not None:
            raise self.missing
        if self.bus is not None:
            self.bus.close()
        ours, self.bus = pair()
        module = "can.interfaces.socketcan.socketcan."
        with (
            patch("uros.agent.transports.can.check_socketcan"),
            patch(module + "create_socket", lambda: ours),
            patch(module + "bind_socket"),
        ):
            return super()._make()

    def close(self):
        super().close()
        if self.bus is not None:
            self.bus.close()


class _Socket(socket.socket):
    def setsockopt(self, level, *rest):
        if level != 101:  # SOL_CAN_RAW: accepted, as by the kernel
            super().setsockopt(level, *rest)


def pair():
    """Two UDP sockets connected to each other."""
    ends = [_Socket(socket.AF_INET, socket.SOCK_DGRAM) for _ in range(2)]
    for end in ends:
        end.bind(("127.0.0.1", 0))
        end.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4 << 20)
    for end, peer in (ends, ends[::-1]):
        end.connect(peer.getsockname())
    return ends


class KernelLine(Line):
    """A board on the bus of a KernelCan; ``others`` are the lines on it."""

    mtu = 63

    def __init__(self, server, can_id, others):
        super().__init__(server.bus.fileno())
        self.server = server
        self.can_id = can_id
        self.others = others

    def send(self, message):
        self.send_raw(bytes([len(message)]) + message)

    def send_raw(self, data):
        for at in range(0, len(data), 64):
            self.frame(data[at : at + 64])

    def frame(self, data, can_id=None):
        can_id = self.can_id | EXTENDED if can_id is None else can_id
        self.server.bus.send(FRAME.pack(can_id, len(data), FDF, data))

    def _read(self):
        can_id, size, _, data = FRAME.unpack(self.server.bus.recv(100))
        for line in self.others:
            if can_id == line.can_id | EXTENDED and line is not self:
                line._messages.append(data[1 : data[0] + 1])
        return [data[1 : data[0] + 1]] if can_id == self.can_id | EXTENDED else []

    def close(self):
        """Nothing to close: the server closes the bus."""
