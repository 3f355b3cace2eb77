"""Finds the messages that a program makes without saying what is in them, as ``Imu()``.

Their constructors need no parameters on a board: each costs some ten bytes there.
"""

from __future__ import annotations

import ast
from collections.abc import Iterable, Iterator

from .shrink import FUNCTIONS, Module, absolute

# Those who take a type make its messages without arguments, if at all.
_TAKERS = {
    "isinstance", "create_publisher", "create_subscription", "create_service", "create_client",
}  # fmt: skip


# Where else a class is at hand: ``publisher.type(1)``, ``type(message)(1)``.
_CLASSES = {"type", "__class__"}


def bare(modules: Iterable[Module], types: Iterable[str]) -> frozenset[str]:
    """Of the types, as ``sensor_msgs/msg/Imu``, those never made with arguments by any module.

    Whoever does anything else with a type's name than calling it, importing it, and giving it to a
    node may do that; then the type is not among them.
    """
    found = set(types)
    spoken: set[str] = set()  # names by which a type may be got in a roundabout way
    known: dict[str, set[str]] = {name: {name.rpartition("/")[2]} for name in found}
    for module in modules:
        local: dict[str, str] = {}
        if module.own and any(map(_by_class, ast.walk(module.tree))):
            return frozenset()
        for node in ast.walk(module.tree):
            if isinstance(node, ast.Attribute):
                spoken.add(node.attr)
            elif isinstance(node, ast.ImportFrom):
                package = absolute(node, module).replace(".", "/")
                for alias in node.names:
                    name = f"{package}/{alias.name}"
                    if name in known:
                        local[alias.asname or alias.name] = name
                        known[name].add(alias.asname or alias.name)
                    else:
                        spoken.add(alias.name)
        harmless = {id(node) for node in _harmless(module.tree)}
        for node in ast.walk(module.tree):
            if isinstance(node, ast.Name) and node.id in local and id(node) not in harmless:
                found.discard(local[node.id])
    return frozenset(name for name in found if not known[name] & spoken)


def _by_class(node: ast.AST) -> bool:
    """Whether a message is made with arguments by a class that has no name there."""
    if not isinstance(node, ast.Call) or not (node.args or node.keywords):
        return False
    made = node.func.func if isinstance(node.func, ast.Call) else node.func
    name = made.attr if isinstance(made, ast.Attribute) else getattr(made, "id", "")
    return name in _CLASSES and (isinstance(made, ast.Attribute) or made is not node.func)


def _harmless(tree: ast.Module) -> Iterator[ast.AST]:
    """The places of names where nothing is made of them with arguments."""
    for node in ast.walk(tree):
        told: list[ast.expr | None] = []
        if isinstance(node, ast.Call):
            name = node.func.attr if isinstance(node.func, ast.Attribute) else ""
            if isinstance(node.func, ast.Name):
                name = node.func.id
                if not node.args and not node.keywords:
                    yield node.func
            if name in _TAKERS:
                yield from node.args
                yield from (it.value for it in node.keywords)
        elif isinstance(node, FUNCTIONS):
            told = [node.returns]
        elif isinstance(node, (ast.arg, ast.AnnAssign)):
            told = [node.annotation]
        for annotation in filter(None, told):
            yield from ast.walk(annotation)
