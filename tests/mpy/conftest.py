"""Fixtures that hold a MicroPython."""

from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path

import pytest
from mpy.harness import MicroPython, portable_sources, shared_sources


@pytest.fixture
def micropython() -> Iterator[MicroPython]:
    """A bare MicroPython for one test."""
    with MicroPython() as board:
        yield board


@pytest.fixture(scope="module")
def board_with() -> Iterator[Callable[[Path], MicroPython]]:
    """A MicroPython with uros, what tests share and one module of portable tests: the same one as
    long as that module is asked for, since starting it takes longer than most of its tests."""
    with ExitStack() as stack:
        holding: Path | None = None
        board: MicroPython

        def get(module: Path) -> MicroPython:
            nonlocal holding, board
            if module != holding:
                stack.close()
                holding = None
                board = stack.enter_context(MicroPython())
                board.install(portable_sources())
                board.install(shared_sources())
                board.write(f"/lib/{module.name}", module.read_text(encoding="utf-8"))
                holding = module
            return board

        yield get
