"""An rclpy program that publishes from its start reaches a board within SECONDS of discovery.

Samples from before DDS has matched the two are lost, as everywhere in ROS. Later samples must not
wait for the next heartbeat of Fast DDS, which comes every three seconds; see
``middleware/dds/late_writer_heartbeat.py``. In about every third start, the agent's readers miss
the first heartbeat.
"""

import os
import subprocess
import threading
import time
from contextlib import contextmanager
from pathlib import Path

import pytest
from support.agent import running_agent
from support.middleware import MIDDLEWARE
from support.nodes import Int32, String

import uros
from uros.client import AGENT_CONNECTED
from uros.qos import DurabilityPolicy, QoSProfile
from uros.transport.udp import UdpTransport

SCRIPT = Path(__file__).parent / "early_talker.py"
TOPICS = ["/early_0", "/early_1", "/early_2"]
STARTS = 6
RATE = 20
SECONDS = 1.5  # without the probe reader it takes 3.0
SAMPLES = 10
NUMBERS_PER_START = 100_000

pytestmark = pytest.mark.timeout(180)


class EarlyTalker:
    """The process of early_talker.py.

    ``matched`` has for each topic the first number that was published with a subscriber, and when.
    """

    def __init__(self, python, domain, first):
        environment = dict(os.environ, ROS_DOMAIN_ID=str(domain))
        for name in ("CYCLONEDDS_URI", "PYTHONPATH", "RMW_IMPLEMENTATION"):
            environment.pop(name, None)
        self._process = subprocess.Popen(
            [str(python), str(SCRIPT), str(first), *TOPICS],
            stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, env=environment,
        )  # fmt: skip
        self.matched = {}
        self._thread = threading.Thread(target=self._read, daemon=True)
        self._thread.start()

    def _read(self):
        for line in self._process.stdout:
            topic, number = line.split()
            self.matched[topic] = int(number), time.monotonic()

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
    """A board on an agent that subscribes to all topics: its node, and for each topic the list of
    (data, time) received."""
    received = {topic: [] for topic in [*TOPICS, "/kept"]}

    def record(topic):
        return lambda message: received[topic].append((message.data, time.monotonic()))

    with running_agent("udp", MIDDLEWARE, domain) as agent:
        node = uros.Node("late", UdpTransport("127.0.0.1", agent.transport.port))
        for topic in TOPICS:
            node.create_subscription(Int32, topic, record(topic), 10)
        qos = QoSProfile(10, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        node.create_subscription(String, "/kept", record("/kept"), qos)
        until(node, lambda: node.state == AGENT_CONNECTED)
        try:
            yield node, received
        finally:
            node.destroy_node()


def until(node, done, seconds=30.0):
    deadline = time.monotonic() + seconds
    while not done():
        assert time.monotonic() < deadline, "the condition is not reached in time"
        node.spin_once(0.02)


def since(first, messages):
    """The messages of one start, without late ones of the start before."""
    return [message for message in messages if message[0] >= first]


def test_a_board_hears_a_starting_rclpy_program_soon(ros_python, own_domain_id):
    """Of each of several starts, all topics and the latched texts arrive soon and complete."""
    with board(own_domain_id) as (node, received):
        for start in range(STARTS):
            received["/kept"].clear()
            first = start * NUMBERS_PER_START
            check_start(node, received, EarlyTalker(ros_python, own_domain_id, first), start)


def check_start(node, received, talker, start):
    first = start * NUMBERS_PER_START

    def is_complete():
        return (
            len(talker.matched) == len(received)
            and all(len(since(first, received[topic])) >= SAMPLES for topic in TOPICS)
            and len(received["/kept"]) >= 3
        )

    try:
        until(node, is_complete)
    finally:
        talker.close()
    for topic in TOPICS:
        number, matched_at = talker.matched[topic]
        messages = since(first, received[topic])
        numbers = [message[0] for message in messages]
        assert messages[0][1] - matched_at < SECONDS, (start, topic)
        assert numbers[0] - number < SECONDS * RATE, (start, topic)
        # From the first number on, none is missing and none is duplicated.
        assert numbers == [numbers[0] + i for i in range(len(numbers))], (start, topic)
    assert [message[0] for message in received["/kept"]] == ["one", "two", "three"], start
    assert received["/kept"][-1][1] - talker.matched["/kept"][1] < SECONDS, start
