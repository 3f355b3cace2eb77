"""Measures heap and speed of programs on MicroPython, for tests/mpy and bench/board.py."""

import tempfile
import time
from collections.abc import Iterable, Mapping
from pathlib import Path
from statistics import median

from mpy.harness import ROOT, MicroPython, tree
from support.agent import running_agent

from uros.boards.builder.file_system import build
from uros.boards.virtual.engine.runner import RunningBoard


def heap_of(
    board: MicroPython, files: Mapping[str, str | bytes], statements: Iterable[str]
) -> dict[str, int]:
    """Return the bytes that each statement, in order, leaves on the heap of a board.

    MicroPython stores names in tables that double in size, so one more name may cost a kilobyte or
    two, and many names nothing: compare sums, not single statements.
    """
    board.install(files)
    board.run("import array, errno, gc, os, select, struct, sys, time")
    board.heap()
    last = board.heap()
    costs = {}
    for statement in statements:
        board.run(statement)
        now = board.heap()
        costs[statement] = now - last
        last = now
    return costs


# All that a node can do, without a transport: the client, and the parts of wire that it needs.
CORE = """
from uros.client import Node

def run(transport):
    node = Node("node", transport)
    publisher = node.create_publisher(None, "topic", 10)
    publisher.publish(None)
    node.create_subscription(None, "topic", print, 10)
    node.create_service(None, "service", print)
    client = node.create_client(None, "service")
    future = client.call_async(None)
    future.add_done_callback(print)
    node.spin_until_future_complete(future)
    timer = node.create_timer(1.0, print)
    timer.cancel()
    timer.reset()
    node.clock.stamp(None)
    node.on_state = print
    print(future.done(), future.result(), future.exception(), node.state)
    node.spin()
    node.destroy_node()
"""
# The entities of a sensor's program, and a serial line.
SENSOR = """
from uros.client import Node
from uros.transport.serial import StreamTransport

def run(port):
    node = Node("node", StreamTransport(port))
    publisher = node.create_publisher(None, "topic", 10)
    node.create_timer(1.0, lambda: publisher.publish(None))
    node.spin()
"""
# A type that the program publishes and receives: its cost is the difference to the core.
TYPED = """
from {module} import {name}

def use(message, buf):
    message.pack_into(buf, 0, message.cdr_size())
    message.unpack_from(buf, 0, 0, 0)
    return {name}()
"""


def built(program: str, form: str = "mpy") -> dict[str, bytes]:
    """Return the file system that the build makes of a main.py."""
    with tempfile.TemporaryDirectory() as folder:
        Path(folder, "program").mkdir()
        Path(folder, "program", "main.py").write_text(program, encoding="utf-8")
        build(Path(folder, "program"), Path(folder, "out"), form)
        return tree(Path(folder, "out"))


def heap_of_program(board: MicroPython, program: str, form: str = "mpy") -> int:
    """Return the heap that the modules of uros in a program take, without the program itself."""
    files = built(program, form)
    names = ["uros._all"]
    if form == "py":
        names = [
            name
            for name in ("uros.client", "uros.transport.serial")
            if name.replace(".", "/") + ".py" in files
            or name.replace(".", "/") + "/__init__.py" in files
        ]
    return sum(heap_of(board, files, [f"import {name}" for name in names]).values())


# Less than a window of samples is published, or only encoded, and then acknowledged. Measured is
# processor time, which does not depend on the load of the machine.
_TWIST = """
import js
connection = node.connection

def publishing():
    for _ in range(14):
        twists.publish(twist)

def encoding():
    for _ in range(14):
        twist.pack_into(buf, 0, 0)

def neither():
    for _ in range(14):
        pass

class Nothing:
    mtu = 512
    def send(self, buf, size):
        pass

def timed(function):
    nothing = Nothing()
    total = 0
    for _ in range(40):
        connection.transport = nothing
        before = js.process.cpuUsage().user
        function()
        total += js.process.cpuUsage().user - before
        connection.transport = line
        line.last = connection.next - 1
        line.news = True
        connection.pump(0)
    return total
"""


# A node that connects to a fake agent; after that its line accepts all data and allocates nothing.
# `again` runs turns of a program: each one stamps and publishes a message; every other turn spins,
# and the agent acknowledges.
_RUNNING = (
    """
import gc, time
from sensor_msgs.msg import Temperature
from geometry_msgs.msg import Twist
from std_msgs.msg import String
from sensor_msgs.msg import CompressedImage
from uros.client.streaming import publish_stream, streaming
from support.board import KEY, FakeAgent
from uros.client import AGENT_CONNECTED, Node
from uros.client.clock import Clock

class Line:
    '''Passes messages to the agent until ``quiet``, then acknowledges without allocation.'''

    mtu = 512

    def __init__(self, agent):
        self.agent = agent
        self.bytes = self.count = 0
        self.quiet = False
        self.acknack = bytearray(b"\\x81\\0\\0\\0\\x0a\\1\\5\\0\\0\\0\\0\\0\\x80")
        self.news = False

    def open(self):
        self.agent.open()

    def close(self):
        self.agent.close()

    def send(self, buf, size):
        if not self.quiet:
            self.agent.send(buf, size)
        elif buf[1] == 0x80:
            self.last = buf[2] | buf[3] << 8
            self.count += 1
            self.bytes += size
            self.news = True

    def receive(self, timeout_ms):
        if not self.quiet:
            return self.agent.receive(timeout_ms)
        if self.news:
            self.news = False
            acked = (self.last + 1) & 0xFFFF
            self.acknack[8] = acked & 0xFF
            self.acknack[9] = acked >> 8
            return self.acknack

class RealClock(Clock):
    t = property(lambda self: self.us(), lambda self, value: None)

line = Line(None)
agent = line.agent = FakeAgent(RealClock())
node = Node("node", line, key=KEY, limit=32768)
publisher = node.create_publisher(Temperature, "temperature")
strings = node.create_publisher(String, "text")
images = node.create_publisher(CompressedImage, "image")
twists = node.create_publisher(Twist, "twist")
node.create_timer(3600.0, print)
while node.state != AGENT_CONNECTED:
    node.spin_once(0.01)
message = Temperature(temperature=21.5, variance=0.25)
message.header.frame_id = "room"
twist = Twist()
stamp = message.header.stamp
buf = bytearray(100)
line.quiet = True

def again(times):
    '''Run turns of a program; return how many samples were accepted.'''
    done = 0
    while times:
        times -= 1
        node.clock.stamp(stamp)
        if publisher.publish(message):
            done += 1
        if times & 1:
            node.spin_once(0)
    return done

text = String()

def soak(first, times):
    '''Publish texts of changing length, some fragmented; return how many were accepted.'''
    done = 0
    for i in range(first, first + times):
        text.data = chr(97 + i % 26) * (i * 7 % 600)
        done += strings.publish(text)
        node.spin_once(0)
    return done

class Camera:
    '''Fills every buffer completely.'''

    def readinto(self, view):
        for i in range(0, len(view), 16):
            view[i] = i & 0xFF
        return len(view)

def snap(length):
    return publish_stream(images, CompressedImage(format="jpeg"), length, Camera())

def spinning(times):
    '''Spin; return whether the stream goes on, and the bytes in use on the heap.'''
    for _ in range(times):
        node.spin_once(0)
    return streaming(images), gc.mem_alloc()

def oom_count():
    return node.connection.oom_count

def stamped():
    return message.header.stamp.sec // 1000
"""
    + _TWIST
)


def running(board: MicroPython, form: str = "mpy") -> None:
    """Build the node, and run it until it is connected; `again` and the rest are in __main__."""
    with tempfile.TemporaryDirectory() as folder:
        program = Path(folder, "program")
        (program / "support").mkdir(parents=True)
        for name in ("__init__", "board", "conversation"):
            text = (ROOT / "tests" / "support" / f"{name}.py").read_text(encoding="utf-8")
            (program / "support" / f"{name}.py").write_text(text, encoding="utf-8")
        (program / "main.py").write_text("import running\n", encoding="utf-8")
        (program / "running.py").write_text(_RUNNING, encoding="utf-8")
        build(program, Path(folder, "out"), form)
        board.install(tree(Path(folder, "out")))
    board.run("from running import *\nimport running")


def publish_allocates(board: MicroPython, turns: int = 100) -> int:
    """Return the bytes that a turn of the running node allocates, on the average of ``turns``."""
    board.run("again(40)\ngc.disable()")
    out = board.run(
        f"before = gc.mem_alloc()\nagain({turns})\nafter = gc.mem_alloc()\n"
        "again(0)\nnothing = gc.mem_alloc()\nprint(after - before - (nothing - after))"
    )
    board.run("gc.enable()")
    return max(0, round(int(out) / turns))


def twist_ratio(board: MicroPython) -> float:
    """Return the ratio of the times to publish and to encode a Twist: medians of 60 turns."""
    board.run("again(40)\ntimed(publishing), timed(encoding)")
    turns = []
    for _ in range(60):
        out = board.run("print(timed(neither), timed(publishing), timed(encoding))")
        turns.append(tuple(map(int, out.split())))
    neither, publishing, encoding = (median(turn[i] for turn in turns) for i in range(3))
    return (publishing - neither) / (encoding - neither)


def heap_of_the_sensor_node() -> tuple[int, int]:
    """The RA6M5 node on its virtual board, with an agent: (octets in use, high water).

    The high water counts the start and publishing. While the node connects, the garbage of a step
    depends on how many answers of the agent come in it; the engine collects between steps alone.

    Raises:
        TimeoutError: The board did not connect in 30 s.
    """
    with (
        tempfile.TemporaryDirectory() as folder,
        RunningBoard(
            "ra6m5_sensor_node", engine="micropython", form="mpy", link=Path(folder, "tty"),
            reads=True, measure=True,
        ) as board,
    ):  # fmt: skip
        start = board.heap()
        with running_agent("serial", "memory", device=board.path) as agent:
            deadline = time.monotonic() + 30
            while agent.said.getvalue().count("datawriter created") < 7:
                if time.monotonic() > deadline:
                    raise TimeoutError("the board did not connect in 30 s")
                board.heap()
            board.reads.get(timeout=30)
            board.heap()
            for _ in range(24):  # some seconds of samples
                board.reads.get(timeout=30)
            heap = board.heap()
    return heap.used, max(start.peak, heap.peak)
