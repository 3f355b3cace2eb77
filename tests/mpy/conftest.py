"""Fixtures that hold a MicroPython."""

from collections.abc import Iterator

import pytest
from mpy.harness import MicroPython, portable_sources


@pytest.fixture
def micropython() -> Iterator[MicroPython]:
    """A bare MicroPython for one test."""
    with MicroPython() as board:
        yield board


@pytest.fixture(scope="module")
def portable_module(request: pytest.FixtureRequest) -> Iterator[MicroPython]:
    """A MicroPython with uros and one portable test module, shared by that module's tests."""
    with MicroPython() as board:
        board.install(portable_sources())
        board.write(f"/lib/{request.param.name}", request.param.read_text(encoding="utf-8"))
        yield board
