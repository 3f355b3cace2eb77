"""SprTurtleBot stops a second after its last command, also while its main core is blocked.

There is neither an agent nor a network: the test program calls the firmware's callbacks, and then
blocks the main loop.
"""

import queue
import shutil

import pytest

from uros.boards.virtual.engine.runner import RunningBoard, firmware_folder
from uros.boards.virtual.models.catalog import BOARDS

pytestmark = pytest.mark.timeout(120)

NAME = "sprturtlebot"
V = 0.25
# Metres: one second at that speed, the delay of a loaded host, and the stopping distance. A rover
# that goes on until the main core is back drives for at least three seconds, 0.75 m.
MAX_DISTANCE = 0.60

DRIVE = '''
import time
from geometry_msgs.msg import Vector3


def block():
    %s


def spin():
    for _ in range(10):
        core.node.spin_once(0.02)


def step():
    """Drive, and then block the main loop."""
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


@pytest.mark.parametrize(
    ("block", "engine"),
    [
        pytest.param(block, engine, marks=() if block == "loop" else pytest.mark.slow)
        for block in BLOCKS
        for engine in ("cpython", "micropython")
    ],
)
def test_the_rover_stops_a_second_after_the_last_command_while_the_main_core_hangs(
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
        distance = stopping_distance(events)
    assert 0.1 < distance < MAX_DISTANCE


def stopping_distance(events):
    """Wait until the rover stands again; return the distance to the east in metres."""
    distance = 0.0
    while True:
        try:
            event = events.get(timeout=2.0 if distance > 0.05 else 30.0)
        except queue.Empty:
            return distance
        if event["event"] == "part" and event["name"] == "rover":
            distance = float(event["shows"].split(" m")[0])
