"""The LED and the words that tell whether there is an agent. Also runs on MicroPython."""

from support.services import Bench

from uros.client.status import StatusLed


class Led:
    """Each level that it was set to, and when."""

    def __init__(self, bench):
        self.bench = bench
        self.shown = []

    def value(self, level):
        self.shown.append((self.bench.clock.ms(), level))


def watched():
    """A bench with no agent yet; the LED and the lines of its node."""
    bench = Bench(connect=False)
    bench.agent.silent = True
    led = Led(bench)
    said = []
    StatusLed(bench.node, led, said.append)
    return bench, led, said


def come(bench):
    """The agent is there, and has been looked at."""
    bench.agent.silent = False
    bench.connect()
    bench.run(200)


def test_it_looks_ten_times_a_second_and_says_each_news_once() -> None:
    bench, led, said = watched()
    bench.run(1000)
    times = [t for t, _ in led.shown]
    assert len(times) == 10 and [b - a for a, b in zip(times, times[1:])] == [100] * 9
    assert [level for _, level in led.shown] == [True, False] * 5
    assert said == ["looking for the agent"]
    come(bench)
    del led.shown[:]
    bench.run(1000)
    assert [level for _, level in led.shown] == [True] * 10
    assert said == ["looking for the agent", "connected to the agent"]


def test_an_agent_that_is_lost_is_told_with_the_reason_once_and_found_again() -> None:
    bench, led, said = watched()
    come(bench)
    del said[:]
    for _ in range(2):  # the same again is news again
        del led.shown[:]
        bench.node.connection.end("the cable fell out")
        bench.run(300)
        assert [level for _, level in led.shown] == [False, True, False]
        come(bench)
        assert led.shown[-1][1] is True
        assert said == ["no agent: the cable fell out", "connected to the agent"]
        del said[:]


def test_an_agent_that_is_back_before_the_next_look_is_told_too() -> None:
    bench, led, said = watched()
    come(bench)
    del said[:]
    bench.node.connection.connections += 1  # as a new session does
    bench.run(100)
    assert said == ["connected to the agent"] and led.shown[-1][1] is True
