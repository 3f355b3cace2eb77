"""Translates modules of uros for MicroPython.

Removes annotations, docstrings and imports of modules that MicroPython lacks, and replaces
f-strings by calls of ``format``. Every build does this before the passes that
`uros.boards.builder.pipeline` lists, because uros's modules do not run on a board without it.
"""

from __future__ import annotations

import ast
from typing import Final

from ..modules import ABSENT, Module, catches_import_error
from ..scopes import FUNCTIONS, Transformer, bound, parameters, walk

_ALWAYS_PRESENT: Final = {"from sys import print_exception"}
"""Imports that succeed on every board, so that their ``try`` is removed; CPython lacks the name."""
_RECEIVER: Final = "uros_receiver"
"""Attribute of ast.Attribute nodes in which `_mark_receivers` stores the class of the receiver."""


def strip(module: Module) -> None:
    """Translate a module for MicroPython; store the names that it declares Final in ``finals``."""
    for node in module.tree.body:
        if isinstance(node, ast.AnnAssign) and isinstance(node.target, ast.Name):
            annotation = ast.unparse(node.annotation).strip("'\"").replace("typing.", "")
            if annotation == "Final" or annotation.startswith("Final["):
                module.finals.add(node.target.id)
    module.tree = _Strip().visit(module.tree)


class _Strip(Transformer):
    def __init__(self) -> None:
        super().__init__()
        self._class = ""

    def _function(self, node: ast.FunctionDef | ast.AsyncFunctionDef) -> ast.AST:
        _mark_receivers(node, self._class)
        node.returns = None
        outer, self._class = self._class, ""
        self.generic_visit(node)
        self._class = outer
        node.body = node.body or [ast.Pass()]
        return node

    visit_FunctionDef = _function
    visit_AsyncFunctionDef = _function

    def visit_ClassDef(self, node: ast.ClassDef) -> ast.AST:
        outer, self._class = self._class, node.name
        self.generic_visit(node)
        self._class = outer
        node.body = node.body or [ast.Pass()]
        return node

    def visit_arg(self, node: ast.arg) -> ast.AST:
        node.annotation = None
        return node

    def visit_AnnAssign(self, node: ast.AnnAssign) -> ast.AST | None:
        if node.value is None:
            return None
        return ast.Assign([node.target], self.visit(node.value), lineno=node.lineno)

    def visit_Expr(self, node: ast.Expr) -> ast.AST | None:
        if isinstance(node.value, ast.Constant):
            return None
        return self.generic_visit(node)

    def visit_Import(self, node: ast.Import) -> ast.AST | None:
        node.names = [alias for alias in node.names if alias.name not in ABSENT]
        return node if node.names else None

    def visit_ImportFrom(self, node: ast.ImportFrom) -> ast.AST | None:
        return None if not node.level and node.module in ABSENT else node

    def visit_Try(self, node: ast.Try) -> ast.AST | list[ast.stmt] | None:
        first = node.body[0]
        if _is_absent(first) and not node.finalbody:
            # On MicroPython the first statement fails, so only the handler runs.
            for handler in node.handlers:
                if catches_import_error(handler):
                    return [s for s in self._all(handler.body) if not isinstance(s, ast.Pass)]
        if ast.unparse(first) in _ALWAYS_PRESENT and len(node.body) == 1 and not node.finalbody:
            return self._all(node.body)
        self.generic_visit(node)
        node.body = node.body or [ast.Pass()]
        for handler in node.handlers:
            handler.body = handler.body or [ast.Pass()]
        return node

    def visit_If(self, node: ast.If) -> ast.AST | list[ast.stmt] | None:
        if ast.unparse(node.test) in ("TYPE_CHECKING", "typing.TYPE_CHECKING"):
            return self._all(node.orelse)
        return self._block(node)

    def _all(self, statements: list[ast.stmt]) -> list[ast.stmt]:
        """Return the translated statements."""
        block = ast.Module(statements, [])
        self.generic_visit(block)
        return block.body

    def _block(self, node: ast.AST) -> ast.AST:
        self.generic_visit(node)
        assert isinstance(node, (ast.If, ast.For, ast.AsyncFor, ast.While, ast.With, ast.AsyncWith))
        node.body = node.body or [ast.Pass()]
        return node

    visit_For = visit_AsyncFor = visit_While = visit_With = visit_AsyncWith = _block

    def visit_JoinedStr(self, node: ast.JoinedStr) -> ast.AST:
        """Translate an f-string into a call of format, as MicroPython's parser does.

        MicroPython's parser does not accept nested quotes in an f-string.
        """
        values: list[ast.expr] = []
        text = self._format(node, values, False)
        if not values:
            return ast.Constant(text.format())
        return ast.Call(ast.Attribute(ast.Constant(text), "format", ast.Load()), values, [])

    def _format(self, node: ast.JoinedStr, values: list[ast.expr], in_spec: bool) -> str:
        text = ""
        for part in node.values:
            if isinstance(part, ast.FormattedValue):
                values.append(self.visit(part.value))
                text += "{" + ("!" + chr(part.conversion) if part.conversion > 0 else "")
                if isinstance(part.format_spec, ast.JoinedStr):
                    text += ":" + self._format(part.format_spec, values, True)
                text += "}"
            elif isinstance(part, ast.Constant):
                plain = str(part.value)
                text += plain if in_spec else plain.replace("{", "{{").replace("}", "}}")
        return text


def _mark_receivers(node: ast.FunctionDef | ast.AsyncFunctionDef, owner: str) -> None:
    """Store at each attribute the class of its receiver, for `receiver`.

    The receiver is the object before the dot. Its class is known if it is ``self`` of a method
    without decorators, or an annotated parameter, and if neither the function nor a function in it
    binds that name again.
    """
    arguments = [*node.args.posonlyargs, *node.args.args]
    types = {
        arg.arg: ast.unparse(arg.annotation).strip("'\"") for arg in arguments if arg.annotation
    }
    if owner and arguments and not node.decorator_list:
        types[arguments[0].arg] = owner
    elif owner and arguments:  # a decorator may pass another object, such as the class
        types.pop(arguments[0].arg, None)
    # A name that is bound again may be an object of another class.
    for inner in walk(node):
        if inner is not node and isinstance(inner, (*FUNCTIONS, ast.Lambda)):
            for name in parameters(inner.args):
                types.pop(name, None)
    for name in bound(node.body):
        types.pop(name, None)
    for inner in walk(node):
        if isinstance(inner, ast.Attribute) and isinstance(inner.value, ast.Name):
            kind = types.get(inner.value.id, "")
            if kind.isidentifier() and not hasattr(inner, _RECEIVER):
                setattr(inner, _RECEIVER, kind)


def receiver(node: ast.Attribute) -> str:
    """Return the class of an attribute's receiver, the object before the dot; "" if unknown."""
    return str(getattr(node, _RECEIVER, ""))


def _is_absent(node: ast.stmt) -> bool:
    if isinstance(node, ast.Import):
        return any(alias.name in ABSENT for alias in node.names)
    if not isinstance(node, ast.ImportFrom) or node.level or node.module is None:
        return False
    # Boards import types from std_msgs.msg; uros.interfaces.std_msgs.msg exists on hosts only.
    of_host = node.module.startswith("uros.interfaces.") and node.module.count(".") > 2
    return of_host or node.module in ABSENT
