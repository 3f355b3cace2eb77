"""A board is there, then an rclpy program starts and publishes at once: the board hears it soon.

What goes out before DDS has connected the two is lost, as everywhere in ROS. What follows must
not wait for the next heartbeat of Fast DDS, which comes every three seconds; see
``middleware/dds/late_writer_heartbeat.py``. About every third start is one where our readers miss
the first.
"""

import os
import subprocess
import threading
import time
from contextlib import contextmanager
from pathlib import Path

import pytest
from support.agent import running_agent
from support.nodes import Int32, String

import uros
from uros.client import AGENT_CONNECTED
from uros.qos import DurabilityPolicy, QoSProfile
from uros.transport.udp import UdpTransport

SCRIPT = Path(__file__).parent / "early_talker.py"
TOPICS = ["/early_0", "/early_1", "/early_2"]
STARTS = 6
RATE = 20
SECONDS = 1.5  # without the remedy it is 3.0
SAMPLES = 10
EACH = 100_000  # numbers of a start

pytestmark = pytest.mark.timeout(180)


class EarlyTalker:
    """The process. ``heard`` says for a topic the number and the time when it had a subscriber."""

    def __init__(self, python, domain, first):
        environment = dict(os.environ, ROS_DOMAIN_ID=str(domain))
        for name in ("CYCLONEDDS_URI", "PYTHONPATH", "RMW_IMPLEMENTATION"):
            environment.pop(name, None)
        self._process = subprocess.Popen(
            [str(python), str(SCRIPT), str(first), *TOPICS],
            stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, env=environment,
        )  # fmt: skip
        self.heard = {}
        self._thread = threading.Thread(target=self._read, daemon=True)
        self._thread.start()

    def _read(self):
        for line in self._process.stdout:
            topic, number = line.split()
            self.heard[topic] = int(number), time.monotonic()

    def close(self):
        self._process.stdin.close()
        try:
            assert self._process.wait(30) == 0
        finally:
            self._process.kill()
            self._thread.join()
            self._process.stdout.close()


@contextmanager
def board(domain):
    """A board of ours behind our agent that reads all topics; what came on each, and when."""
    came = {topic: [] for topic in [*TOPICS, "/kept"]}

    def keep(topic):
        return lambda message: came[topic].append((message.data, time.monotonic()))

    with running_agent("udp", "dds", domain) as agent:
        node = uros.Node("late", UdpTransport("127.0.0.1", agent.transport.port))
        for topic in TOPICS:
            node.create_subscription(Int32, topic, keep(topic), 10)
        qos = QoSProfile(10, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        node.create_subscription(String, "/kept", keep("/kept"), qos)
        until(node, lambda: node.state == AGENT_CONNECTED)
        try:
            yield node, came
        finally:
            node.destroy_node()


def until(node, done, seconds=30.0):
    deadline = time.monotonic() + seconds
    while not done():
        assert time.monotonic() < deadline, "it does not come"
        node.spin_once(0.02)


def since(first, messages):
    """Those of one start: the last of the start before may come late."""
    return [it for it in messages if it[0] >= first]


def test_a_board_hears_a_starting_rclpy_program_soon(ros_python, own_domain_id):
    with board(own_domain_id) as (node, came):
        for start in range(STARTS):
            came["/kept"].clear()
            one_start(node, came, EarlyTalker(ros_python, own_domain_id, start * EACH), start)


def one_start(node, came, talker, start):
    first = start * EACH

    def is_all_there():
        return (
            len(talker.heard) == len(came)
            and all(len(since(first, came[topic])) >= SAMPLES for topic in TOPICS)
            and len(came["/kept"]) >= 3
        )

    try:
        until(node, is_all_there)
    finally:
        talker.close()
    for topic in TOPICS:
        number, at = talker.heard[topic]
        messages = since(first, came[topic])
        numbers = [it[0] for it in messages]
        assert messages[0][1] - at < SECONDS, (start, topic)
        assert numbers[0] - number < SECONDS * RATE, (start, topic)
        # None is missing from then on, and none comes twice.
        assert numbers == [numbers[0] + i for i in range(len(numbers))], (start, topic)
    assert [it[0] for it in came["/kept"]] == ["one", "two", "three"], start
    assert came["/kept"][-1][1] - talker.heard["/kept"][1] < SECONDS, start
