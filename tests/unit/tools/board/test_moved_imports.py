"""A board program that was written for old imports is told what to change, by each command."""

from __future__ import annotations

import os
import pty
from pathlib import Path

import pytest

from uros.tools import cli

PROGRAM = """\
import time
from uros.transport.stream import StreamTransport
"""
TOLD = "main.py:2: uros.transport.stream is now uros.transport.serial\n"


@pytest.fixture
def program(tmp_path: Path) -> Path:
    folder = tmp_path / "blinker"
    folder.mkdir()
    (folder / "main.py").write_text(PROGRAM)
    return folder


@pytest.mark.parametrize("form", [[], ["--mpy"]])
def test_build(
    program: Path, tmp_path: Path, form: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    assert cli.main(["board", "build", str(program), str(tmp_path / "out"), *form]) == 1
    assert capsys.readouterr().err == f"uros: {program}/{TOLD}"
    assert not (tmp_path / "out").exists()


def test_deploy(program: Path, capsys: pytest.CaptureFixture[str]) -> None:
    ours, theirs = pty.openpty()
    try:
        assert cli.main(["board", "deploy", str(program), "--port", os.ttyname(theirs)]) == 1
    finally:
        os.close(ours)
        os.close(theirs)
    assert capsys.readouterr().err == f"uros: {program}/{TOLD}"


@pytest.mark.parametrize("engine", ["cpython", "micropython"])
def test_run(program: Path, engine: str, capfd: pytest.CaptureFixture[str]) -> None:
    options = ["--firmware", str(program), "--engine", engine, "--no-agent"]
    assert cli.main(["board", "run", "ra6m5_sensor_node", *options]) == 1
    assert TOLD in capfd.readouterr().err
