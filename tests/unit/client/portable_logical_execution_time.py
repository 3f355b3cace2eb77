"""Logical execution time and fixed periods. Also runs on MicroPython."""

from support.board import KEY, FakeAgent, FakeClock, Number, number_bytes

from uros import qos
from uros.client import AGENT_CONNECTED, WAITING_AGENT, Node
from uros.client.logical_execution_time import LetExecutor, Period
from uros.client.triggers import trigger_all


class Bench:
    """A connected node with two subscriptions, /a and /b, and a publisher, /out."""

    def __init__(self, profile=10):
        self.clock = FakeClock()
        self.agent = FakeAgent(self.clock)
        self.node = Node("node", self.agent, key=KEY, clock=self.clock)
        self.log = []
        self.work_ms = 10
        self.out = self.node.create_publisher(Number, "out", profile)
        for name in ("a", "b"):
            self.node.create_subscription(Number, name, self.callback(name))
        for _ in range(1000):
            self.node.spin_once(0.01)
            if self.node.state == AGENT_CONNECTED:
                break
        self.start = self.clock.t

    def callback(self, name):
        def called(message):
            self.log.append((name, message.value, len(self.agent.samples)))
            assert self.out.publish(Number(message.value + 100))
            self.clock.sleep(self.work_ms)

        return called

    def both(self, value):
        """Send a sample to each subscription, in one datagram."""
        datagram = b"\x81\0\0\0"
        for object_id in (0x16, 0x26):
            datagram += b"\x09\x01\x08\0\0\x0e\0" + bytes((object_id,)) + number_bytes(value)
        self.agent.post(datagram)

    def values(self):
        return [int.from_bytes(sample[1], "little") for sample in self.agent.samples]


def test_a_plain_executor_sends_samples_at_once() -> None:
    bench = Bench()
    bench.both(1)
    bench.node.spin_once(0.1)
    assert bench.log == [("a", 1, 0), ("b", 1, 1)]


def test_samples_of_a_round_are_sent_at_its_end() -> None:
    for profile in (10, qos.qos_profile_sensor_data):
        bench = Bench(profile)
        executor = LetExecutor(bench.node)
        assert bench.node.executor is executor and len(executor.handles) == 2
        for value in (1, 2):
            bench.both(value)
            bench.node.spin_once(0.1)
        assert bench.log == [("a", 1, 0), ("b", 1, 0), ("a", 2, 2), ("b", 2, 2)]
        assert bench.values() == [101, 101, 102, 102]
        assert (
            bench.out.publish(Number(7)) and bench.values()[-1] == 7
        )  # outside of a round: at once


def test_a_round_handles_the_samples_received_before_it() -> None:
    """Also if callbacks are so slow that the session is served between them."""
    bench = Bench()
    LetExecutor(bench.node)
    bench.work_ms = 500
    bench.both(1)
    callback = bench.node.executor.handles[0].callback
    bench.node.executor.handles[0].callback = lambda message: (bench.both(2), callback(message))
    bench.node.spin_once(0.1)
    assert bench.log == [("a", 1, 0), ("b", 1, 0)]
    bench.node.executor.handles[0].callback = callback
    bench.node.spin_once(0.1)
    assert bench.log[2:] == [("a", 2, 2), ("b", 2, 2)]
    assert bench.values() == [101, 101, 102, 102]


def test_the_session_is_served_while_samples_are_held() -> None:
    bench = Bench()
    LetExecutor(bench.node)
    bench.work_ms = 500
    bench.agent.sample(0x16, number_bytes(1))
    bench.agent.sample(0x26, number_bytes(1))
    bench.node.connection.pump(0)
    bench.node.connection.pump(0)
    before = len(bench.agent.sent)
    datagrams = []
    bench.node.executor.handles[1].callback = lambda message: datagrams.extend(
        bench.agent.sent[before:]
    )
    bench.node.spin_once(0.1)
    assert datagrams and [datagram[1] for datagram in datagrams] == [0] * len(datagrams)
    assert bench.values() == [101]


def test_held_samples_stay_below_the_limit() -> None:
    bench = Bench(qos.qos_profile_sensor_data)
    LetExecutor(bench.node)
    limit = bench.node.connection.limit

    def flood():
        for i in range(5000):
            bench.out.publish(Number(i))

    bench.node.create_timer(0.01, flood)
    bench.node.spin_once(0.1)
    count = len(bench.agent.samples)
    assert limit // 20 <= count <= limit // 12 and bench.values() == list(range(count))


def test_a_transport_that_fails_while_samples_are_held() -> None:
    bench = Bench()
    LetExecutor(bench.node)
    timer = bench.node.create_timer(0.01, lambda: bench.out.publish(Number(1)))
    bench.agent.fail_send = OSError(5, "gone")
    for _ in range(100):
        bench.node.spin_once(0.01)
    assert bench.node.state == WAITING_AGENT
    bench.agent.fail_send = None
    timer.cancel()
    bench.agent.forget()
    for _ in range(200):
        bench.node.spin_once(0.01)
    assert bench.node.state == AGENT_CONNECTED and bench.agent.samples == []
    timer.reset()
    bench.node.spin_once(0.1)
    assert bench.values() == [1]


def test_a_let_executor_takes_over_trigger_and_report() -> None:
    bench = Bench()
    bench.node.executor.trigger = trigger_all
    errors = []
    bench.node.executor.report = errors.append
    executor = LetExecutor(bench.node)
    bench.agent.sample(0x16, number_bytes(1))
    bench.node.spin_once(0.1)
    assert bench.log == []
    bench.agent.sample(0x26, number_bytes(2))
    bench.node.spin_once(0.1)
    assert [entry[:2] for entry in bench.log] == [("a", 1), ("b", 2)]
    bench.node.create_timer(0.01, lambda: 1 // 0)
    executor.trigger = None
    bench.node.spin_once(0.1)
    assert len(errors) == 1 == executor.failed
    again = LetExecutor(bench.node)  # idempotent: no sample is held for ever
    bench.both(3)
    bench.node.spin_once(0.1)
    assert bench.node.executor is again and bench.values()[-2:] == [103, 103]


# --- periods ----------------------------------------------------------------------------------


def test_one_round_a_period_without_drift() -> None:
    bench = Bench()
    rounds = []
    execute = bench.node.executor.execute
    bench.node.executor.execute = lambda now: (rounds.append(bench.clock.t), execute(now))[1]
    period = Period(bench.node, 0.1)
    for i in range(50):
        if i % 5 == 0:
            bench.both(i)
        period.spin_once()
        bench.clock.t += 123  # other work of the program
    assert rounds[0] == bench.start
    for n in range(50):
        assert 0 <= rounds[n] - bench.start - n * 100000 < 2000, n
    assert period.overruns == 0 and len(bench.log) == 20


def test_samples_received_in_a_period_are_handled_in_the_next_round() -> None:
    bench = Bench()
    period = Period(bench.node, 0.1)
    period.spin_once()
    bench.agent.delay = (0, 30000)  # arrives during the period
    bench.both(1)
    assert period.spin_once() == 0 and bench.log == []
    assert period.spin_once() == 2
    assert bench.node.state == AGENT_CONNECTED


def test_samples_are_sent_at_the_end_of_the_period() -> None:
    bench = Bench()
    LetExecutor(bench.node)
    period = Period(bench.node, 0.1)
    left = []
    hear = bench.agent.hear

    def heard(datagram):
        if datagram[4] == 7:
            left.append(bench.clock.t - bench.start)
        hear(datagram)

    bench.agent.hear = heard
    bench.both(1)
    assert period.spin_once() == 2 and left == [100000, 100000]
    for _ in range(20):
        period.spin_once()
    assert left == [100000, 100000] and bench.node.state == AGENT_CONNECTED


def test_rounds_longer_than_a_period_are_counted() -> None:
    bench = Bench()
    LetExecutor(bench.node)
    bench.work_ms = 125
    period = Period(bench.node, 0.1)
    bench.both(1)
    period.spin_once()
    assert bench.clock.t - bench.start == 250000 and period.overruns == 1
    assert bench.values() == [101, 101]
    period.spin_once()
    assert bench.clock.t - bench.start == 300000  # at the start of a period again


def test_long_periods_do_not_end_the_session() -> None:
    bench = Bench()
    period = Period(bench.node, 30)
    for i in range(3):
        bench.both(i)
        period.spin_once()
    assert bench.node.connection.connections == 1 and len(bench.log) == 4
    assert bench.clock.t - bench.start == 90000000
