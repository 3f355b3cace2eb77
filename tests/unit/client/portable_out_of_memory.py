"""A MemoryError at any point: the session continues, and its streams stay complete and in order.

Also runs on MicroPython, where one test locks the heap.
"""

import sys

from support.board import KEY, Blob, FakeAgent, FakeClock, Number, number_bytes, pattern

from uros.client import AGENT_CONNECTED, Node

try:
    from micropython import heap_lock, heap_unlock
except ImportError:  # CPython

    def heap_lock():
        pass

    heap_unlock = heap_lock

# MicroPython is slow: every 13th point there.
STEP = 13 if sys.implementation.name == "micropython" else 1
SIZES = (3, 40, 600, 1500, 90, 5, 2000, 300, 301, 3)


class Starving:
    """Raises MemoryError in the k-th of all wrapped calls."""

    def __init__(self, k):
        self.k = k

    def around(self, owner, name):
        call = getattr(owner, name)

        def starving(*values):
            self.k -= 1
            if self.k == 0:
                raise MemoryError
            return call(*values)

        setattr(owner, name, starving)


class Bench:
    def __init__(self):
        self.clock = FakeClock()
        self.agent = FakeAgent(self.clock)
        self.node = Node("node", self.agent, key=KEY, clock=self.clock)
        self.node.connection.log = lambda text: None
        self.node.executor.report = lambda error: None
        self.blobs = self.node.create_publisher(Blob, "blobs")
        self.heard = []
        self.node.create_subscription(
            Number, "numbers", lambda message: self.heard.append(message.value)
        )
        self.sent = []
        self.lost = 0

    def spin(self, ms):
        end = self.clock.t + ms * 1000
        while self.clock.t < end:
            self.node.spin_once((end - self.clock.t) / 1000000)

    def publish(self, octets):
        try:
            if self.blobs.publish(Blob(octets)):
                self.sent.append(octets)
        except MemoryError:
            self.lost += 1

    def arrived(self):
        return [octets for object_id, octets in self.agent.samples if object_id == 0x05]


def life(starving, names):
    """Connect, publish and receive with one MemoryError; check what holds in every case.

    Returns:
        The bench, and the samples that arrived before the last one.
    """
    bench = Bench()
    for name in names:
        starving.around(bench.agent if name in ("send", "receive") else bench.node.connection, name)
    bench.spin(1000)
    for i in range(3):
        for size in SIZES:
            bench.publish(pattern(size, i))
        bench.agent.sample(0x16, number_bytes(i))
        bench.spin(300)
    bench.spin(6000)
    assert bench.node.state == AGENT_CONNECTED, bench.node.connection.reason
    before = bench.arrived()
    bench.publish(b"after")
    bench.agent.sample(0x16, number_bytes(7))
    bench.spin(600)
    assert bench.arrived() == before + [b"after"]
    assert bench.heard[-1] == 7 and bench.lost <= 1
    assert bench.node.connection.held() == 0
    return bench, before


def test_a_memory_error_at_any_call() -> None:
    names = ("send", "receive", "begin", "_slot", "_buffer", "_flush")
    k = 1 - STEP
    while True:
        k += STEP
        starving = Starving(k)
        bench, arrived = life(starving, names)
        if starving.k > 0:
            break
        # All accepted samples arrived once, complete and in order, unless there was a new session.
        if bench.node.connection.connections == 1:
            assert arrived == bench.sent[: len(arrived)], k
            assert len(arrived) == len(bench.sent) - 1, (k, len(arrived), len(bench.sent))
    assert k > 100, k


def test_a_sample_without_memory_is_lost_alone() -> None:
    class Hungry(Number):
        @classmethod
        def unpack_from(cls, buf, offset, start, end, little=True):
            if buf[offset] == 2:
                raise MemoryError
            return Number.unpack_from(buf, offset, start, end, little)

    bench = Bench()
    bench.node.create_subscription(
        Hungry, "hungry", lambda message: bench.heard.append(message.value)
    )
    bench.spin(1000)
    for i in (1, 2, 3):
        bench.agent.sample(0x26, number_bytes(i))
        bench.spin(100)
    assert bench.heard == [1, 3] and bench.node.connection.oom_count == 1
    assert bench.node.connection.connections == 1


def test_publishing_without_memory_sends_no_part_of_a_message() -> None:
    """On MicroPython the heap is locked during each second publish."""
    bench = Bench()
    bench.spin(1000)
    for size in SIZES:
        blob = Blob(pattern(size))
        taken = False
        heap_lock()
        try:
            taken = bench.blobs.publish(blob)
        except MemoryError:
            bench.lost += 1
        finally:
            heap_unlock()
        if taken:
            bench.sent.append(blob.octets)
        bench.publish(pattern(size, 1))
        bench.spin(50)
    bench.spin(1000)
    assert bench.arrived() == bench.sent
    assert len(bench.sent) + bench.lost == 2 * len(SIZES)
