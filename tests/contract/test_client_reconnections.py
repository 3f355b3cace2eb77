"""A board whose agents are killed at any moment reconnects, without duplicated samples.

The agent is a real process; the board is a node in this process, with seven publishers and seven
subscriptions to their topics.
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
    """Agent processes one after the other, on the same port; ``log`` is that of the last one."""

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
        """End the agent with SIGKILL, without closing any session."""
        assert self._process.poll() is None, self.log()
        self._process.kill()
        self._process.wait()

    def log(self):
        return self._path.read_text()


class Board:
    """A board that publishes a counter on each topic."""

    def __init__(self, port):
        self.node = Node(
            "board", UdpTransport("127.0.0.1", port), key=0x5EED,
            ping_ms=20, silence_ms=300, wait_ms=20,
        )  # fmt: skip
        self.refused = []
        self.node.connection.log = self.refused.append
        self.next = [0] * TOPICS
        self.received = [[] for _ in range(TOPICS)]
        self.publishers = []
        for i in range(TOPICS):
            self.publishers.append(self.node.create_publisher(Int32, f"topic{i}"))
            self.node.create_subscription(
                Int32, f"topic{i}", lambda message, i=i: self.received[i].append(message.data)
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
    """Spin until the next kill is due: while the board connects, or while it publishes."""
    connection = board.node.connection
    kind = chance.randrange(4)
    if kind == 0:  # at any time
        board.spin(chance.random() * 0.4)
    elif kind == 1:  # while entities are created
        board.until(lambda: connection.state == AGENT_AVAILABLE, 3 * SECONDS)
        request = chance.randrange(4 * TOPICS * 2)
        board.until(
            lambda: connection.state == AGENT_CONNECTED or connection.request_id >= 10 + request
        )
    else:  # after it has published for a while
        before = connection.connections  # the board may not have detected the last kill yet
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
        board.until(lambda: all(numbers and numbers[-1] > start + 10 for numbers in board.received))
        log = agents.log()
        connections = connection.connections
        board.node.destroy_node()
    finally:
        agents.kill()
    published = sum(publisher.published for publisher in board.publishers)
    dropped = sum(publisher.dropped for publisher in board.publishers)
    received = sum(map(len, board.received))
    doubled = received - sum(len(set(numbers)) for numbers in board.received)
    print(
        f"\n{kills} kills ({kinds[0]} anywhere, {kinds[1]} while creating, {kinds[2] + kinds[3]}"
        f" at work), {connections} connections; samples: {published} published,"
        f" {dropped} dropped, {received} received, {doubled} doubled,"
        f" {connection.unconfirmed} unconfirmed"
    )
    assert doubled == 0 and published + dropped == sum(board.next)
    assert all(numbers == sorted(numbers) for numbers in board.received)
    assert connections > kills / 4 and received > 100
    assert board.refused == []
    # On a busy machine a board's first session with an agent may end before it is complete.
    sessions = log.count("create_client            | create ")
    assert sessions - log.count("delete_client            | delete ") == 1, log
    last = log.rpartition("create_client            | create ")[2]
    assert last.count("datawriter created") == TOPICS == last.count("datareader created"), log


def test_a_board_survives_agents_that_are_killed(tmp_path, domain_id):
    reconnections(25, "memory", domain_id, tmp_path)


@pytest.mark.slow
@pytest.mark.timeout(900)
def test_a_board_survives_two_hundred_killed_agents_on_dds(tmp_path, own_domain_id):
    reconnections(200, "dds", own_domain_id, tmp_path)
