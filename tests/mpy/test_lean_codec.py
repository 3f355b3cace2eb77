"""Tests of the codec in a build for boards: without texts of errors, and tree-shaken."""

import ast
from pathlib import Path

import pytest
from mpy.harness import ROOT, MicroPython, tree

from uros.boards.builder.file_system import build

SOURCE = ROOT / "tests/unit/interfaces/portable_reuse.py"
TESTS = [
    node.name
    for node in ast.parse(SOURCE.read_text(encoding="utf-8")).body
    if isinstance(node, ast.FunctionDef)
    and node.name.startswith("test_")
    and node.name != "test_big_endian"  # builds with terse-errors refuse big-endian data, see below
]


@pytest.mark.parametrize("form", ["py", "mpy"])
def test_a_program_that_reuses_messages(
    micropython: MicroPython, tmp_path: Path, form: str
) -> None:
    program = tmp_path / "program"
    program.mkdir()
    (program / "main.py").write_text(
        SOURCE.read_text(encoding="utf-8") + "".join(f"\n{name}()\n" for name in TESTS),
        encoding="utf-8",
    )
    build(program, tmp_path / "out", form)
    micropython.install(tree(tmp_path / "out"))
    assert micropython.run("import main") == ""


RECEIVES = r"""
from std_msgs.msg import String
from sensor_msgs.msg import Imu

def imu(data):
    message, end = Imu.unpack_from(data, 0, 0, len(data))
    return message.header.frame_id, message.header.stamp.sec, message.angular_velocity.y, end

def fault(call, *args):
    try:
        call(*args)
    except (TypeError, ValueError) as error:
        return type(error).__name__, str(error)

def run():
    message = Imu()
    message.header.frame_id = "f"
    message.header.stamp.sec = -2
    message.angular_velocity.y = 4.5
    data = bytearray(message.cdr_size())
    message.pack_into(data, 0, 0)
    print(imu(data), len(data))
    print([end for end in range(len(data)) if fault(imu, data[:end]) is None])
    print(fault(String.unpack_from, b"\2\0\0\0\xff\0", 0, 0, 6)[0] != "TypeError")
    message.angular_velocity = message.orientation
    print(fault(message.pack_into, data, 0, 0))
    print(fault(Imu.unpack_from, data, 0, 0, len(data), False)[0] == "ValueError")
    print(fault(String.unpack_from, b"\0\0\0\1\0", 0, 0, 5, False)[0] == "ValueError")
"""


def test_a_program_that_reads_new_messages(micropython: MicroPython, tmp_path: Path) -> None:
    """A program that does not name ``unpack_into``, with a nested message in one place, works."""
    program = tmp_path / "program"
    program.mkdir()
    (program / "main.py").write_text(RECEIVES + "\nrun()\n", encoding="utf-8")
    build(program, tmp_path / "out", "mpy")
    micropython.install(tree(tmp_path / "out"))
    assert micropython.run("import main").splitlines() == [
        "('f', -2, 4.5, 312) 312",
        "[]",
        "True",
        "('TypeError', 'sensor_msgs/msg/Imu')",
        "True",
        "True",
    ]
