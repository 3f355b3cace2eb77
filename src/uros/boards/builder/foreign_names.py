"""The names that MicroPython and the firmware of boards define.

``scripts/foreign_names.py`` writes them to the file ``foreign_names.txt``, so that a build does not
depend on the Python that runs it.
"""

from __future__ import annotations

from pathlib import Path
from typing import Final


def _read() -> dict[str, set[str]]:
    names: dict[str, set[str]] = {"attribute": set(), "builtin": set(), "class": set()}
    text = Path(__file__).with_name("foreign_names.txt").read_text(encoding="utf-8")
    for line in text.splitlines():
        kind, _, name = line.partition(" ")
        if kind != "#":
            names[kind].add(name)
    return names


_NAMES: Final = _read()
ATTRIBUTES: Final = frozenset(_NAMES["attribute"])
"""Attributes of objects that uros does not define: of builtin types and of hardware classes."""
CLASSES: Final = frozenset(_NAMES["class"])
"""Builtin classes, exceptions included."""
BUILTINS: Final = CLASSES.union(_NAMES["builtin"])
"""All names that a module has without importing them."""
