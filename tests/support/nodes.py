"""Nodes of each kind on one network, and messages to publish there."""

import itertools
import time
from contextlib import ExitStack, contextmanager

import uros
from support.agent import running_agent
from uros.client import AGENT_CONNECTED
from uros.host.direct import Direct
from uros.interfaces import load
from uros.middleware import open_middleware
from uros.middleware.memory import Bus, MemoryMiddleware
from uros.transport.udp import UdpTransport

Int32 = load("std_msgs/msg/Int32")
String = load("std_msgs/msg/String")
Twist = load("geometry_msgs/msg/Twist")
CompressedImage = load("sensor_msgs/msg/CompressedImage")

SECONDS = 10.0
KINDS = ("memory", "dds", "agent")
_TURN = 0.005


class Nodes:
    """Creates nodes of one kind by ``make(name, …)``, each with a connection of its own."""

    def __init__(self, make):
        self._make = make
        self.made = []

    def __call__(self, name, **options):
        node = self._make(name, **options)
        self.made.append(node)
        return node

    def until(self, done, seconds=SECONDS):
        """Spin all nodes until ``done()``."""
        deadline = time.monotonic() + seconds
        while not done():
            assert time.monotonic() < deadline, "it does not come"
            for node in self.made:
                node.spin_once(_TURN)

    def connect(self):
        """Spin until all nodes are connected, with the entities that they have so far."""
        self.until(lambda: all(node.state == AGENT_CONNECTED for node in self.made))

    def settle(self):
        """Spin until marker messages sent now have arrived: earlier messages are then delivered."""
        came = []
        ends = []
        for node in self.made:
            ends.append(node.create_subscription(Int32, "/settle", came.append))
            ends.append(node.create_publisher(Int32, "/settle"))
        sent = [False for _ in self.made]

        def done():
            for i in range(len(sent)):
                sent[i] = sent[i] or ends[2 * i + 1].publish(Int32(data=i))
            return len(came) == len(sent) ** 2

        self.until(lambda: all(end.created for end in ends))
        self.until(done)
        for end in ends:
            end.destroy()


@contextmanager
def nodes_of(kind, domain):
    """Nodes of a kind in a domain; the rest of them is destroyed at the end."""
    with ExitStack() as stack:
        if kind == "memory":
            bus = Bus()
            made = Nodes(lambda name, **o: uros.Node(name, Direct(MemoryMiddleware(bus)), **o))
        elif kind == "dds":
            made = Nodes(
                lambda name, **o: uros.Node(name, Direct(open_middleware("dds"), domain), **o)
            )
        else:
            agent = stack.enter_context(running_agent("udp", "memory"))
            keys = itertools.count(0x52000001)
            made = Nodes(
                lambda name, **o: uros.Node(
                    name, UdpTransport("127.0.0.1", agent.transport.port), key=next(keys), **o
                )
            )
        try:
            yield made
        finally:
            for node in made.made:
                node.destroy_node()


def twist():
    message = Twist()
    message.linear.x, message.linear.z, message.angular.y = 0.5, -1.25, 1e300
    return message


def image(first=0):
    """A camera image of 15 kB."""
    message = CompressedImage()
    message.header.frame_id, message.format = "camera", "jpeg"
    message.header.stamp.sec, message.header.stamp.nanosec = 1234567890, 999999999
    message.data = bytes(i * 7 + first & 0xFF for i in range(15000))
    return message


# Messages to publish of each type.
MESSAGES = {
    Int32: [Int32(data=n) for n in (0, -1, 2**31 - 1)],
    String: [String(data=s) for s in ("", "hello", "grüße 🤖")],
    Twist: [twist(), Twist()],
    CompressedImage: [image(), image(1), image(2)],
}
