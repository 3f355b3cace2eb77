"""The state of the connection on an LED and as text. Also runs on MicroPython."""

from support.services import Bench

from uros.client.status import StatusLed


class Led:
    """An LED; ``shown`` are (milliseconds, level)."""

    def __init__(self, bench):
        self.bench = bench
        self.shown = []

    def value(self, level):
        self.shown.append((self.bench.clock.ms(), level))


def watched():
    """Return a bench without an agent, and the LED and the lines of its node."""
    bench = Bench(connect=False)
    bench.agent.silent = True
    led = Led(bench)
    lines = []
    StatusLed(bench.node, led, lines.append)
    return bench, led, lines


def come(bench):
    """Connect to the agent, and let the timer of the LED run."""
    bench.agent.silent = False
    bench.connect()
    bench.run(200)


def test_the_led_toggles_ten_times_a_second_and_each_state_is_reported_once() -> None:
    bench, led, lines = watched()
    bench.run(1000)
    times = [t for t, _ in led.shown]
    assert len(times) == 10 and [b - a for a, b in zip(times, times[1:])] == [100] * 9
    assert [level for _, level in led.shown] == [True, False] * 5
    assert lines == ["looking for the agent"]
    come(bench)
    del led.shown[:]
    bench.run(1000)
    assert [level for _, level in led.shown] == [True] * 10
    assert lines == ["looking for the agent", "connected to the agent"]


def test_a_lost_agent_is_reported_once_with_the_reason() -> None:
    bench, led, lines = watched()
    come(bench)
    del lines[:]
    for _ in range(2):  # the same reason is reported for each loss
        del led.shown[:]
        bench.node.connection.end("the cable fell out")
        bench.run(300)
        assert [level for _, level in led.shown] == [False, True, False]
        come(bench)
        assert led.shown[-1][1] is True
        assert lines == ["no agent: the cable fell out", "connected to the agent"]
        del lines[:]


def test_an_agent_found_again_between_two_checks_is_reported() -> None:
    bench, led, lines = watched()
    come(bench)
    del lines[:]
    bench.node.connection.connections += 1  # as by a new session
    bench.run(100)
    assert lines == ["connected to the agent"] and led.shown[-1][1] is True
