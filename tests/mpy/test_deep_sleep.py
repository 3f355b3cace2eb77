"""Tests of boards that sleep between messages: one client for the agent, one node for ROS."""

from pathlib import Path

import pytest
from mpy.harness import INSTALLED
from support.ports import lasting_port
from support.variants import slow_except
from uros.interfaces.std_msgs.msg import Int32

from uros.boards.virtual.engine.runner import RunningBoard
from uros.boards.virtual.engine.testing import board_with_agent

PROGRAM = """
import machine
from std_msgs.msg import Int32
from uros.client import Node
from uros.client.deep_sleep import deep_sleep, wait_for_agent
LINE

rtc = machine.RTC()
wakes = len(rtc.memory())
rtc.memory(rtc.memory() + b"x")
print("cause", machine.reset_cause())
node = Node("sleeper", line)
publisher = node.create_publisher(Int32, "wakes", 10)
node.create_subscription(Int32, "commands", lambda message: print("command", message.data), 10)
assert wait_for_agent(node, 60)
node.spin_some(0.2)  # commands that wait
assert publisher.publish(Int32(data=wakes))
deep_sleep(node, SLEEP_MS, 60)
"""
LINES = {
    "serial": (
        "esp32_publisher",
        """
from machine import UART
from uros.transport.serial import StreamTransport
line = StreamTransport(UART(2, 115200, rxbuf=512))
""",
    ),
    "udp": (
        "esp32_wifi_publisher",
        """
from uros.transport.udp import UdpTransport
from uros.transport.wlan import Over, Station
line = Over(Station("robots", "secret99"), UdpTransport("10.16.1.2", local_port=PORT))
""",
    ),
}


@pytest.fixture(params=slow_except(["cpython", "micropython"], "micropython"))
def engine(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> str:
    monkeypatch.setenv("UROS_MICROPYTHON", str(INSTALLED))
    return str(request.param)


def program(folder: Path, kind: str, port: int, sleep_ms: int) -> Path:
    folder.mkdir()
    text = PROGRAM.replace("LINE", LINES[kind][1]).replace("PORT", str(port))
    (folder / "main.py").write_text(text.replace("SLEEP_MS", str(sleep_ms)))
    return folder


@pytest.mark.parametrize("kind", slow_except(LINES, "udp"))
def test_a_board_that_sleeps_stays_one_client_and_one_node(
    engine: str, kind: str, tmp_path: Path
) -> None:
    folder = program(tmp_path / "program", kind, lasting_port(""), 50)
    with board_with_agent(folder, LINES[kind][0], engine) as (board, node):
        wakes: list[Int32] = []
        node.create_subscription(Int32, "/wakes", wakes.append, 10)
        node.spin_until(lambda: len(wakes) >= 3, "three wakes")
        assert [message.data for message in wakes[:3]] == [0, 1, 2]
        board.wait("cause 1")
        board.wait("cause 4")
        board.wait("cause 4")
        log = node.agent_log()
    assert log.count("participant created") == log.count("datareader created") == 1, log
    assert log.count("session re-established") >= 2 and log.count("session established") == 1, log


def test_messages_to_a_sleeping_board_wait_for_it(tmp_path: Path) -> None:
    folder = program(
        tmp_path / "program", "udp", lasting_port(""), 0
    )  # until its button is pressed
    with board_with_agent(folder, "esp32_wifi_publisher") as (board, node):
        publisher = node.create_publisher(Int32, "/commands", 10)
        board.wait_asleep()
        for number in range(3):
            assert publisher.publish(Int32(data=number))
        board.reset()
        for number in range(3):
            board.wait(f"command {number}")
        board.wait_asleep()


def test_without_an_agent_a_board_sleeps_after_its_patience(tmp_path: Path) -> None:
    folder = program(tmp_path / "program", "serial", 0, 0)
    main = folder / "main.py"
    text = main.read_text().replace("assert wait_for_agent(node, 60)", "wait_for_agent(node, 0.2)")
    main.write_text(text.replace("assert publisher", "assert not publisher"))
    with RunningBoard(folder, "esp32_publisher") as board:
        board.wait_asleep()
        assert board.resets == 0
