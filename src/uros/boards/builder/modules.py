"""A module of a board's file system, and what it imports."""

from __future__ import annotations

import ast
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from typing import Final

from .scopes import FUNCTIONS

ABSENT: Final = {
    "__future__", "abc", "collections.abc", "contextlib", "dataclasses", "enum", "functools",
    "threading", "typing", "typing_extensions", "weakref",
}  # fmt: skip
"""Modules of CPython that MicroPython lacks: importing one fails there."""
_IMPORT_ERRORS: Final = {"ImportError", "Exception", "BaseException"}


@dataclass
class Module:
    """One module of a board's file system.

    ``own`` is a module of the program: its text is not changed, and all of it is live.
    """

    name: str
    package: bool
    source: str
    """Where it comes from, for messages."""
    text: str
    tree: ast.Module
    own: bool = False
    finals: set[str] = field(default_factory=set)
    """Names that the module declares Final, found by `strip`."""

    @property
    def path(self) -> str:
        """Its file on the board, without the suffix."""
        return self.name.replace(".", "/") + ("/__init__" if self.package else "")


@dataclass(frozen=True)
class Wanted:
    """One import: ``import module`` (names is None) or ``from module import names``."""

    module: str
    names: tuple[tuple[str, str], ...] | None
    """Pairs of the name there and the name here."""
    line: int
    optional: bool
    """It stands in a try that catches ImportError, or in what that does then."""
    late: bool
    """It stands in a function."""
    perhaps: bool = False
    """That is a method which Python itself calls, so that the program did not ask for it."""


def absolute(node: ast.ImportFrom, module: Module) -> str:
    """The full name of the module that a from-import names."""
    if not node.level:
        return node.module or ""
    parts = module.name.split(".")
    base = parts[: len(parts) - node.level + module.package]
    return ".".join((*base, *(node.module or "").split("."))).strip(".")


def imports(module: Module) -> Iterator[Wanted]:
    """Every import of a module, wherever it stands."""

    def visit(node: ast.AST, optional: bool, late: str) -> Iterator[Wanted]:
        perhaps = late.startswith("__")
        if isinstance(node, ast.Import):
            for alias in node.names:
                yield Wanted(alias.name, None, node.lineno, optional, bool(late), perhaps)
        elif isinstance(node, ast.ImportFrom):
            names = tuple((alias.name, alias.asname or alias.name) for alias in node.names)
            base = absolute(node, module)
            yield Wanted(base, names, node.lineno, optional, bool(late), perhaps)
        elif isinstance(node, ast.Try):
            tolerant = optional or any(catches_import_error(h) for h in node.handlers)
            for child in (*node.body, *node.handlers):
                yield from visit(child, tolerant, late)
            for child in (*node.orelse, *node.finalbody):
                yield from visit(child, optional, late)
        else:
            if isinstance(node, FUNCTIONS):
                late = late or node.name
            for child in ast.iter_child_nodes(node):
                yield from visit(child, optional, late)

    return visit(module.tree, False, "")


def catches_import_error(handler: ast.ExceptHandler) -> bool:
    """Whether an except clause catches a failed import."""
    if handler.type is None:
        return True
    types = handler.type.elts if isinstance(handler.type, ast.Tuple) else [handler.type]
    return any(isinstance(t, ast.Name) and t.id in _IMPORT_ERRORS for t in types)


def named_from_outside(modules: Iterable[Module]) -> set[str]:
    """Names by which another module may take one: of imports, attributes, and in strings."""
    used: set[str] = set()
    for module in modules:
        for node in ast.walk(module.tree):
            if isinstance(node, ast.Attribute):
                used.add(node.attr)
            elif isinstance(node, ast.ImportFrom):
                used.update(alias.name for alias in node.names)
            elif isinstance(node, ast.Constant) and isinstance(node.value, str):
                used.add(node.value)
    return used


def known_names(tree: ast.Module, others: Iterable[Module]) -> set[str]:
    """The names that others may know, and those that are asked for by their text."""
    names = {"__init__"}
    for other in others:
        for node in ast.walk(other.tree):
            names.update(value for value in vars(node).values() if isinstance(value, str))
            for value in vars(node).values():  # as of global statements
                if isinstance(value, list):
                    names.update(it for it in value if isinstance(it, str))
    for node in ast.walk(tree):
        if isinstance(node, ast.Constant) and isinstance(node.value, str):
            names.add(node.value)
        elif isinstance(node, ast.keyword) and node.arg:
            names.add(node.arg)
        elif isinstance(node, ast.alias):
            names.update((node.name, node.asname or node.name))
    return names
