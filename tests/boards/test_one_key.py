"""Two boards with the same client key, as copies of one board have: the first keeps its session."""

import pytest
from support.agent import running_agent
from support.variants import slow_except
from support.waiting import eventually

from uros.boards.virtual.engine.runner import RunningBoard

pytestmark = pytest.mark.timeout(120)

BOARD = "esp32_wifi_publisher"


@pytest.mark.parametrize("engine", slow_except(["cpython", "micropython"], "cpython"))
def test_the_second_board_connects_when_the_first_has_left(engine):
    with running_agent("udp", "memory", 0) as agent:
        address = ("127.0.0.1", agent.transport.port)
        # A board's unique number, and so its client key, is derived from the seed.
        with RunningBoard(BOARD, engine=engine, agent=address, address="127.0.0.21") as first:
            first.wait("connected to the agent")
            with RunningBoard(BOARD, engine=engine, agent=address, address="127.0.0.22") as second:
                eventually(lambda: "client key in use" in agent.said.getvalue())
                assert not [line for line in list(second.console.queue) if "connected" in line]
                assert first.console.empty()  # its session was not interrupted
                first.stop()
                second.wait("connected to the agent", 60)
