"""Lets modules import their names from the bundle itself, without a re-exporting module.

Each re-exporting module costs a board a quarter of a kilobyte. ``from uros.client import Node``
becomes ``from uros._all import Node``: the same object by the same name, from a module that runs at
the same time. The rest of the program's text and its line numbers do not change. Re-exporting
modules that no import names any longer are dropped.

Not changed are ``import uros.client``, ``from uros import client`` and ``import *``, which bind a
module or all its names; statements that also import a name which the bundle lacks; and main.py and
boot.py, which stay text.
"""

from __future__ import annotations

import ast
from collections.abc import Callable

from ..modules import Module, absolute, imports
from ..scopes import walk


def link_imports(
    modules: dict[str, Module], bundle: str, is_text: Callable[[Module], bool]
) -> None:
    """Link the modules to ``bundle``, except those that stay text; drop unused re-exports."""
    reexports: dict[str, dict[str, str]] = {}  # module -> its names -> names in the bundle
    for name, module in modules.items():
        body = module.tree.body
        if not module.own and len(body) == 1 and isinstance(body[0], ast.ImportFrom):
            if body[0].module == bundle:
                reexports[name] = {
                    imported.asname or imported.name: imported.name for imported in body[0].names
                }
    for module in modules.values():
        if module.name not in reexports and not is_text(module):
            _link(module, bundle, reexports)
    named: set[str] = set()
    for module in modules.values():
        for imported in imports(module) if module.name not in reexports else ():
            named.update(f"{imported.module}.{name}" for name, _ in imported.names or ())
            named.add(imported.module)
            if imported.names is None:
                parts = imported.module.split(".")
                named.update(".".join(parts[:n]) for n in range(1, len(parts)))
    for name in reexports.keys() - named:
        del modules[name]


def _link(module: Module, bundle: str, reexports: dict[str, dict[str, str]]) -> None:
    lines = module.text.split("\n")
    linked = []
    for node in walk(module.tree):
        if not isinstance(node, ast.ImportFrom):
            continue
        names = reexports.get(absolute(node, module), {})
        if all(alias.name in names for alias in node.names):
            for alias in node.names:
                new = names[alias.name]
                local_name = alias.asname or alias.name
                alias.name, alias.asname = new, local_name if local_name != new else None
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
