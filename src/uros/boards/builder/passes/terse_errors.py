"""Leaves out of uros's modules, for a board, what only says more about an error."""

from __future__ import annotations

import ast
from typing import Final

from ..modules import Module, absolute, named_from_outside

# Final constants with which a module says more than a board has room for, and what they are there.
_LEAN: Final = {
    ("uros.interfaces.errors", "_OWN_CLASS"): False,
    ("uros.interfaces.runtime", "NAMES_FIELDS"): False,
    ("uros.qos", "COMPARABLE"): False,
    ("uros.wire.ids", "NAMES_STATUS"): False,
}
# A board's session catches and counts a peer's faults, and says itself what cannot be sent.
_UNTOLD: Final = {"DecodeError", "LimitError", "EncodeError", "InterfaceError"}
_PEERS: Final = {"DecodeError", "LimitError"}
_ONE: Final = _PEERS | {"EncodeError"}
_QUIET: Final = ("uros.wire.", "uros.interfaces.")


def make_errors_terse(modules: dict[str, Module], spared: str = "-") -> None:
    """Remove from uros's modules what only says more about an error.

    Args:
        modules: The modules by their names.
        spared: Modules whose names begin with this keep it.
    """
    for (name, constant), value in _LEAN.items():
        if not name.startswith(spared):
            set_constant(modules, name, constant, value)
    named = named_from_outside(module for module in modules.values() if module.own)
    for module in modules.values():
        plain = module.own or module.name.startswith(spared)
        if module.name.startswith("uros.") and not plain:
            quiet = module.name.startswith(_QUIET)
            module.tree = _Untold(_UNTOLD if quiet else _PEERS).visit(module.tree)
            _one_error(module, _ONE - named)


def set_constant(modules: dict[str, Module], name: str, constant: str, value: bool) -> None:
    """Give a Final constant of a module, where that is there, another value."""
    for node in modules[name].tree.body if name in modules else ():
        if isinstance(node, ast.Assign) and ast.unparse(node.targets[0]) == constant:
            node.value = ast.Constant(value)


def _one_error(module: Module, names: set[str]) -> None:
    """What the program does not tell apart is one class for a board: each takes 150 bytes."""
    for node in ast.walk(module.tree):
        if isinstance(node, ast.ImportFrom) and absolute(node, module) == "uros.wire.errors":
            for alias in node.names:
                if alias.name in names:
                    alias.asname = alias.asname or alias.name
                    alias.name = "WireError"


class _Untold(ast.NodeTransformer):
    def __init__(self, untold: set[str]) -> None:
        self.untold = untold

    def visit_Raise(self, node: ast.Raise) -> ast.AST:
        error = node.exc
        if isinstance(error, ast.Call) and isinstance(error.func, ast.Name):
            if error.func.id in self.untold:
                node.exc = error.func  # the class itself: raising it makes one without words
        return node
