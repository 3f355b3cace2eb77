"""Tests that the list of names that a build does not change matches MicroPython."""

import runpy

from mpy.harness import ROOT

from uros.boards.builder.foreign_names import ATTRIBUTES, BUILTINS, CLASSES


def test_the_list_is_up_to_date() -> None:
    script = runpy.run_path(str(ROOT / "scripts" / "foreign_names.py"))
    assert script["FILE"].read_text(encoding="utf-8") == script["file_text"](), (
        "run scripts/foreign_names.py"
    )


def test_the_list_has_names_of_each_kind() -> None:
    assert {"append", "errno", "args", "recv", "readinto", "any", "read_u16"} <= ATTRIBUTES
    assert {"print", "len", "ValueError", "memoryview"} <= BUILTINS
    assert {"ValueError", "object", "bytes"} <= CLASSES and "print" not in CLASSES
