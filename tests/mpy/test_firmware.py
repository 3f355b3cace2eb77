"""Tests of ra6m5_usb_text on its virtual board, on both engines."""

import os
import re
import select
import time
import tty
from collections.abc import Iterator
from pathlib import Path

import pytest
from support.variants import slow_except

from uros.boards.virtual.engine.runner import RunningBoard

LINE = re.compile(
    r"Room: (-?\d+\.\d)C\|(-?\d+\.\d)F \| Hot: (-?\d+\.\d)C\|(-?\d+\.\d)F"
    r" \| Cold: (-?\d+\.\d)C\|(-?\d+\.\d)F \| Hum: (\d+)% \| Door: (Opened|Closed) \| Lux: (\d+)"
)
SECONDS = 20.0


class Console:
    """A serial console on the board's line."""

    def __init__(self, path: Path) -> None:
        self._fd = os.open(path, os.O_RDWR | os.O_NOCTTY)
        tty.setraw(self._fd)
        self._data = b""

    def line(self) -> str:
        deadline = time.monotonic() + SECONDS
        while b"\r\n" not in self._data:
            wait = deadline - time.monotonic()
            assert wait > 0 and select.select([self._fd], [], [], wait)[0], "no line"
            self._data += os.read(self._fd, 4096)
        line, self._data = self._data.split(b"\r\n", 1)
        return line.decode()

    def until(self, text: str) -> str:
        """Return the first of the next twenty lines that contains the text."""
        lines = []
        for _ in range(20):
            lines.append(self.line())
            if text in lines[-1]:
                return lines[-1]
        raise AssertionError(f"{text!r} is in none of {lines}")

    def close(self) -> None:
        os.close(self._fd)


@pytest.fixture(params=slow_except(["cpython", "micropython"], "micropython"))
def board(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[RunningBoard]:
    with RunningBoard("ra6m5_usb_text", engine=request.param, link=tmp_path / "tty") as running:
        running.wait_usb("configured")
        yield running


@pytest.fixture
def console(board: RunningBoard) -> Iterator[Console]:
    opened = Console(board.path)
    yield opened
    opened.close()


def test_the_text_of_phase_a(console: Console) -> None:
    console.line()  # the first line may be incomplete
    for _ in range(3):
        match = LINE.fullmatch(console.line())
        assert match
        for celsius, fahrenheit in ((1, 2), (3, 4), (5, 6)):
            # Both values are rounded.
            assert abs(float(match[celsius]) * 1.8 + 32 - float(match[fahrenheit])) < 0.15
        assert 0 <= int(match[7]) <= 100


def test_a_sensor_that_fails_and_comes_back(board: RunningBoard, console: Console) -> None:
    board.happen("sht3x:nack")
    failing = console.until("Room: --")
    assert "Hot: --" not in failing and "Hum: --" in failing
    board.happen("sht3x:off")
    assert LINE.fullmatch(console.until("% | Door"))
    board.happen("vcnl4010:absent")
    console.until("Door: --")
    board.happen("all:off")
    console.until("Door: Closed")
