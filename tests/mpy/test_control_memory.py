"""Tests the memory that the control of two wheels takes on a board, from .mpy."""

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
    with MicroPython() as micropython:
        micropython.install(compiled(portable_sources(("control",))))
        yield micropython


def test_heap_of_the_control_modules(board: MicroPython) -> None:
    before = board.heap()
    board.run(BEGIN)
    modules = board.heap() - before
    board.run(DRIVE)
    assert modules < 9_500
    assert board.heap() - before - modules < 4_500


def test_a_control_step_allocates_little(board: MicroPython) -> None:
    # Each result of a float operation takes 16 bytes, as on most ports. At 50 Hz, 2,700 bytes a
    # step fill the 100 kB of a board about once a second.
    board.run(BEGIN + DRIVE)
    allocated = board.run(
        "gc.collect()\nbefore = gc.mem_alloc()\nt = steps(t, 8)\nprint(gc.mem_alloc() - before)"
    )
    assert int(allocated) / 8 < 2_700
