"""Runs every portable test of tests/unit on MicroPython, from bytecode and from sources.

`make test` runs every fourth one, from bytecode. test_build.py runs them in a build with all
passes.
"""

from collections.abc import Callable
from pathlib import Path

import pytest
from mpy.harness import ROOT, MicroPython, portable_tests


@pytest.mark.parametrize(
    ("form", "module", "function"),
    [
        pytest.param(
            form,
            file,
            function,
            id=f"{form}-{file.relative_to(ROOT)}::{function}",
            marks=pytest.mark.slow if form == "py" or number % 4 else (),
        )
        for form in ("py", "mpy")
        for number, (file, function) in enumerate(portable_tests())
    ],
)
def test_portable(
    board_with: Callable[[Path, str], MicroPython], form: str, module: Path, function: str
) -> None:
    board_with(module, form).run(f"import {module.stem}\n{module.stem}.{function}()")
