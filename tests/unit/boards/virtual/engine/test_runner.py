"""The process of a virtual board, as the process that started it sees it."""

import pytest

from uros.boards.virtual.engine import runner
from uros.boards.virtual.engine.runner import RunningBoard, StartError


def test_a_board_that_is_not_ready_in_time_does_not_start(monkeypatch):
    monkeypatch.setattr(runner, "START_SECONDS", 0.0)
    with pytest.raises(StartError, match="waited 0 s for the board to start: is this machine busy"):
        RunningBoard("esp32_publisher").start()
