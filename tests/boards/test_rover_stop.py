"""SprTurtleBot stops a second after its last command, whatever its main core does meanwhile.

No agent and no network: the program's own callbacks are called, and then its main loop is blocked.
"""

import queue
import shutil

import pytest

from uros.boards.virtual.engine.runner import RunningBoard, firmware_folder
from uros.boards.virtual.models.catalog import BOARDS

pytestmark = pytest.mark.timeout(120)

NAME = "sprturtlebot"
V = 0.25
# A second at that speed, what a loaded host takes longer, and the way to stop.
FARTHEST = 0.40

DRIVE = '''
import time
from geometry_msgs.msg import Vector3


def block():
    %s


def spin():
    for _ in range(10):
        core.node.spin_once(0.02)


def step():
    """Drive, and block the main loop in the next moment."""
    if core is None:
        start()
    core.on_motor_power(Bool(data=True))
    spin()
    core.on_cmd_vel(Twist(linear=Vector3(x=%s)))
    spin()
    print("commanded")
    block()
    print("blocked")
    while True:
        time.sleep_ms(1000)
'''
BLOCKS = {
    "camera": "Camera(**config.CAMERA); Camera(**config.CAMERA); Camera(**config.CAMERA)",
    "sleep": "time.sleep(3)",
    "loop": "while True: pass",
    "error": "raise RuntimeError('a callback')",
}


END = """

if __name__ == "__main__":
    start()
    while True:
        step()
"""


@pytest.mark.parametrize("engine", ["cpython", "micropython"])
@pytest.mark.parametrize("block", BLOCKS)
def test_it_stops_a_second_after_the_last_command_while_the_main_core_hangs(
    tmp_path, engine, block
):
    program = tmp_path / "program"
    shutil.copytree(firmware_folder(BOARDS[NAME]), program)
    main = (program / "main.py").read_text()
    head, _, _ = main.partition("\ndef step() -> None:")
    (program / "main.py").write_text(head + DRIVE % (BLOCKS[block], V) + END)
    happen = ["camera:slow"] if block == "camera" else []
    events = queue.Queue()
    with RunningBoard(program, NAME, engine, happen=happen, on_event=events.put):
        while events.get(timeout=30).get("line") != "commanded":
            pass
        way = standing(events)
    assert 0.1 < way < FARTHEST


def standing(events):
    """How far it has driven to the east when it stands again, in metres."""
    way = 0.0
    while True:
        try:
            event = events.get(timeout=2.0 if way > 0.05 else 30.0)
        except queue.Empty:
            return way
        if event["event"] == "part" and event["name"] == "rover":
            way = float(event["shows"].split(" m")[0])
