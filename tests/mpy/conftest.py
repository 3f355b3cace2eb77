"""Fixtures that start a MicroPython."""

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
    """Return a function that provides a MicroPython for one module of portable tests.

    The MicroPython has uros, the shared modules and that module, all as ``"py"`` or all as
    ``"mpy"``. It is reused until another module or form is requested, since starting it takes
    longer than most tests.
    """
    with ExitStack() as stack:
        installed: tuple[Path, str] | None = None
        board: MicroPython

        def get(module: Path, form: str) -> MicroPython:
            nonlocal installed, board
            if (module, form) != installed or board.ended:
                stack.close()
                installed = None
                files = {**portable_sources(), **shared_sources(), **type_sources(module)}
                files[module.name] = module.read_text(encoding="utf-8")
                board = stack.enter_context(MicroPython())
                board.install(compiled(files) if form == "mpy" else files)
                installed = module, form
            return board

        yield get
