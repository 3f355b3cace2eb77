"""Every portable test of tests/unit again, on MicroPython."""

import pytest
from mpy.harness import ROOT, MicroPython, portable_tests


@pytest.mark.parametrize(
    ("portable_module", "name", "function"),
    [
        pytest.param(file, file.stem, function, id=f"{file.relative_to(ROOT)}::{function}")
        for file, function in portable_tests()
    ],
    indirect=["portable_module"],
)
def test_portable(portable_module: MicroPython, name: str, function: str) -> None:
    portable_module.run(f"import {name}\n{name}.{function}()")
