"""Fixtures that hold a MicroPython."""

from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path

import pytest
from mpy.harness import MicroPython, compiled, portable_sources, shared_sources, type_sources


@pytest.fixture
def micropython() -> Iterator[MicroPython]:
    """A bare MicroPython for one test."""
    with MicroPython() as board:
        yield board


@pytest.fixture(scope="module")
def board_with() -> Iterator[Callable[[Path, str], MicroPython]]:
    """A MicroPython with uros, what tests share and one module of portable tests, all as ``"py"``
    or all as ``"mpy"``: the same one as long as that is asked for, since starting it takes longer
    than most tests."""
    with ExitStack() as stack:
        holding: tuple[Path, str] | None = None
        board: MicroPython

        def get(module: Path, form: str) -> MicroPython:
            nonlocal holding, board
            if (module, form) != holding or board.ended:
                stack.close()
                holding = None
                files = {**portable_sources(), **shared_sources(), **type_sources(module)}
                files[module.name] = module.read_text(encoding="utf-8")
                board = stack.enter_context(MicroPython())
                board.install(compiled(files) if form == "mpy" else files)
                holding = module, form
            return board

        yield get
