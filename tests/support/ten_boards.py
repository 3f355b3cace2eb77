"""Ten boards at 20 Hz on an agent with the rtps middleware, and a healthy reader on another host.

For processes of :func:`support.networks.run_isolated`. Half of the boards publish best effort, half
reliable; the reader takes each as it is offered. A board stamps its samples with the monotonic
time, which all processes of this machine share.
"""

import json
import os
import select
import subprocess
import sys
import time
from contextlib import ExitStack, contextmanager

from support.paths import ROOT
from uros.client import AGENT_CONNECTED, Node
from uros.interfaces import load
from uros.interfaces.codec import from_cdr
from uros.middleware.rtps.middleware import RtpsMiddleware
from uros.qos import QoSProfile, ReliabilityPolicy
from uros.transport.udp import UdpTransport

String = load("std_msgs/msg/String")
TYPE = "std_msgs::msg::dds_::String_"
# So deep that a machine with other work loses nothing.
BEST_EFFORT = QoSProfile(reliability=ReliabilityPolicy.BEST_EFFORT, depth=200)
RELIABLE = QoSProfile(depth=200)
BOARDS = 10
RATE = 20.0
DOMAIN = 75
PORT = 8888
SECONDS = 60.0
TOPICS = {f"rt/board_{number}": RELIABLE if number % 2 else BEST_EFFORT for number in range(BOARDS)}


def environment():
    """The environment of the agent and of the nodes: all hosts of the network are found."""
    names = ("CYCLONEDDS_URI", "ROS_STATIC_PEERS", "ROS_LOCALHOST_ONLY")
    kept = {name: value for name, value in os.environ.items() if name not in names}
    path = os.pathsep.join([str(ROOT / "tests"), str(ROOT / "src")])
    return {**kept, "ROS_AUTOMATIC_DISCOVERY_RANGE": "SUBNET", "PYTHONPATH": path}


class Program:
    """A process on a host that prints ``ready``, and at the end of its input a JSON value."""

    def __init__(self, host, *command):
        """``command`` is that of Python, with what is before it."""
        with host:
            self._process = subprocess.Popen(
                [*map(str, command)], stdin=subprocess.PIPE, text=True,
                stdout=subprocess.PIPE, env=environment(), bufsize=1,
            )  # fmt: skip

    @property
    def is_ready(self):
        """Whether it has printed ``ready``; asked until it has."""
        if not select.select([self._process.stdout], [], [], 0)[0]:
            return False
        line = self._process.stdout.readline()
        assert line, f"{self._process.args} ended with {self._process.wait()}"
        return line == "ready\n"

    def cpu(self):
        """The CPU time so far, in seconds."""
        with open(f"/proc/{self._process.pid}/schedstat") as file:
            return int(file.read().split()[0]) / 1e9

    def finish(self):
        """End its input; what it prints then."""
        output, _ = self._process.communicate(timeout=SECONDS)
        return json.loads(output.splitlines()[-1])

    def kill(self):
        self._process.kill()
        self._process.wait()


@contextmanager
def agent_on(host):
    """An agent on a host, for boards there, which listens."""
    with host:
        command = ["-m", "uros", "agent", "udp4", "-p", str(PORT), "-m", "rtps"]
        process = subprocess.Popen(
            [sys.executable, *command, "--domain", str(DOMAIN), "-v", "3"], env=environment()
        )
    try:
        yield process
    finally:
        process.terminate()
        process.wait()


class Boards:
    """The boards, on the host that is entered."""

    def __init__(self):
        self._nodes = []
        self._publishers = []
        self._sent = 0  # samples that are counted, of each board
        for number, (topic, qos) in enumerate(TOPICS.items()):
            node = Node(f"board_{number}", UdpTransport("127.0.0.1", PORT), "", DOMAIN, number + 1)
            self._nodes.append(node)
            self._publishers.append(node.create_publisher(String, topic.removeprefix("rt"), qos))

    def subscribe(self, topic):
        """Have the first board read a topic, too."""
        self._nodes[0].create_subscription(String, topic, lambda message: None, BEST_EFFORT)

    def connect(self):
        end = time.monotonic() + SECONDS
        while any(node.state != AGENT_CONNECTED for node in self._nodes):
            assert time.monotonic() < end, "the boards do not connect"
            for node in self._nodes:
                node.spin_once(0.005)

    def until(self, done):
        """Publish samples that do not count until something is done."""
        end = time.monotonic() + SECONDS
        while not done():
            assert time.monotonic() < end, "it does not happen"
            self._publish_all(0)

    def run(self, seconds):
        """Publish numbered samples; how many of each board."""
        for _ in range(int(seconds * RATE)):
            self._sent += 1
            self._publish_all(self._sent)
        return self._sent

    def _publish_all(self, number):
        """Publish a sample of each board, evenly over the period."""
        start = time.monotonic()
        for index, (node, publisher) in enumerate(
            zip(self._nodes, self._publishers, strict=True), 1
        ):
            node.spin_once(0)
            publisher.publish(String(data=f"{number} {time.monotonic_ns()} {'x' * 30}"))
            time.sleep(max(0.0, start + index / RATE / BOARDS - time.monotonic()))

    def close(self):
        for node in self._nodes:
            node.destroy_node()


class Loop:
    """A middleware's data plane until the end of the standard input."""

    def __init__(self, name):
        self.middleware = RtpsMiddleware()
        self.node = self.middleware.create_node(DOMAIN, "/", name)

    def turn(self, until=None):
        """Wait for work until a time; False at the end of the input."""
        deadlines = [at for at in (until, self.middleware.next_deadline()) if at is not None]
        pause = max(0.0, min(deadlines) - time.monotonic()) if deadlines else None
        ready = select.select([self.middleware.fileno(), 0], [], [], pause)[0]
        if self.middleware.fileno() in ready:
            self.middleware.dispatch()
        deadline = self.middleware.next_deadline()
        if deadline is not None and deadline <= time.monotonic():
            self.middleware.tick()
        return 0 not in ready


def read():
    """The healthy reader: prints ``ready``, then what came of each topic, as (number, seconds)."""
    loop = Loop("healthy_reader")
    found = {topic: [] for topic in TOPICS}
    heard = set()

    def listen(topic, qos):
        def take():
            now = time.monotonic_ns()
            for cdr in reader.take(1000):
                number, sent, _ = from_cdr(String, cdr).data.split()
                if topic not in heard:
                    heard.add(topic)
                    if len(heard) == BOARDS:
                        print("ready", flush=True)
                if int(number):
                    found[topic].append((int(number), (now - int(sent)) / 1e9))

        reader = loop.node.create_reader(topic, TYPE, qos, take)

    for topic, qos in TOPICS.items():
        listen(topic, qos)
    while loop.turn():
        pass
    loop.middleware.close()
    print(json.dumps(found))


def judge(sent, found):
    """What became of the samples: p50 and p99 in ms, shares in %, of both reliabilities."""
    figures = {}
    for name, qos in (("best effort", BEST_EFFORT), ("reliable", RELIABLE)):
        topics = [topic for topic in TOPICS if TOPICS[topic] is qos]
        samples = [found[topic] for topic in topics]
        numbers = [[number for number, _ in one] for one in samples]
        took = sorted(latency for one in samples for _, latency in one)
        figures[name] = {
            "lost": 100 * (1 - sum(len(set(one)) for one in numbers) / sent / len(topics)),
            "in order": all(one == sorted(set(one)) for one in numbers),
            "p50": took[len(took) // 2] * 1e3 if took else None,
            "p99": took[len(took) * 99 // 100] * 1e3 if took else None,
        }
    return figures


def measure(agent_host, reader_host, seconds, start_noise):
    """Run boards and reader beside noise; print figures as JSON.

    ``start_noise`` is given an ExitStack and returns a function that ends the noise and returns
    what it has done.
    """
    with ExitStack() as stack:
        agent = stack.enter_context(agent_on(agent_host))
        with agent_host:
            boards = Boards()
            stack.callback(boards.close)
            boards.connect()
            reader = Program(reader_host, sys.executable, "-c", f"import {__name__} as m; m.read()")
            stack.callback(reader.kill)
            boards.until(lambda: reader.is_ready)
            end_noise = start_noise(stack, boards)
            sent = boards.run(seconds)
            noise = end_noise()
            boards.until(_after(1.0))
        assert agent.poll() is None
        print(json.dumps({**judge(sent, reader.finish()), "noise": noise}))


def _after(seconds):
    end = time.monotonic() + seconds
    return lambda: time.monotonic() >= end
