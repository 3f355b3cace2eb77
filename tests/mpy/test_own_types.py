"""Tests of programs with their own interface types, on virtual boards of both engines."""

from pathlib import Path

import pytest
from mpy.harness import INSTALLED

from uros.boards.virtual.engine.runner import RunningBoard, StartError

BOARD = "ra6m5_sensor_node"
PROGRAM = """
from board_own_msgs.msg import Level

print("level", Level(height=1.5).height)
"""


@pytest.mark.parametrize("engine", ["cpython", "micropython"])
def test_types_from_a_folder_of_definitions(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, engine: str
) -> None:
    monkeypatch.setenv("UROS_MICROPYTHON", str(INSTALLED))
    file = tmp_path / "board_own_msgs" / "msg" / "Level.msg"
    file.parent.mkdir(parents=True)
    file.write_text("float32 height\n")
    folder = tmp_path / "firmware"
    folder.mkdir()
    (folder / "main.py").write_text(PROGRAM)
    with pytest.raises(StartError, match="by --interfaces DIR"):
        RunningBoard(folder, BOARD, engine).start()
    folders = [tmp_path / "board_own_msgs"]
    with RunningBoard(folder, BOARD, engine, interfaces=folders) as board:
        board.wait("level 1.5")
        assert board.wait_end() == ""
        board.press("reset")
        board.wait("level 1.5")
