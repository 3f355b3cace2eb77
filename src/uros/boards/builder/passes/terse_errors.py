"""Shortens errors in uros's modules, and omits comparing and printing messages."""

from __future__ import annotations

import ast
from typing import Final

from ..modules import Module, absolute, named_from_outside
from ..scopes import Transformer, walk

# Final constants that select code a board has no memory for, and their values on a board.
_TERSE_CONSTANTS: Final = {
    ("uros.interfaces.errors", "_OWN_CLASS"): False,
    ("uros.interfaces.runtime", "NAMES_FIELDS"): False,
    ("uros.qos", "COMPARABLE"): False,
    ("uros.wire.ids", "NAMES_STATUS"): False,
}
# Errors without a text on a board: its session catches and counts faults of the peer, and raises
# an error of its own for data that cannot be sent.
_WITHOUT_TEXT: Final = {"DecodeError", "LimitError", "EncodeError", "InterfaceError"}
_PEER_ERRORS: Final = {"DecodeError", "LimitError"}
_MERGED_ERRORS: Final = _PEER_ERRORS | {"EncodeError"}
_QUIET_PACKAGES: Final = ("uros.wire.", "uros.interfaces.")


def make_errors_terse(modules: dict[str, Module], spared: str = "-") -> None:
    """Remove texts of errors from uros's modules, and merge classes of errors.

    Args:
        modules: The modules by their names.
        spared: Modules whose names begin with this are not changed.
    """
    for (name, constant), value in _TERSE_CONSTANTS.items():
        if not name.startswith(spared):
            set_constant(modules, name, constant, value)
    program_names = named_from_outside(module for module in modules.values() if module.own)
    for module in modules.values():
        is_spared = module.own or module.name.startswith(spared)
        if module.name.startswith("uros.") and not is_spared:
            quiet = module.name.startswith(_QUIET_PACKAGES)
            module.tree = _DropTexts(_WITHOUT_TEXT if quiet else _PEER_ERRORS).visit(module.tree)
            _merge_error_classes(module, _MERGED_ERRORS - program_names)


def set_constant(modules: dict[str, Module], name: str, constant: str, value: bool) -> None:
    """Change the value of a Final constant; nothing if the module does not exist."""
    for node in modules[name].tree.body if name in modules else ():
        if isinstance(node, ast.Assign) and ast.unparse(node.targets[0]) == constant:
            node.value = ast.Constant(value)


def _merge_error_classes(module: Module, names: set[str]) -> None:
    """Import WireError in place of errors that no program names: each class takes 150 bytes."""
    for node in walk(module.tree):
        if isinstance(node, ast.ImportFrom) and absolute(node, module) == "uros.wire.errors":
            for alias in node.names:
                if alias.name in names:
                    alias.asname = alias.asname or alias.name
                    alias.name = "WireError"


class _DropTexts(Transformer):
    def __init__(self, names: set[str]) -> None:
        super().__init__()
        self.names = names

    def visit_Raise(self, node: ast.Raise) -> ast.AST:
        error = node.exc
        if isinstance(error, ast.Call) and isinstance(error.func, ast.Name):
            if error.func.id in self.names:
                node.exc = error.func  # the class itself: raising it makes one without words
        return node
