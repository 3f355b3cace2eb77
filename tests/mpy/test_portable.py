"""Every portable test of tests/unit again, on MicroPython."""

from collections.abc import Callable
from pathlib import Path

import pytest
from mpy.harness import ROOT, MicroPython, portable_tests


@pytest.mark.parametrize(
    ("module", "function"),
    [
        pytest.param(file, function, id=f"{file.relative_to(ROOT)}::{function}")
        for file, function in portable_tests()
    ],
)
def test_portable(
    board_with: Callable[[Path], MicroPython], module: Path, function: str
) -> None:
    board_with(module).run(f"import {module.stem}\n{module.stem}.{function}()")
