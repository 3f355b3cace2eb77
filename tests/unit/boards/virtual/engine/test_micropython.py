"""Where the engine finds MicroPython, and its error if MicroPython is missing."""

import os

import pytest

from uros.boards.virtual.engine import micropython
from uros.boards.virtual.engine.micropython import NoMicroPython, find


@pytest.fixture
def installed(tmp_path):
    module = tmp_path / micropython._MODULE
    module.parent.mkdir(parents=True)
    module.touch()
    return tmp_path


def test_the_runner_and_the_shims_are_part_of_the_package():
    assert micropython.RUNNER.is_file()
    assert (micropython.RUNNER.parents[1] / "shims" / "_boot.py").is_file()


def test_micropython_is_found_in_the_named_folder(installed, monkeypatch):
    monkeypatch.setenv("UROS_MICROPYTHON", str(installed))
    node = installed / "node"
    node.touch(0o755)
    assert find() == (node, installed / micropython._MODULE)


def test_micropython_is_found_in_the_current_folder_with_node_on_the_path(installed, monkeypatch):
    monkeypatch.delenv("UROS_MICROPYTHON", raising=False)
    monkeypatch.setattr(micropython, "_HERE", installed / "a" / "b" / "c" / "d")
    monkeypatch.chdir(installed)
    programs = installed / "bin"
    programs.mkdir()
    (programs / "node").touch(0o755)
    monkeypatch.setenv("PATH", str(programs))
    assert find() == (programs / "node", installed / micropython._MODULE)
    monkeypatch.setenv("PATH", os.devnull)
    with pytest.raises(NoMicroPython, match="Node 18"):
        find()


def test_without_micropython_the_error_has_the_remedy(tmp_path, monkeypatch):
    monkeypatch.setenv("UROS_MICROPYTHON", str(tmp_path))
    with pytest.raises(NoMicroPython, match="npm install @micropython/.*UROS_MICROPYTHON"):
        find()
