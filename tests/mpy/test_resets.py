"""Tests of watchdog, deep sleep and the causes of resets on a virtual board, on both engines."""

from collections.abc import Iterator
from pathlib import Path

import pytest
from mpy.harness import INSTALLED
from support.variants import slow_except
from uros.interfaces.std_msgs.msg import Empty

from uros.boards.virtual.engine.runner import RunningBoard
from uros.boards.virtual.engine.testing import board_with_agent

# What is done is chosen by the memory, which resets keep.
PROGRAM = """
import machine, time

rtc = machine.RTC()
steps = rtc.memory()
print("cause", machine.reset_cause(), "step", len(steps))
rtc.memory(steps + b"x")
if len(steps) == 0:
    machine.soft_reset()
elif len(steps) == 1:
    machine.reset()
elif len(steps) == 2:
    machine.deepsleep(10)
elif len(steps) == 3:
    machine.WDT(timeout=50)
    HANG
elif len(steps) == 4:
    watchdog = machine.WDT(timeout=3600000)
    watchdog.feed()
    machine.deepsleep()
try:
    rtc.memory(bytes(2049))
except ValueError as error:
    print(error)
while True:
    time.sleep(1)
"""
HANGS = {
    "loop": "while True: pass",
    "sleep": "time.sleep(3600)",
}


@pytest.fixture(params=slow_except(["cpython", "micropython"], "micropython"))
def engine(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> str:
    monkeypatch.setenv("UROS_MICROPYTHON", str(INSTALLED))
    return str(request.param)


@pytest.fixture(params=slow_except(HANGS, "loop"))
def board(request: pytest.FixtureRequest, engine: str, tmp_path: Path) -> Iterator[RunningBoard]:
    folder = tmp_path / "program"
    folder.mkdir()
    (folder / "main.py").write_text(PROGRAM.replace("HANG", HANGS[request.param]))
    with RunningBoard(folder, "esp32_publisher", engine) as running:
        yield running


def test_each_reset_has_its_cause_and_the_memory_is_kept(board: RunningBoard) -> None:
    for step, cause in enumerate((1, 5, 2, 4, 3)):
        board.wait(f"cause {cause} step {step}")
    board.wait_asleep()
    assert board.resets == 4
    board.reset()  # wakes it from a sleep without an end
    board.wait("cause 2 step 5")
    board.wait("buffer too long")


WATCHED = """
import machine, time
from machine import UART
from uros.client import Node
from uros.transport.serial import StreamTransport
from std_msgs.msg import Empty

print("cause", machine.reset_cause())
watchdog = machine.WDT(timeout=1500)
node = Node("watched", StreamTransport(UART(2, 115200)), watchdog=watchdog)

def hang(message):
    print("hangs")
    while True:
        time.sleep_ms(100)

node.create_subscription(Empty, "hang", hang, 10)
node.spin()
"""


def test_a_callback_that_hangs_resets_the_board_which_connects_again(
    engine: str, tmp_path: Path
) -> None:
    folder = tmp_path / "program"
    folder.mkdir()
    (folder / "main.py").write_text(WATCHED)
    with board_with_agent(folder, "esp32_publisher", engine) as (board, node):
        board.wait("cause 1")
        publisher = node.create_publisher(Empty, "/hang", 10)
        node.spin_until(lambda: node.connection.matched(publisher), "the board")
        for _ in range(2):
            publisher.publish(Empty())
            board.wait("hangs")
            # A client that waits long for the first answer asks again: that counts as well.
            before = node.agent_log().count("re-established")
            board.wait("cause 3")
            node.spin_until(
                lambda before=before: node.agent_log().count("re-established") > before,
                "the session to go on",
            )
