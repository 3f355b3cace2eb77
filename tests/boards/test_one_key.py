"""Two boards with one client key, as two copies of one board have: the first keeps its place."""

import pytest
from support.agent import running_agent
from support.waiting import eventually

from uros.boards.virtual.engine.runner import RunningBoard

pytestmark = pytest.mark.timeout(120)

BOARD = "esp32_wifi_publisher"


@pytest.mark.parametrize("engine", ["cpython", "micropython"])
def test_the_first_goes_on_and_the_second_comes_in_when_it_has_left(engine):
    with running_agent("udp", "memory", 0) as agent:
        where = ("127.0.0.1", agent.transport.port)
        # A board's number, and with it its key, comes from the seed.
        with RunningBoard(BOARD, engine=engine, agent=where, address="127.0.0.21") as first:
            first.wait("connected to the agent")
            with RunningBoard(BOARD, engine=engine, agent=where, address="127.0.0.22") as second:
                eventually(lambda: "client key in use" in agent.said.getvalue())
                assert not [it for it in list(second.console.queue) if "connected" in it]
                assert first.console.empty()  # it was not disturbed
                first.stop()
                second.wait("connected to the agent", 60)
