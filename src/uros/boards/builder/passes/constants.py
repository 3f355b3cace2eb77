"""Replaces the names of constants by their values, across modules."""

from __future__ import annotations

import ast
import operator
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Final

from ..modules import Module, absolute, named_from_outside
from ..scopes import Scopes, Transformer, bound, times_bound, walk

Scalar = int | bool | str | bytes
LONGEST: Final = 16
"""Longest text or bytes to replace a name; copies of longer ones would cost more memory."""


def inline_constants(modules: dict[str, Module]) -> None:
    """Replace the names of constants by their values, in all modules but the program's.

    Private constants that no code names any longer are dropped; public ones stay, for `tree_shake`.
    """
    known: dict[str, dict[str, Scalar]] = {name: {} for name in modules}
    stored = {
        node.attr
        for module in modules.values()
        for node in walk(module.tree)
        if isinstance(node, ast.Attribute) and not isinstance(node.ctx, ast.Load)
    }
    library = [module for module in modules.values() if not module.own]
    for module in library:
        module.tree = _Fold().visit(module.tree)
    times = {module.name: times_bound(module.tree) for module in library}
    classes = {
        module.name: _classes_of_constants(module, times[module.name], stored) for module in library
    }
    changed = True
    while changed:
        changed = False
        for module in library:
            # A constant may depend on others, so each level of dependence takes one more round.
            once = times[module.name]
            constants = _constants(
                module, _visible_constants(module, known, classes, once), once, stored
            )
            changed = changed or constants != known[module.name]
            known[module.name] = constants
    for module in library:
        visible = _visible_constants(module, known, classes, times[module.name])
        module.tree = _Inline(visible).visit(module.tree)
        module.tree = _Fold().visit(module.tree)
    outside_names = named_from_outside(modules.values())
    for module in library:
        _drop_private(module, known[module.name], outside_names)


@dataclass
class _Visible:
    """The constants that a module can name: directly, or as attributes of modules and classes."""

    names: dict[str, Scalar]
    objects: dict[str, dict[str, Scalar]]


def _visible_constants(
    module: Module,
    known: dict[str, dict[str, Scalar]],
    classes: dict[str, dict[str, dict[str, Scalar]]],
    times: dict[str, int],
) -> _Visible:
    visible = _Visible(dict(known[module.name]), dict(classes[module.name]))
    for node in module.tree.body:
        if isinstance(node, ast.ImportFrom):
            base = absolute(node, module)
            for alias in node.names:
                local_name = alias.asname or alias.name
                if times.get(local_name) != 1:
                    continue
                if alias.name in known.get(base, {}):
                    visible.names[local_name] = known[base][alias.name]
                elif alias.name in classes.get(base, {}):
                    visible.objects[local_name] = classes[base][alias.name]
                elif f"{base}.{alias.name}" in known:
                    visible.objects[local_name] = known[f"{base}.{alias.name}"]
        elif isinstance(node, ast.Import):
            for alias in node.names:
                if alias.asname and alias.name in known and times.get(alias.asname) == 1:
                    visible.objects[alias.asname] = known[alias.name]
    return visible


def _constants(
    module: Module, visible: _Visible, times: dict[str, int], stored: set[str]
) -> dict[str, Scalar]:
    """Return the constants of a module: Final ones, and private ones that are never changed."""
    constants: dict[str, Scalar] = {}
    for node in module.tree.body:
        if not isinstance(node, ast.Assign) or len(node.targets) != 1:
            continue
        target = node.targets[0]
        if not isinstance(target, ast.Name) or times[target.id] != 1 or target.id in stored:
            continue
        if target.id not in module.finals and not _is_private(target.id):
            continue
        value = _small_value(node.value, visible)
        if value is not None:
            constants[target.id] = value
    return constants


def _classes_of_constants(
    module: Module, times: dict[str, int], stored: set[str]
) -> dict[str, dict[str, Scalar]]:
    """Return the classes of a module that only bind constants, such as QoS policies."""
    classes: dict[str, dict[str, Scalar]] = {}
    nothing = _Visible({}, {})
    for node in module.tree.body:
        if not isinstance(node, ast.ClassDef) or node.bases or node.keywords:
            continue
        names = list(bound(node.body))
        literals = [
            _small_value(statement.value, nothing)
            for statement in node.body
            if isinstance(statement, ast.Assign)
        ]
        values = {
            name: value for name, value in zip(names, literals, strict=False) if value is not None
        }
        plain = len(values) == len(names) == len(node.body) and not stored.intersection(names)
        if plain and times[node.name] == 1 and not node.decorator_list:
            classes[node.name] = values
    return classes


def _is_private(name: str) -> bool:
    return name.startswith("_") and not name.startswith("__")


def _small_value(node: ast.expr, visible: _Visible) -> Scalar | None:
    """Return the value of a constant expression; None if it is not one, or is a long text."""
    value = _value(node, visible)
    return None if isinstance(value, (str, bytes)) and len(value) > LONGEST else value


def _value(node: ast.expr, visible: _Visible) -> Scalar | None:
    """Return the value of a constant expression; None if it is not one."""
    if isinstance(node, ast.Constant):
        return node.value if isinstance(node.value, (int, bool, str, bytes)) else None
    if isinstance(node, ast.Name):
        return visible.names.get(node.id)
    if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name):
        return visible.objects.get(node.value.id, {}).get(node.attr)
    if isinstance(node, ast.UnaryOp) and type(node.op) in _UNARY:
        value = _value(node.operand, visible)
        return _UNARY[type(node.op)](value) if type(value) is int else None
    if isinstance(node, ast.BinOp) and type(node.op) in _BINARY:
        left, right = _value(node.left, visible), _value(node.right, visible)
        if type(left) is int and type(right) is int:
            try:
                return _BINARY[type(node.op)](left, right)
            except (ArithmeticError, ValueError):
                return None
    return None


_UNARY: Final[dict[type[ast.unaryop], Callable[[int], int]]] = {
    ast.USub: operator.neg,
    ast.UAdd: operator.pos,
    ast.Invert: operator.invert,
}
_BINARY: Final[dict[type[ast.operator], Callable[[int, int], int]]] = {
    ast.Add: operator.add,
    ast.Sub: operator.sub,
    ast.Mult: operator.mul,
    ast.FloorDiv: operator.floordiv,
    ast.Mod: operator.mod,
    ast.LShift: operator.lshift,
    ast.RShift: operator.rshift,
    ast.BitOr: operator.or_,
    ast.BitAnd: operator.and_,
    ast.BitXor: operator.xor,
}


class _Inline(Scopes):
    """Replaces names by values, unless an inner scope binds the name."""

    def __init__(self, visible: _Visible) -> None:
        super().__init__()
        self.visible = visible

    def visit_Name(self, node: ast.Name) -> ast.expr:
        if isinstance(node.ctx, ast.Load) and node.id in self.visible.names:
            if not self.hidden(node.id):
                return _literal(self.visible.names[node.id], node)
        return node

    def visit_Attribute(self, node: ast.Attribute) -> ast.AST:
        base = node.value
        if isinstance(base, ast.Name) and isinstance(node.ctx, ast.Load):
            values = self.visible.objects.get(base.id, {})
            if node.attr in values and not self.hidden(base.id):
                return _literal(values[node.attr], node)
        return self.generic_visit(node)


def _literal(value: Scalar, at: ast.AST) -> ast.expr:
    if type(value) is int and value < 0:
        return ast.copy_location(ast.UnaryOp(ast.USub(), ast.Constant(-value)), at)
    return ast.copy_location(ast.Constant(value), at)


def _drop_private(module: Module, names: Iterable[str], outside_names: set[str]) -> None:
    private = {name for name in names if _is_private(name)} - outside_names
    for node in walk(module.tree):
        if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Load):
            private.discard(node.id)
    module.tree.body = [
        node
        for node in module.tree.body
        if not (
            isinstance(node, ast.Assign)
            and isinstance(node.targets[0], ast.Name)
            and node.targets[0].id in private
        )
    ]


class _Fold(Transformer):
    """Folds what is known at build time: MicroPython, its byte order and constant conditions."""

    def visit_Attribute(self, node: ast.Attribute) -> ast.AST:
        if node.attr not in ("name", "byteorder"):  # most attributes: unparse is slow
            return self.generic_visit(node)
        if ast.unparse(node) == "sys.implementation.name":
            return ast.copy_location(ast.Constant("micropython"), node)
        if ast.unparse(node) == "sys.byteorder":  # little on every board with a MicroPython port
            return ast.copy_location(ast.Constant("little"), node)
        return self.generic_visit(node)

    def visit_Compare(self, node: ast.Compare) -> ast.AST:
        self.generic_visit(node)
        values = [node.left, *node.comparators]
        if len(values) == 2 and all(isinstance(v, ast.Constant) for v in values):
            left, right = (v.value for v in values if isinstance(v, ast.Constant))
            if isinstance(left, str) and isinstance(right, str):
                if isinstance(node.ops[0], ast.Eq):
                    return ast.copy_location(ast.Constant(left == right), node)
                if isinstance(node.ops[0], ast.NotEq):
                    return ast.copy_location(ast.Constant(left != right), node)
        return node

    def visit_UnaryOp(self, node: ast.UnaryOp) -> ast.AST:
        self.generic_visit(node)
        known = _truth(node.operand)
        if isinstance(node.op, ast.Not) and known is not None:
            return ast.copy_location(ast.Constant(not known), node)
        return node

    def visit_BoolOp(self, node: ast.BoolOp) -> ast.AST:
        self.generic_visit(node)
        ends = isinstance(node.op, ast.Or)
        values = []
        for i, value in enumerate(node.values):
            known = _truth(value)
            if known is not None and known != ends and i + 1 < len(node.values):
                continue  # a neutral operand, which is not the last one
            values.append(value)
            if known == ends:
                break
        if len(values) == 1:
            return values[0]
        node.values = values
        return node

    def visit_ClassDef(self, node: ast.ClassDef) -> ast.AST:
        self.generic_visit(node)
        if [ast.unparse(base) for base in node.bases] == ["object"]:
            node.bases = []  # object is the default base; naming it takes memory
        return node

    def visit_IfExp(self, node: ast.IfExp) -> ast.AST:
        self.generic_visit(node)
        known = _truth(node.test)
        return node if known is None else node.body if known else node.orelse

    def visit_If(self, node: ast.If) -> ast.AST | list[ast.stmt]:
        self.generic_visit(node)
        known = _truth(node.test)
        if known is None:
            node.body = node.body or [ast.Pass()]
            return node
        return (node.body if known else node.orelse) or [ast.Pass()]


def _truth(node: ast.expr) -> bool | None:
    """Return the value of a bool constant; None for anything else."""
    return node.value if isinstance(node, ast.Constant) and type(node.value) is bool else None
