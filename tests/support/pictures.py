"""A board that publishes pictures, and a viewer: for mpy/test_pictures.py, bench/pictures.py."""

import os
import random
import textwrap
import time
from contextlib import ExitStack
from typing import NamedTuple

from mpy.harness import INSTALLED

import uros
from support.agent import running_agent
from support.slow_line import SlowLine
from uros.boards.virtual.engine.runner import Heap, RunningBoard
from uros.host.direct import Direct
from uros.interfaces import load
from uros.middleware import open_middleware

CompressedImage = load("sensor_msgs/msg/CompressedImage")
Empty = load("std_msgs/msg/Empty")

# All pictures are parts of it. Its length is prime: no part of a picture equals another one.
_FILM = random.Random(20).randbytes(2039)
_STRIDE = 131  # each picture begins this much later in the film


def picture(number, length):
    """The octets of a picture: its number, and a part of the film."""
    start = number * _STRIDE % len(_FILM)
    film = _FILM * (2 + length // len(_FILM))
    return number.to_bytes(4, "little") + film[start : start + length - 4]


_PROGRAM = """
import time
from sensor_msgs.msg import CompressedImage
from std_msgs.msg import Empty
from uros.client import AGENT_CONNECTED, Node
from uros.client.streaming import publish_stream, streaming

FILM = memoryview(FILM_TWICE)

class Camera:
    '''A camera with a FIFO of its own, which is read piece by piece.'''

    def take(self, number):
        self.head = number.to_bytes(4, "little")
        self.at = number * STRIDE % SIZE

    def readinto(self, view):
        if self.head:
            view[:4] = self.head
            self.head = b""
            return 4
        count = min(len(view), SIZE)
        view[:count] = FILM[self.at : self.at + count]
        self.at = (self.at + count) % SIZE
        return count

def start():
    global node, images, image, camera, taken, refused, begun, tried
    taken = refused = 0
    begun = tried = None
    camera = Camera()
    image = CompressedImage(format="jpeg")
    image.header.frame_id = "camera"
    node = Node("camera", TRANSPORT, key=20, ping_ms=500, silence_ms=10000, wait_ms=100)
    images = node.create_publisher(CompressedImage, "/camera/image/compressed", 10)
    node.create_subscription(Empty, "/camera/go", go, 10)

def go(_):
    global begun
    if begun is None:
        begun = time.ticks_ms()

def step():
    global taken, refused, tried
    node.spin_once(0.02)
    now = time.ticks_ms()
    if node.state != AGENT_CONNECTED or taken > COUNT:
        return
    if begun is None:  # no viewer yet
        if tried is None or time.ticks_diff(now, tried) > 100:
            tried = now
            images.publish(image)
    elif taken == COUNT:
        if not node.connection.held():
            print("took", time.ticks_diff(now, begun), refused, images.dropped,
                  getattr(TRANSPORT, "dropped", 0), node.connection.connections)
            taken += 1
    # The next picture, when it is due and the last one is sent. Over UDP with a period, when the
    # last one has arrived: the copies of the virtual board's socket count in the high water, and a
    # late machine must not cause more of them in one step.
    elif (
        time.ticks_diff(now, begun) >= taken * PERIOD
        and not streaming(images)
        and not (WAITS and node.connection.held())
    ):
        node.clock.stamp(image.header.stamp)
        camera.take(taken)
        if publish_stream(images, image, LENGTH, camera):
            taken += 1
        else:
            refused += 1
"""
WAYS = {
    "udp": """
        from uros.transport.udp import UdpTransport
        from uros.transport.wlan import Over, Station

        TRANSPORT = Over(Station("robots", "secret99"), UdpTransport("127.0.0.1", PORT, mtu=MTU))
        """,
    "usb": """
        from uros.drivers.port import open_port
        from uros.transport.serial import StreamTransport

        port = open_port(0x045B, 0x2013, "uros", "camera", "1")
        TRANSPORT = StreamTransport(port, mtu=MTU)
        """,
    # A UART that does not block: a write takes what fits into the TXBUF octets of its driver.
    "uart": """
        import time
        from uros.drivers.port import open_port
        from uros.transport.serial import StreamTransport

        class Uart:
            def __init__(self, port):
                self.port = port
                self.read = port.read
                self.wait = port.wait
                self.full = 0  # octets in it, in millionths
                self.seen = time.ticks_us()

            def write(self, data):
                now = time.ticks_us()
                left = self.full - time.ticks_diff(now, self.seen) * BAUD // 10
                self.full = max(0, left)
                self.seen = now
                count = min(len(data), TXBUF - (self.full + 999999) // 1000000)
                if count > 0:
                    count = self.port.write(data[:count]) or 0
                    self.full += count * 1000000
                return count

        port = Uart(open_port(0x045B, 0x2013, "uros", "camera", "1"))
        TRANSPORT = StreamTransport(port, mtu=MTU)
        """,
}
# The same program behind a bridge and a line of some baud rate: `slow_line`.
WAYS["serial"] = WAYS["usb"]


class Shot(NamedTuple):
    """The result. ``seconds`` passed between the arrivals of the first and the last picture.

    The line carried ``octets`` meanwhile, and was busy for the part ``busy`` of that time. Of the
    board: pictures ``refused`` by publish, messages ``dropped`` by the publisher and ``lost`` by
    the transport, and its ``sessions``.
    """

    pictures: list
    seconds: float
    octets: int
    busy: float
    refused: int
    dropped: int
    lost: int
    sessions: int
    heap: Heap

    @property
    def rate(self):
        return (len(self.pictures) - 1) / self.seconds


def shoot(
    way, folder, domain, count, period_ms=0, length=20_000, *, mtu=512, baud=921_600, txbuf=512,
    measure=True, seconds=40.0,
):  # fmt: skip
    """Let a MicroPython board publish pictures to an agent, and take them by DDS; a :class:`Shot`.

    A picture is published when it is due, every ``period_ms``, and the last one is sent. ``way`` is
    one of WAYS; "serial" and "uart" have a `slow_line` of ``baud`` between board and agent.
    """
    os.environ["UROS_MICROPYTHON"] = str(INSTALLED)
    line = None
    marks = []
    pictures = []

    def look(message):
        if not message.data:
            starter.publish(Empty())
            return
        pictures.append(bytes(message.data))
        marks.append((time.monotonic(), line.up.carried if line else 0))

    with ExitStack() as stack:
        viewer = uros.Node("viewer", Direct(open_middleware("dds"), domain))
        stack.callback(viewer.destroy_node)
        viewer.create_subscription(CompressedImage, "/camera/image/compressed", look, 50)
        starter = viewer.create_publisher(Empty, "/camera/go", 10)
        constants = {
            "COUNT": count, "PERIOD": period_ms, "LENGTH": length, "MTU": mtu, "TXBUF": txbuf,
            "BAUD": baud, "STRIDE": _STRIDE, "SIZE": len(_FILM), "FILM_TWICE": _FILM * 2,
            "WAITS": way == "udp" and period_ms > 0,
        }  # fmt: skip
        if way == "udp":
            agent = stack.enter_context(running_agent("udp", "dds", domain))
            constants["PORT"] = agent.transport.port
        text = "".join(f"{name} = {value!r}\n" for name, value in constants.items())
        text += textwrap.dedent(WAYS[way]) + _PROGRAM
        program = folder / f"{way}-{length}-{period_ms}-{mtu}"
        program.mkdir()
        (program / "main.py").write_text(text, encoding="utf-8")
        board = RunningBoard(
            program, "ra6m5_sensor_node", "micropython", form="mpy", measure=measure,
            plugs=["wlan"] if way == "udp" else [],
        )  # fmt: skip
        stack.enter_context(board)
        if way != "udp":
            board.wait_usb("configured")
            device = board.path
            if way != "usb":
                line = stack.enter_context(SlowLine(device, baud))
                device = line.path
            stack.enter_context(running_agent("serial", "dds", domain, device=device))
        deadline = time.monotonic() + seconds
        while len(pictures) < count:
            assert time.monotonic() < deadline and not board.ended, (
                len(pictures), board.console.queue,
            )  # fmt: skip
            viewer.spin_once(0.05)
        counts = board.wait("took").split()[1:]
        heap = board.heap()
        assert line is None or line.error is None
    seconds = marks[-1][0] - marks[0][0]
    octets = marks[-1][1] - marks[0][1]
    busy = octets / seconds / line.capacity if line else 0.0
    return Shot(pictures, seconds, octets, busy, *map(int, counts[1:]), heap)
