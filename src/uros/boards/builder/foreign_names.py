"""The names that are MicroPython's own, and those of what boards' firmware brings.

They are a file, ``foreign_names.txt``, which ``scripts/foreign_names.py`` makes: a build is the
same on every Python that makes it.
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
"""Of objects that are not ours: of builtin types, and of what stands for hardware."""
CLASSES: Final = frozenset(_NAMES["class"])
"""Builtin classes, exceptions too."""
BUILTINS: Final = CLASSES.union(_NAMES["builtin"])
"""All that a module has without importing it."""
