"""Deep sleep between messages, and the id of the session after it. Also runs on MicroPython."""

import sys

from support.board import KEY, FakeAgent, FakeClock, Number

from uros.client import AGENT_CONNECTED, Node
from uros.client.deep_sleep import deep_sleep, wait_for_agent
from uros.client.session import FIRST_SESSION_ID
from uros.wire import ids


class Bench:
    """A node, its agent, and a machine that notes how long it would sleep, and when."""

    def __init__(self):
        self.clock = FakeClock()
        self.agent = FakeAgent(self.clock)
        self.node = Node("node", self.agent, key=KEY, clock=self.clock)
        self.publisher = self.node.create_publisher(Number, "out", 10)
        self.slept = []

    def deepsleep(self, ms):
        self.slept.append((ms, self.clock.ms()))

    def sleep(self, ms, *more):
        had = sys.modules.get("machine")
        sys.modules["machine"] = self
        try:
            deep_sleep(self.node, ms, *more)
        finally:
            del sys.modules["machine"]
            if had is not None:
                sys.modules["machine"] = had


def test_the_board_sleeps_when_all_messages_are_acknowledged() -> None:
    bench = Bench()
    bench.node.create_subscription(Number, "in", print, 10)
    assert wait_for_agent(bench.node, 10)
    bench.agent.delay = (100000, 100000)
    for value in range(30):  # more than a window
        assert bench.publisher.publish(Number(value))
    start = bench.clock.ms()
    bench.sleep(60000, 10)
    assert [sample[1][0] for sample in bench.agent.samples] == list(range(30))
    ((ms, when),) = bench.slept
    assert ms == 60000 and 200 <= when - start < 2000
    assert bench.agent.requests[-1][0] == ids.READ_DATA
    assert bench.node.state == AGENT_CONNECTED  # the session is not ended


def test_samples_are_asked_for_no_longer_and_again_in_the_next_session() -> None:
    bench = Bench()
    bench.node.create_subscription(Number, "in", print, 10)
    wait_for_agent(bench.node, 10)
    bench.agent.requests.clear()
    bench.sleep(1)
    ((kind, _),) = bench.agent.requests
    assert kind == ids.READ_DATA
    reads = [message for message in bench.agent.sent if message[4] == ids.READ_DATA]
    assert reads[-1][12:] == bytes((ids.STREAM_RELIABLE, 0, 0, 1)) + bytes(8)  # no samples


def test_a_silent_agent_delays_the_sleep_for_so_long_and_not_for_ever() -> None:
    bench = Bench()
    wait_for_agent(bench.node, 10)
    bench.agent.silent = True
    bench.publisher.publish(Number(1))
    start = bench.clock.ms()
    bench.sleep(5, 0.5)
    assert 500 <= bench.slept[0][1] - start < 600


def test_without_an_agent_the_board_sleeps_at_once() -> None:
    bench = Bench()
    bench.agent.silent = True
    start = bench.clock.ms()
    assert wait_for_agent(bench.node, 1.5) is False
    assert bench.clock.ms() - start == 1500
    bench.sleep(7)
    assert bench.slept == [(7, start + 1500)]


def test_a_line_that_fails_before_there_is_an_agent_does_not_change_the_session_id() -> None:
    bench = Bench()
    for error in ("fail_open", "fail_receive", "fail_send"):
        setattr(bench.agent, error, OSError(5, "joining"))
        assert not wait_for_agent(bench.node, 3)
        setattr(bench.agent, error, None)
    assert wait_for_agent(bench.node, 10)
    assert [number for _, number in bench.agent.create_clients] == [FIRST_SESSION_ID]
