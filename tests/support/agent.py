"""The agent of uros in a thread, on one transport and one middleware."""

import io
import os
import threading
import tty
from contextlib import contextmanager

from support import serials
from support.lines import SECONDS, SerialLine, SharedTerminal, TcpLine, TlsLine, UdpLine
from support.waiting import eventually
from uros.agent.agent import Agent
from uros.agent.log import Log
from uros.agent.observability.snapshot import snapshot
from uros.agent.server import Server
from uros.middleware import open_middleware

TRANSPORTS = (
    "udp", "tcp", "udp6", "tcp6", "tls", "serial", "pseudoterminal", *serials.KINDS,
    "can", "socketcan", "custom", "custom-framed",
)  # fmt: skip


class RunningAgent:
    """An agent in a thread. ``line(n)`` opens the line of the n-th client; ``lines`` has them all.

    ``transport`` is one of TRANSPORTS, or a transport of the test's own, which provides the lines.
    """

    def __init__(self, transport, middleware, domain, level, device=None, baud=115200):
        own = not isinstance(transport, str)
        self.kind = "own" if own else transport
        self.said = io.StringIO()
        self.middleware = open_middleware(middleware)
        self.agent = Agent(self.middleware, Log(level, self.said), domain_override=domain)
        self._master = self._slave = -1
        self._device = device
        self._baud = baud
        self._ends = serials.make(self.kind) if self.kind in serials.KINDS else None
        if self._ends:
            transports = self._ends.transports
        else:
            transports = [transport if own else self._make(transport)]
        self.transport = transports[0]
        self.server = Server(self.agent, transports)
        self.error = None
        self.thread = threading.Thread(target=self._run, name="agent", daemon=True)
        self.lines = []
        self._terminal = None

    def _make(self, kind):
        loopback = "::1" if kind.endswith("6") else "127.0.0.1"
        if kind in ("udp", "udp6"):
            from uros.agent.transports.udp import UdpServer

            return UdpServer(0, loopback)
        if kind in ("tcp", "tcp6"):
            from uros.agent.transports.tcp import TcpServer

            return TcpServer(0, loopback)
        if kind == "tls":
            from support.certificates import own_certificates
            from uros.agent.transports.tls import TlsServer

            return TlsServer(0, "127.0.0.1", own_certificates())
        if kind == "memory":  # boards connect by transport.connect()
            from uros.agent.transports.memory import MemoryServer

            return MemoryServer()
        if kind in ("can", "socketcan"):
            from support import can

            return can.virtual() if kind == "can" else can.KernelCan()
        if kind in ("custom", "custom-framed"):
            from support import custom
            from uros.agent.transports.custom import CustomServer

            self._custom = custom.Datagrams() if kind == "custom" else custom.Stream()
            return CustomServer(self._custom)
        from uros.agent.transports.serial import PseudoTerminalServer, SerialServer

        if kind == "pseudoterminal":
            return PseudoTerminalServer()
        if self._device is not None:
            return SerialServer(str(self._device), self._baud)
        self._master, self._slave = os.openpty()
        tty.setraw(self._slave)
        return SerialServer(os.ttyname(self._slave))

    def _run(self):
        try:
            self.server.run()
        except BaseException as error:
            self.error = error

    def start(self):
        """Start the thread and wait until the agent serves."""
        self.thread.start()
        assert self.server.ready.wait(SECONDS)

    def line(self, number=0):
        """Open the line of the n-th client. Serial clients share one, with addresses from 1."""
        if self.kind in ("udp", "udp6"):
            line = UdpLine(self.transport.port, self.transport.listens_on)
        elif self.kind in ("tcp", "tcp6"):
            line = TcpLine(self.transport.port, self.transport.listens_on)
        elif self.kind == "tls":
            from support.certificates import authority

            line = TlsLine(self.transport.port, authority().client())
        elif self._ends is not None:
            line = self._ends.line(number)
        elif self.kind == "can":
            from support.can import VirtualLine

            line = VirtualLine(self.transport._device, 0x100 + number)
        elif self.kind == "socketcan":
            from support.can import KernelLine

            line = KernelLine(self.transport, 0x100 + number, self.lines)
        elif self.kind == "custom":
            line = UdpLine(self._custom_port())
        else:
            if self._terminal is None:
                fd = self._master
                if self.kind == "custom-framed":
                    fd = self._custom.theirs.fileno()
                if self.kind == "pseudoterminal":
                    fd = os.open(self.transport.device, os.O_RDWR | os.O_NOCTTY)
                    self._slave = fd
                self._terminal = SharedTerminal(fd)
            line = self._terminal.line(number + 1)
        self.lines.append(line)
        return line

    def _custom_port(self):
        """The port, once the transport's thread has opened it."""
        eventually(lambda: self._custom.port)
        return self._custom.port

    def snapshot(self):
        """The agent's current snapshot, as ``uros agent status`` gets it."""
        snapshots, ready = [], threading.Event()

        def make():
            try:
                snapshots.append(snapshot(self.server))
            finally:
                ready.set()

        self.server.soon(make)
        assert ready.wait(SECONDS)
        return snapshots[0]

    def stop(self):
        self.server.stop()
        self.thread.join(SECONDS)

    def close(self):
        self.stop()
        for line in self.lines:
            line.close()
        if self._ends is not None:
            self._ends.close()
        for fd in (self._master, self._slave):
            if fd >= 0:
                os.close(fd)
        self._master = self._slave = -1
        if self.kind == "custom-framed":
            self._custom.end()


@contextmanager
def running_agent(transport="udp", middleware="dds", domain=0, level=4, device=None, baud=115200):
    """Run an agent until the end of the block; raise the error with which it failed.

    ``device`` is the serial line of a running board, and ``baud`` its rate; without it, "serial"
    opens a pseudo-terminal.
    """
    with serving(RunningAgent(transport, middleware, domain, level, device, baud)) as running:
        yield running


@contextmanager
def serving(running):
    """Run this agent until the end of the block; raise the error with which it failed."""
    running.start()
    try:
        yield running
    finally:
        running.close()
    assert not running.thread.is_alive(), "the agent does not end"
    if running.error is not None:
        raise running.error
    log = running.said.getvalue()
    assert "internal error" not in log, log


__all__ = ["TRANSPORTS", "RunningAgent", "SerialLine", "running_agent"]
