"""What driving two wheels takes of a board's memory, from .mpy."""

from collections.abc import Iterator

import pytest
from mpy.harness import MicroPython, compiled, portable_sources

BEGIN = """
import gc
from uros.control.diff_drive import DiffDrive
from uros.control.odometry import Odometry
from uros.control.pid import Pid
from uros.control.wheel import Wheel
"""
DRIVE = """
right, left = Wheel(), Wheel()
pids = [Pid(150, 1000, dead_zone=21, kf=214, lag=0.13) for _ in range(2)]
drive = DiffDrive(right, left, pids[0], pids[1])
odometry = Odometry()
drive.power(True)

def steps(t, count):
    for _ in range(count):
        drive.command(0.3, 0.2)
        right.edge(t + 5000)
        left.edge(t + 7000)
        t += 20000
        drive.step(t)
        odometry.update(right.moved, left.moved, right.speed, left.speed)
    return t

t = steps(0, 20)
"""


@pytest.fixture
def board() -> Iterator[MicroPython]:
    with MicroPython() as it:
        it.install(compiled(portable_sources(("control",))))
        yield it


def test_its_modules_take_no_more_than_they_did(board: MicroPython) -> None:
    before = board.heap()
    board.run(BEGIN)
    modules = board.heap() - before
    board.run(DRIVE)
    assert modules < 9_500
    assert board.heap() - before - modules < 4_500


def test_a_turn_of_control_leaves_little_behind(board: MicroPython) -> None:
    # Each result of a float operation is 16 bytes there, as on most ports. At 50 Hz this is what a
    # board with 100 kB free collects once in a second.
    board.run(BEGIN + DRIVE)
    told = board.run(
        "gc.collect()\nbefore = gc.mem_alloc()\nt = steps(t, 8)\nprint(gc.mem_alloc() - before)"
    )
    assert int(told) / 8 < 2_700
