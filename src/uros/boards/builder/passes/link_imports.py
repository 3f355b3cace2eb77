"""Lets modules take their names from the bundle itself, not by a module in between.

Each module that a program names is there as a front of the bundle, which costs a board a quarter of
a kilobyte. ``from uros.client import Node`` becomes ``from uros._all import Node``: the same object
by the same name, from a module that runs at the same time. Nothing else of the program's text is
touched, lines stay where they are, and fronts that nobody names any more go.

Left alone are ``import uros.client``, ``from uros import client`` and ``import *``, which hand on a
module or all of it; statements that take anything else besides; and main.py and boot.py, which go
to the board as they were written.
"""

from __future__ import annotations

import ast
from collections.abc import Callable

from ..modules import Module, absolute, imports


def link_imports(
    modules: dict[str, Module], bundle: str, is_text: Callable[[Module], bool]
) -> None:
    """Link the modules to ``bundle``, but those that stay text, and drop fronts without users."""
    fronts: dict[str, dict[str, str]] = {}  # module -> its names, and what they are in the bundle
    for name, module in modules.items():
        body = module.tree.body
        if not module.own and len(body) == 1 and isinstance(body[0], ast.ImportFrom):
            if body[0].module == bundle:
                fronts[name] = {it.asname or it.name: it.name for it in body[0].names}
    for module in modules.values():
        if module.name not in fronts and not is_text(module):
            _link(module, bundle, fronts)
    named: set[str] = set()
    for module in modules.values():
        for it in imports(module) if module.name not in fronts else ():
            named.update(f"{it.module}.{there}" for there, _ in it.names or ())
            named.add(it.module)
            if it.names is None:
                parts = it.module.split(".")
                named.update(".".join(parts[:n]) for n in range(1, len(parts)))
    for name in fronts.keys() - named:
        del modules[name]


def _link(module: Module, bundle: str, fronts: dict[str, dict[str, str]]) -> None:
    lines = module.text.split("\n")
    linked = []
    for node in ast.walk(module.tree):
        if not isinstance(node, ast.ImportFrom):
            continue
        names = fronts.get(absolute(node, module), {})
        if all(alias.name in names for alias in node.names):
            for alias in node.names:
                new = names[alias.name]
                here = alias.asname or alias.name
                alias.name, alias.asname = new, here if here != new else None
            node.module, node.level = bundle, 0
            linked.append(node)
    if not module.own:
        return
    linked.sort(key=lambda node: (node.lineno, node.col_offset), reverse=True)
    for node in linked:
        assert node.end_lineno and node.end_col_offset
        first, last = node.lineno - 1, node.end_lineno - 1
        before = lines[first].encode()[: node.col_offset].decode()
        behind = lines[last].encode()[node.end_col_offset :].decode()
        text = ast.unparse(node)
        if last > first:  # as many lines as before
            head, names_ = text.split(" import ", 1)
            text = f"{head} import ({names_}" + "\n" * (last - first) + ")"
        lines[first : last + 1] = (before + text + behind).split("\n")
    module.text = "\n".join(lines)
