"""A module of a board's file system, and what it imports."""

from __future__ import annotations

import ast
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from typing import Final

from .scopes import FUNCTIONS, walk

ABSENT: Final = {
    "__future__", "abc", "collections.abc", "contextlib", "dataclasses", "enum", "functools",
    "threading", "typing", "typing_extensions", "weakref",
}  # fmt: skip
"""Modules of CPython that MicroPython lacks: importing one fails there."""
_IMPORT_ERRORS: Final = {"ImportError", "Exception", "BaseException"}


@dataclass
class Module:
    """One module of a board's file system.

    With ``own``, the module is one of the program: its text is not changed, and all of it is live.
    """

    name: str
    package: bool
    source: str
    """Its file, for error messages."""
    text: str
    tree: ast.Module
    own: bool = False
    finals: set[str] = field(default_factory=set)
    """Names that the module declares Final, found by `strip`."""

    @property
    def path(self) -> str:
        """The path of its file on the board, without the suffix."""
        return self.name.replace(".", "/") + ("/__init__" if self.package else "")


@dataclass(frozen=True)
class Wanted:
    """One import: ``import module`` (names is None) or ``from module import names``."""

    module: str
    names: tuple[tuple[str, str], ...] | None
    """Pairs of the name in that module and the name that the import binds."""
    line: int
    optional: bool
    """The import is in a ``try`` that catches ImportError, or in a handler of that ``try``."""
    late: bool
    """The import is in a function."""
    in_special_method: bool = False
    """That function is a special method: Python calls it, and not the program by its name."""


def absolute(node: ast.ImportFrom, module: Module) -> str:
    """Return the full name of the module that a from-import names."""
    if not node.level:
        return node.module or ""
    parts = module.name.split(".")
    base = parts[: len(parts) - node.level + module.package]
    return ".".join((*base, *(node.module or "").split("."))).strip(".")


def imports(module: Module) -> Iterator[Wanted]:
    """Yield every import of a module, also of functions and nested blocks."""

    def visit(node: ast.AST, optional: bool, function: str) -> Iterator[Wanted]:
        in_special_method = function.startswith("__")
        if isinstance(node, ast.Import):
            for alias in node.names:
                yield Wanted(
                    alias.name, None, node.lineno, optional, bool(function), in_special_method
                )
        elif isinstance(node, ast.ImportFrom):
            names = tuple((alias.name, alias.asname or alias.name) for alias in node.names)
            base = absolute(node, module)
            yield Wanted(base, names, node.lineno, optional, bool(function), in_special_method)
        elif isinstance(node, ast.Try):
            tolerant = optional or any(catches_import_error(handler) for handler in node.handlers)
            for child in (*node.body, *node.handlers):
                yield from visit(child, tolerant, function)
            for child in (*node.orelse, *node.finalbody):
                yield from visit(child, optional, function)
        elif not isinstance(node, ast.expr):  # an expression has no statements
            if isinstance(node, FUNCTIONS):
                function = function or node.name
            for child in ast.iter_child_nodes(node):
                yield from visit(child, optional, function)

    return visit(module.tree, False, "")


def catches_import_error(handler: ast.ExceptHandler) -> bool:
    """Whether an except clause catches a failed import."""
    if handler.type is None:
        return True
    types = handler.type.elts if isinstance(handler.type, ast.Tuple) else [handler.type]
    return any(isinstance(kind, ast.Name) and kind.id in _IMPORT_ERRORS for kind in types)


def named_from_outside(modules: Iterable[Module]) -> set[str]:
    """Return the names that may refer to another module's: of imports, attributes and strings."""
    used: set[str] = set()
    for module in modules:
        for node in walk(module.tree):
            if isinstance(node, ast.Attribute):
                used.add(node.attr)
            elif isinstance(node, ast.ImportFrom):
                used.update(alias.name for alias in node.names)
            elif isinstance(node, ast.Constant) and isinstance(node.value, str):
                used.add(node.value)
    return used


def known_names(tree: ast.Module, others: Iterable[Module]) -> set[str]:
    """Return the names of a bundle that no pass may change.

    These are all names and strings of the other modules, and of the bundle its strings, the
    keywords of calls and the names of imports.
    """
    names = {"__init__"}
    for other in others:
        for node in walk(other.tree):
            names.update(value for value in vars(node).values() if isinstance(value, str))
            for value in vars(node).values():  # as of global statements
                if isinstance(value, list):
                    names.update(text for text in value if isinstance(text, str))
    for node in walk(tree):
        if isinstance(node, ast.Constant) and isinstance(node.value, str):
            names.add(node.value)
        elif isinstance(node, ast.keyword) and node.arg:
            names.add(node.arg)
        elif isinstance(node, ast.alias):
            names.update((node.name, node.asname or node.name))
    return names
