"""Agents that are killed at any moment, and a board that goes on: nothing doubled, nothing stuck.

The agent is a real process; the board is a node here, with seven publishers and as many
subscriptions that hear them through the agent.
"""

import random
import subprocess
import sys
import time

import pytest
from support.lines import SECONDS
from support.ports import free_port
from uros.interfaces.std_msgs.msg import Int32

from uros.client import AGENT_AVAILABLE, AGENT_CONNECTED, Node
from uros.transport.udp import UdpTransport

TOPICS = 7


class Agents:
    """One agent after the other, on the same port; ``log`` is what the last one says."""

    def __init__(self, port, middleware, domain, folder):
        self._command = [
            sys.executable, "-m", "uros", "agent", "udp4", "-p", str(port), "-m", middleware,
            "--domain", str(domain),
        ]  # fmt: skip
        self._path = folder / "log"
        self._process = None

    def start(self):
        with open(self._path, "w") as out:
            self._process = subprocess.Popen(self._command, stdout=out, stderr=subprocess.STDOUT)

    def kill(self):
        """SIGKILL: no goodbye to anybody."""
        assert self._process.poll() is None, self.log()
        self._process.kill()
        self._process.wait()

    def log(self):
        return self._path.read_text()


class Board:
    """Publishes all the time, each topic its own count."""

    def __init__(self, port):
        self.node = Node(
            "board", UdpTransport("127.0.0.1", port), key=0x5EED,
            ping_ms=20, silence_ms=300, wait_ms=20,
        )  # fmt: skip
        self.refused = []
        self.node.connection.log = self.refused.append
        self.next = [0] * TOPICS
        self.heard = [[] for _ in range(TOPICS)]
        self.publishers = []
        for i in range(TOPICS):
            self.publishers.append(self.node.create_publisher(Int32, f"topic{i}"))
            self.node.create_subscription(
                Int32, f"topic{i}", lambda it, i=i: self.heard[i].append(it.data)
            )
        self.node.create_timer(0.005, self.publish)

    def publish(self):
        for i, publisher in enumerate(self.publishers):
            publisher.publish(Int32(data=self.next[i]))
            self.next[i] += 1

    def until(self, done, seconds=SECONDS):
        deadline = time.monotonic() + seconds
        while not done():
            assert time.monotonic() < deadline, (
                self.node.state, self.node.connection.reason, self.refused,
            )  # fmt: skip
            self.node.spin_once(0.002)

    def spin(self, seconds):
        end = time.monotonic() + seconds
        self.until(lambda: time.monotonic() >= end)


def moment(board, chance):
    """Spin until the next kill is due: while it connects, or when it works."""
    connection = board.node.connection
    kind = chance.randrange(4)
    if kind == 0:  # wherever it is
        board.spin(chance.random() * 0.4)
    elif kind == 1:  # in the middle of creating
        board.until(lambda: connection.state == AGENT_AVAILABLE, 3 * SECONDS)
        wanted = chance.randrange(4 * TOPICS * 2)
        board.until(
            lambda: connection.state == AGENT_CONNECTED or connection.request_id >= 10 + wanted
        )
    else:  # when it has worked for a while
        before = connection.connections  # it may not have noticed the last kill yet
        board.until(lambda: connection.connections > before, 3 * SECONDS)
        board.spin(chance.random() * 0.1)
    return kind


def reconnections(kills, middleware, domain, folder):
    chance = random.Random(20)
    port = free_port()
    agents, board = Agents(port, middleware, domain, folder), Board(port)
    kinds = [0, 0, 0, 0]
    try:
        for _ in range(kills):
            agents.start()
            kinds[moment(board, chance)] += 1
            agents.kill()
        agents.start()
        connection = board.node.connection
        before = connection.connections
        board.until(lambda: connection.connections > before, 3 * SECONDS)
        start = board.next[0]
        board.until(lambda: all(it and it[-1] > start + 10 for it in board.heard))
        log = agents.log()
        connections = connection.connections
        board.node.destroy_node()
    finally:
        agents.kill()
    published = sum(it.published for it in board.publishers)
    dropped = sum(it.dropped for it in board.publishers)
    received = sum(map(len, board.heard))
    doubled = received - sum(len(set(it)) for it in board.heard)
    print(
        f"\n{kills} kills ({kinds[0]} anywhere, {kinds[1]} while creating, {kinds[2] + kinds[3]}"
        f" at work), {connections} connections; samples: {published} published,"
        f" {dropped} dropped, {received} received, {doubled} doubled,"
        f" {connection.unconfirmed} unconfirmed"
    )
    assert doubled == 0 and published + dropped == sum(board.next)
    assert all(it == sorted(it) for it in board.heard)
    assert connections > kills / 4 and received > 100
    assert board.refused == []
    assert log.count("create_client            | create ") == 1, log
    assert log.count("datawriter created") == TOPICS == log.count("datareader created"), log


def test_a_board_survives_agents_that_are_killed(tmp_path, domain_id):
    reconnections(25, "memory", domain_id, tmp_path)


@pytest.mark.slow
@pytest.mark.timeout(900)
def test_a_board_survives_two_hundred_agents_on_dds(tmp_path, own_domain_id):
    reconnections(200, "dds", own_domain_id, tmp_path)
