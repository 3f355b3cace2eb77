"""A watchdog that spinning feeds. Also runs on MicroPython."""

from support.board import KEY, FakeAgent, FakeClock, Number, number_bytes

from uros.client import AGENT_CONNECTED, Node
from uros.client.logical_execution_time import LetExecutor, Period
from uros.wire import ids

LONGEST_US = 250000


class Watchdog:
    """Counts how often it is fed, and keeps the longest time between two feeds in microseconds."""

    def __init__(self, clock):
        self.clock = clock
        self.fed = self.longest = 0
        self.last = clock.t

    def feed(self):
        self.fed += 1
        self.longest = max(self.longest, self.clock.t - self.last)
        self.last = self.clock.t


class Bench:
    """A node with a watchdog; nothing is due for seconds."""

    def __init__(self):
        self.clock = FakeClock()
        self.agent = FakeAgent(self.clock)
        self.dog = Watchdog(self.clock)
        self.node = Node(
            "node", self.agent, key=KEY, clock=self.clock, watchdog=self.dog, wait_ms=20000,
            ping_ms=20000, silence_ms=60000,
        )  # fmt: skip

    def run(self, ms):
        end = self.clock.t + ms * 1000
        while self.clock.t < end:
            self.node.spin_once((end - self.clock.t) / 1000000)


def test_a_node_feeds_its_watchdog_while_it_waits() -> None:
    bench = Bench()
    bench.agent.silent = True
    for silent in (True, False):
        bench.agent.silent = silent
        before = bench.dog.fed
        bench.run(60000)
        assert bench.dog.fed - before >= 240
        assert 0 < bench.dog.longest <= LONGEST_US
    assert bench.node.state == AGENT_CONNECTED


def test_slow_callbacks_of_one_round_are_no_hang() -> None:
    bench = Bench()
    calls = []

    def slow():
        calls.append(bench.dog.fed)
        bench.clock.sleep(700)

    for _ in range(4):
        bench.node.create_timer(5, slow)
    bench.run(6000)
    assert len(calls) == 4 and bench.dog.longest == 700000
    assert calls == [calls[0] + n for n in range(4)]


def test_a_callback_that_hangs_starves_the_watchdog() -> None:
    bench = Bench()
    bench.run(60000)

    def hang():
        for _ in range(90):
            bench.clock.sleep(100)

    for topic in (False, True):
        if topic:
            subscription = bench.node.create_subscription(Number, "in", lambda message: hang())
            bench.run(1000)
            reader = subscription.object_id(ids.KIND_DATAREADER)
            bench.agent.sample(reader, number_bytes(1))
        else:
            bench.node.create_timer(1, hang)
        bench.dog.longest = 0
        bench.run(1200)
        assert bench.dog.longest == 9000000
        bench.node.destroy_timer(bench.node.executor.handles[0])


def test_spinning_in_periods_and_spin_some_feed_it() -> None:
    bench = Bench()
    LetExecutor(bench.node)
    Period(bench.node, 30).spin_once()
    assert bench.dog.fed >= 120 and bench.dog.longest <= LONGEST_US
    before = bench.dog.fed
    bench.node.spin_some(30)
    assert bench.dog.fed - before >= 120 and bench.dog.longest <= LONGEST_US


def test_nodes_that_share_an_executor_feed_the_watchdog_of_either() -> None:
    bench = Bench()
    other = Node("other", bench.node.connection, executor=bench.node.executor)
    bench.run(30000)
    before = bench.dog.fed
    other.spin_once(10)
    assert bench.dog.fed - before >= 40


def test_a_node_without_a_watchdog_waits_as_long_as_before() -> None:
    clock = FakeClock()
    node = Node("node", FakeAgent(clock), key=KEY, clock=clock)
    assert node.executor.wait(clock.ms()) == 60000
