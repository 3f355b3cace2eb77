"""A hundred boards that connect to a real ``uros agent`` on DDS and leave, for any duration.

    python tests/soak/soak.py [--seconds 3600] [--clients 100] [--seed 1]

The boards are nodes of the client library over UDP, TCP and pseudo-terminals. Each connects,
creates its entities, publishes and receives, and leaves: it closes its session, closes its line
only, stays connected but silent, is reset, or is reset in the middle of a fragmented message. Then
another board takes its slot, as the same client or as a new one. A node on DDS, outside of the
agent, receives the messages of all boards.

It prints a line every 10 s, and at the end one JSON object and the verdict. It fails if the agent
ends or reports an internal error, if a session or descriptor is left after all boards have left, or
if the agent's memory at the end exceeds that at the reference point (after ten minutes, or half of
the time) by more than the tolerance.
"""

from __future__ import annotations

import argparse
import errno
import json
import os
import queue
import random
import re
import select
import signal
import socket
import statistics
import subprocess
import sys
import threading
import time
import tty
from collections import Counter
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
if __name__ == "__main__":
    sys.path[:0] = [str(ROOT / "src")]

import uros  # noqa: E402
from uros.client import AGENT_CONNECTED, Node  # noqa: E402
from uros.interfaces import load  # noqa: E402
from uros.transport.serial import StreamTransport  # noqa: E402
from uros.wire.framing import LengthDeframer  # noqa: E402

Int32, String = load("std_msgs/msg/Int32"), load("std_msgs/msg/String")
Trigger = load("std_srvs/srv/Trigger")

LOOPBACK = (
    '<General><Interfaces><NetworkInterface address="127.0.0.1"/></Interfaces>'
    "<AllowMulticast>false</AllowMulticast></General><Discovery>"
    "<ParticipantIndex>auto</ParticipantIndex>"
    "<MaxAutoParticipantIndex>60</MaxAutoParticipantIndex>"
    '<Peers><Peer Address="127.0.0.1"/></Peers></Discovery>'
)

# The --dead-time of the agent, after which it closes the session of a silent board, in seconds.
DEAD_TIME = 5
LIFE = (8.0, 24.0)
# How a board leaves, and how often in a hundred times.
LEAVES = {"close": 40, "vanish": 20, "silent": 10, "reset": 15, "mid_fragment": 15}
# A board publishes once a second: more would measure the machine.
PERIOD = 1.0
# How long the boards wait for input, in seconds.
TURN = 0.02
LARGE = 3000
# All sessions end within the dead time and the agent's period of checking it.
LEAVING = 4 * DEAD_TIME + 10.0


# --- the boards' lines ---------------------------------------------------------------------


class Line:
    """A board's line that can be cut: ``cut`` more messages are sent, then half of one."""

    mtu = 512

    def __init__(self) -> None:
        self.cut: int | None = None
        self.fd = -1

    def send(self, message, size) -> None:  # type: ignore[no-untyped-def]
        message = bytes(memoryview(message)[:size])
        if self.cut is None:
            self.put(bytes(message))
        elif self.cut > 0:
            self.cut -= 1
            self.put(bytes(message))
        elif self.cut == 0:
            self.cut = -1
            self.put_half(bytes(message))

    def put(self, message: bytes) -> None:
        raise NotImplementedError

    def put_half(self, message: bytes) -> None:
        """Send half of a message: the board is reset meanwhile."""


class UdpLine(Line):
    def __init__(self, port: int) -> None:
        super().__init__()
        self._port = port
        self._socket: socket.socket | None = None

    def open(self) -> None:
        self.close()
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.setblocking(False)
        self._socket.connect(("127.0.0.1", self._port))
        self.fd = self._socket.fileno()

    def close(self) -> None:
        sock, self._socket, self.fd = self._socket, None, -1
        if sock is not None:
            sock.close()

    def put(self, message: bytes) -> None:
        try:
            self._socket.send(message)  # type: ignore[union-attr]
        except OSError:
            pass

    def receive(self, timeout_ms: int) -> bytes | None:
        try:
            return self._socket.recv(65536)  # type: ignore[union-attr]
        except OSError:
            return None


class TcpLine(Line):
    def __init__(self, port: int) -> None:
        super().__init__()
        self._port = port
        self._socket: socket.socket | None = None
        self._deframer = LengthDeframer()
        self._messages: list[bytes] = []

    def open(self) -> None:
        self.close()
        self._socket = socket.create_connection(("127.0.0.1", self._port), 5.0)
        self._socket.setblocking(False)
        self.fd = self._socket.fileno()
        self._deframer = LengthDeframer()
        self._messages.clear()

    def close(self) -> None:
        sock, self._socket, self.fd = self._socket, None, -1
        if sock is not None:
            sock.close()

    def put(self, message: bytes) -> None:
        self._send(len(message).to_bytes(2, "little") + message)

    def put_half(self, message: bytes) -> None:
        self._send((len(message).to_bytes(2, "little") + message)[: len(message) // 2])

    def _send(self, data: bytes) -> None:
        # A partial write means that the buffer is full: the agent has stopped reading.
        if self._socket is None or self._socket.send(data) != len(data):
            raise OSError(errno.EPIPE, "the agent does not read")

    def receive(self, timeout_ms: int) -> bytes | None:
        if not self._messages and self._socket is not None:
            try:
                chunk = self._socket.recv(65536)
            except BlockingIOError:
                return None
            if not chunk:
                raise OSError(errno.EPIPE, "the agent has closed the connection")
            self._messages = self._deframer.feed(chunk)
        return self._messages.pop(0) if self._messages else None


class _Port:
    """The board's end of a terminal."""

    def __init__(self, fd: int) -> None:
        self.fd = fd

    def read(self, size: int) -> bytes | None:
        try:
            return os.read(self.fd, size)
        except BlockingIOError:
            return None

    def write(self, data) -> int:  # type: ignore[no-untyped-def]
        try:
            return os.write(self.fd, data)
        except BlockingIOError:
            return 0


class PtyLine(Line):
    """A serial line, which stays open when its board is reset."""

    def __init__(self, fd: int) -> None:
        super().__init__()
        self.fd = fd
        self._stream = StreamTransport(_Port(fd))

    def open(self) -> None:
        self._stream.open()

    def close(self) -> None:
        self._stream.close()

    def put(self, message: bytes) -> None:
        self._stream.send(message)

    def put_half(self, message: bytes) -> None:
        os.write(self.fd, b"\x7e\x01\x00" + message[: len(message) // 2])

    def receive(self, timeout_ms: int) -> bytes | None:
        return self._stream.receive(0)


# --- the boards --------------------------------------------------------------------------------


class Board:
    """A slot for boards: when one has left, the next one begins."""

    def __init__(self, soak: Soak, slot: int, kind: str, fd: int = -1) -> None:
        self._soak = soak
        self._slot = slot
        self._kind = kind
        self._fd = fd
        self._random = random.Random(soak.seed * 1000 + slot)
        self._key = 0
        self._life = 0
        self.node: Node | None = None
        self.line: Line = Line()
        # The first boards begin within 5 s, not all at once.
        self._next_life = time.monotonic() + self._random.random() * 5
        self._ends = self._next_publish = 0.0
        self._leaves = ""
        self._connected = False

    def begin(self, now: float) -> None:
        soak, chance = self._soak, self._random
        self._life += 1
        soak.count["lives"] += 1
        if not self._key:
            self._key = chance.getrandbits(31) + 1
        self.line = {
            "udp": lambda: UdpLine(soak.udp_port),
            "tcp": lambda: TcpLine(soak.tcp_port),
            "pty": lambda: PtyLine(self._fd),
        }[self._kind]()
        node = self.node = Node(f"board_{self._slot}", self.line, "soak", soak.domain, self._key)
        own = f"own_{self._slot}_{self._life % 5}"
        self._all = node.create_publisher(String, "all")
        self._own = node.create_publisher(Int32, own)
        node.create_subscription(Int32, own, self._on_own)
        node.create_subscription(Int32, "orders", self._on_order)
        if chance.random() < 0.2:
            node.create_service(Trigger, f"service_{self._slot}", lambda request, response: None)
        self._leaves = chance.choices(list(LEAVES), list(LEAVES.values()))[0]
        self._ends = now + chance.uniform(*LIFE)
        self._next_publish = now + chance.random()
        self._connected = False

    def _on_own(self, message) -> None:  # type: ignore[no-untyped-def]
        self._soak.count["heard"] += 1

    def _on_order(self, message) -> None:  # type: ignore[no-untyped-def]
        self._soak.count["orders"] += 1

    def turn(self, now: float) -> None:
        if self.node is None:
            if now >= self._next_life and not self._soak.leaving:
                self.begin(now)
            return
        if now >= self._ends or self._soak.leaving:
            self.leave(now)
            return
        self.node.spin_once(0)
        if self.node.state != AGENT_CONNECTED:
            return
        if not self._connected:
            self._connected = True
            self._soak.count["connected"] += 1
            self._soak.count[self._kind] += 1
        if now >= self._next_publish:
            self._next_publish = now + PERIOD
            self._own.publish(Int32(data=self._life))
            self._all.publish(String(data=f"board {self._slot}, life {self._life}"))
            self._soak.count["published"] += 2

    def leave(self, now: float) -> None:
        node, self.node = self.node, None
        way = "close" if self._leaves == "silent" and self._kind == "pty" else self._leaves
        self._soak.count[way] += 1
        assert node is not None
        if way == "close":
            node.destroy_node()
            self._key = 0
        elif way == "silent":
            self._soak.silent.append((now + 2 * DEAD_TIME, self.line))
            self._key = 0
        else:
            if way == "mid_fragment" and node.state == AGENT_CONNECTED:
                self.line.cut = self._random.randrange(1, LARGE // self.line.mtu)
                self._all.publish(String(data="x" * LARGE))
                for _ in range(3):
                    node.spin_once(0)
            if way == "vanish":
                self._key = 0
            self.line.close()
        self._next_life = now + self._random.uniform(0.1, 2.0)


# --- the agent process ---------------------------------------------------------------------


class AgentProcess:
    """A process of ``uros agent``, its log, and its use of memory, CPU and descriptors."""

    def __init__(
        self, devices: list[str], domain: int, middleware: str, arguments: list[str]
    ) -> None:
        command = [
            *(arguments or [sys.executable, "-m", "uros"]), "agent",
            "udp4", "-p", "0", "tcp4", "-p", "0", "multiserial", "-D", *devices,
            "-m", middleware, "--domain", str(domain), "--dead-time", str(DEAD_TIME),
            "--stop-at-eof",  # it ends with this process in any case
        ]  # fmt: skip
        self.events: Counter[str] = Counter()
        self.complaints: list[str] = []
        self.ports: queue.Queue[tuple[str, int]] = queue.Queue()
        environment = dict(os.environ, PYTHONPATH=str(ROOT / "src"), PYTHONUNBUFFERED="1")
        self.process = subprocess.Popen(
            command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.STDOUT,
            text=True, errors="replace", env=environment, start_new_session=True,
        )  # fmt: skip
        self._folder = Path(f"/proc/{self.process.pid}")
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()

    def _read(self) -> None:
        assert self.process.stdout is not None
        for line in self.process.stdout:
            parts = [field.strip() for field in line.split("|")]
            if len(parts) < 5:
                self.complaints.append(line.rstrip())
                continue
            _, part, _, event, about = parts[:5]
            if event == "running..." and (port := re.fullmatch(r"port: (\d+)", about)):
                self.ports.put((part, int(port[1])))
            if part == "Root" and event in ("create", "delete"):
                self.events[event] += 1
            if event == "internal error" or "traceback" in line.lower():
                self.complaints.append(line.rstrip())

    def wait_for_ports(self) -> dict[str, int]:
        ports: dict[str, int] = {}
        end = time.monotonic() + 20
        while len(ports) < 2:
            try:
                name, port = self.ports.get(timeout=0.1)
            except queue.Empty:
                if self.ended or time.monotonic() > end:
                    raise SystemExit(f"soak: the agent does not start: {self.complaints}") from None
                continue
            ports[name] = port
        return ports

    def sessions(self) -> int:
        """The number of sessions, by the agent's log."""
        return self.events["create"] - self.events["delete"]

    def clients(self) -> int:
        """The number of sessions, by the agent's status."""
        from uros.tools.agent.running_agents import ask, find_agent

        return len(ask(find_agent(self.process.pid), "status")["clients"])

    def resident(self) -> float:
        """The resident memory in megabytes."""
        pages = int((self._folder / "statm").read_text().split()[1])
        return pages * os.sysconf("SC_PAGE_SIZE") / 1e6

    def descriptors(self) -> int:
        return len(os.listdir(self._folder / "fd"))

    def cpu(self) -> float:
        """The CPU time in seconds."""
        parts = (self._folder / "stat").read_text().rsplit(")", 1)[1].split()
        return (int(parts[11]) + int(parts[12])) / os.sysconf("SC_CLK_TCK")

    @property
    def ended(self) -> bool:
        return self.process.poll() is not None

    def stop(self) -> int:
        """End the process; its exit status. Idempotent."""
        process = self.process
        assert process.stdin is not None and process.stdout is not None
        if not self.ended:
            process.send_signal(signal.SIGTERM)
        try:
            process.wait(20)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()
        process.stdin.close()
        self._reader.join(5)
        process.stdout.close()
        return process.returncode


class Soak:
    """A soak; see the module. ``agent`` is the command in place of ``python -m uros``."""

    def __init__(
        self, seconds: float, clients: int, seed: int, domain: int, tolerance: float,
        agent: list[str] | None = None, quiet: bool = False, middleware: str = "dds",
    ) -> None:  # fmt: skip
        self.middleware = middleware
        self.seconds = seconds
        self.clients = clients
        self.seed = seed
        self.domain = domain
        self.tolerance = tolerance
        self.leaving = False
        self.count: Counter[str] = Counter()
        self.silent: list[tuple[float, Line]] = []
        self._agent_command = agent or []
        self._quiet = quiet
        self._memory: list[tuple[float, float]] = []
        self.curve: list[tuple[int, float]] = []  # (seconds, megabytes), every 10 s
        self.reference = min(600.0, seconds / 2)
        self._window = min(60.0, seconds / 6)

    def run(self) -> dict:
        terminals = [os.openpty() for _ in range(self.clients // 5)]
        for master, slave in terminals:
            tty.setraw(slave)
            os.set_blocking(master, False)
        agent = AgentProcess(
            [os.ttyname(slave) for _, slave in terminals], self.domain, self.middleware,
            self._agent_command,
        )  # fmt: skip
        try:
            ports = agent.wait_for_ports()
            self.udp_port, self.tcp_port = ports["UDPv4Agent"], ports["TCPv4Agent"]
            return self._with(agent, [master for master, _ in terminals])
        finally:
            agent.stop()
            for master, slave in terminals:
                os.close(master)
                os.close(slave)

    def _with(self, agent: AgentProcess, masters: list[int]) -> dict:
        from uros.host.direct import Direct
        from uros.middleware import open_middleware

        kinds = ["pty"] * len(masters)
        kinds += [("udp", "tcp")[number % 2] for number in range(self.clients - len(kinds))]
        boards = [
            Board(self, slot, kind, masters[slot] if slot < len(masters) else -1)
            for slot, kind in enumerate(kinds)
        ]
        network = Direct(open_middleware("dds"), self.domain)
        outside = uros.Node("listener", network, "soak", self.domain)
        outside.create_subscription(String, "all", lambda message: self._outside())
        orders = outside.create_publisher(Int32, "orders")
        # The descriptors that DDS opens for its first node stay open.
        self._visit(agent)
        descriptors = agent.descriptors()
        began = time.monotonic()
        failed, left = "", self.clients
        printed = sampled = ordered = began
        try:
            while not failed and time.monotonic() < began + self.seconds:
                now = time.monotonic()
                self._turn(boards, outside, now)
                if now >= ordered:
                    ordered = now + 2 * PERIOD
                    orders.publish(Int32(data=int(now)))
                if now >= sampled:
                    sampled = now + 1.0
                    failed = self._check(agent, now - began)
                if now >= printed:
                    printed = now + 10.0
                    self._print_line(agent, now - began)
            cores = agent.cpu() / (time.monotonic() - began) if not agent.ended else 0.0
            self.leaving = True
            end = time.monotonic() + LEAVING
            left, next_status = self.clients, 0.0
            while not failed and (left or agent.descriptors() > descriptors):
                now = time.monotonic()
                if left and now >= next_status:
                    left, next_status = agent.clients(), now + 1.0
                if now >= end:
                    failed = "not all is left"
                self._turn(boards, outside, now)
                failed = failed or self._check(agent, -1)
        finally:
            outside.destroy_node()
            for _, line in self.silent:
                line.close()
        return self._verdict(agent, failed, descriptors, left, cores)

    def _visit(self, agent: AgentProcess) -> None:
        """Connect one board and close its session."""
        node = Node("visitor", UdpLine(self.udp_port), "soak", self.domain)
        node.create_publisher(String, "all")
        end = time.monotonic() + 20
        while node.state != AGENT_CONNECTED and time.monotonic() < end:
            node.spin_once(0.01)
        node.destroy_node()
        while agent.events["delete"] < 1 and time.monotonic() < end:
            select.select([], [], [], 0.01)

    def _outside(self) -> None:
        self.count["outside"] += 1

    def _turn(self, boards: list[Board], outside: Node, now: float) -> None:
        """Wait for input for at most TURN, and let all boards work."""
        lines = [board.line.fd for board in boards if board.node is not None and board.line.fd >= 0]
        ready = set(select.select(lines, [], [], TURN)[0])
        slice_ = int(now / TURN) % 4
        for number, board in enumerate(boards):
            # A board without input has its turn in every fourth call.
            if board.line.fd in ready or number % 4 == slice_:
                board.turn(now)
        while self.silent and self.silent[0][0] <= now:
            self.silent.pop(0)[1].close()
        outside.spin_once(0)

    def _check(self, agent: AgentProcess, seconds: float) -> str:
        """Check the agent; the fault, or an empty text."""
        if agent.ended:
            return f"the agent ended with status {agent.process.returncode}"
        if agent.complaints:
            return f"the agent said: {agent.complaints[0]}"
        if seconds >= 0:
            self._memory.append((seconds, agent.resident()))
        return ""

    def _print_line(self, agent: AgentProcess, seconds: float) -> None:
        if agent.ended:
            return
        self.curve.append((int(seconds), round(agent.resident(), 1)))
        if not self._quiet:
            print(
                f"soak: {seconds:5.0f} s, {self.curve[-1][1]:.1f} MB, {agent.sessions()} sessions,"
                f" {agent.descriptors()} descriptors, {self.count['lives']} lives,"
                f" {self.count['published']} published, {self.count['heard']} heard,"
                f" {self.count['outside']} outside",
                flush=True,
            )

    def _median(self, end: float) -> float:
        samples = [mb for at, mb in self._memory if end - self._window <= at <= end]
        return statistics.median(samples) if samples else 0.0

    def _verdict(
        self, agent: AgentProcess, failed: str, descriptors: int, left: int, cores: float
    ) -> dict:
        reference, end = self._median(self.reference), self._median(self.seconds)
        growth = (end / reference - 1) * 100 if reference else 0.0
        at_end = 0 if agent.ended else agent.descriptors()
        alive = not agent.ended
        status = agent.stop()
        wrong = [failed] if failed else []
        if left:
            wrong.append(f"{left} sessions are left")
        if alive and at_end > descriptors:
            wrong.append(f"{at_end} descriptors are open, {descriptors} at the beginning")
        if growth > self.tolerance:
            wrong.append(f"memory grew by {growth:.1f} %, over {self.tolerance:g} %")
        if alive and status:
            wrong.append(f"the agent ended with status {status}")
        if agent.complaints and not failed:
            wrong.append(f"the agent said: {agent.complaints[0]}")
        # Every kind of event must have happened.
        outside = () if self.middleware == "memory" else ("outside", "orders")
        for name in ("heard", "udp", "tcp", "pty", *outside):
            if not self.count[name]:
                wrong.append(f"nothing was counted as {name}")
        if self.count["connected"] < 0.8 * self.count["lives"]:
            wrong.append(f"only {self.count['connected']} of the boards came to work")
        return {
            "seconds": self.seconds,
            "clients": self.clients,
            "seed": self.seed,
            "counts": dict(sorted(self.count.items())),
            "memory_mb": {"reference": round(reference, 1), "end": round(end, 1)},
            "growth_percent": round(growth, 2),
            "curve_mb": self.curve,
            "sessions_left": left,
            "descriptors": {"begin": descriptors, "end": at_end},
            "agent_cores": round(cores, 3),
            "wrong": wrong,
            "verdict": "FAILED" if wrong else "passed",
        }


def main() -> int:
    parser = argparse.ArgumentParser(description="Boards that come and go for a long time.")
    parser.add_argument("--seconds", type=float, default=3600.0, help="how long (3600)")
    parser.add_argument("--clients", type=int, default=100, help="how many boards (100)")
    parser.add_argument("--seed", type=int, default=1, help="of all that is left to chance (1)")
    parser.add_argument("--domain", type=int, default=101, help="ROS domain to use (101)")
    parser.add_argument("--tolerance", type=float, default=3.0, help="growth allowed, %% (3)")
    parser.add_argument("--middleware", default="dds", help="of the agent (dds)")
    parser.add_argument("--agent", nargs="+", metavar="WORD", help="instead of python -m uros")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the result there too")
    options = parser.parse_args()
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(143))
    os.environ["CYCLONEDDS_URI"] = LOOPBACK
    soak = Soak(
        options.seconds, options.clients, options.seed, options.domain, options.tolerance,
        options.agent, middleware=options.middleware,
    )  # fmt: skip
    result = soak.run()
    print(json.dumps(result))
    if options.json:
        options.json.write_text(json.dumps(result, indent=1) + "\n")
    print(f"soak: {result['verdict']}" + "".join(f"; {fault}" for fault in result["wrong"]))
    return 1 if result["wrong"] else 0


if __name__ == "__main__":
    sys.exit(main())
