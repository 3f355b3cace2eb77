"""Makes one class of a base and its only heir, where nothing but the heir names the base.

A class costs a board 150 bytes, and each step from an heir to its base some time. The heir keeps
its name and place; what it calls by ``super()`` and the base had becomes a method of another name.
"""

from __future__ import annotations

import ast
from collections.abc import Iterable

from .shrink import FUNCTIONS, bound


def flatten(tree: ast.Module, named: Iterable[str]) -> None:
    """Flatten the classes of a bundle; those that others may know by a name of ``named`` stay."""
    kept = set(named)
    while _once(tree, kept):
        pass


def _once(tree: ast.Module, kept: set[str]) -> bool:
    classes = {node.name: node for node in tree.body if isinstance(node, ast.ClassDef)}
    asked: dict[str, int] = {}
    for node in ast.walk(tree):
        if isinstance(node, ast.Name):
            asked[node.id] = asked.get(node.id, 0) + 1
    for heir in classes.values():
        if len(heir.bases) == 1 and isinstance(heir.bases[0], ast.Name):
            base = classes.get(heir.bases[0].id)
            if base and base.name not in kept and asked[base.name] == 1 and _is_plain(base, heir):
                _join(base, heir)
                tree.body.remove(base)
                return True
    return False


def _is_plain(base: ast.ClassDef, heir: ast.ClassDef) -> bool:
    """Whether both bind names and do nothing else, the base each name once."""
    for node in (*base.body, *heir.body):
        if not isinstance(node, (*FUNCTIONS, ast.Assign, ast.Pass)):
            return False
    names = list(bound(base.body))
    special = any(isinstance(n, FUNCTIONS) and n.decorator_list for n in base.body)
    return len(names) == len(set(names)) or not special


def _join(base: ast.ClassDef, heir: ast.ClassDef) -> None:
    here = set(bound(heir.body))
    calls = [
        node.func
        for node in ast.walk(heir)
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute)
    ]
    body: list[ast.stmt] = []
    for node in base.body:
        names = set(bound([node]))
        if not names & here:
            body.append(node)
            continue
        if not isinstance(node, FUNCTIONS):
            continue  # the heir's value is what counts
        above = [it for it in calls if it.attr == node.name and _is_super(it.value)]
        if above:
            node.name = "_" + node.name.strip("_") + "_of_" + base.name
            for call in above:
                call.attr = node.name
                call.value = ast.copy_location(ast.Name("self", ast.Load()), call.value)
            body.append(node)
    heir.body = [*body, *heir.body]
    heir.bases = base.bases


def _is_super(node: ast.expr) -> bool:
    return (
        isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id == "super"
    )
