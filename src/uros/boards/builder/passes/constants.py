"""Puts the values of named constants where their names stand, across modules."""

from __future__ import annotations

import ast
import operator
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Final

from ..modules import Module, absolute, named_from_outside
from ..scopes import Scopes, bound, times_bound

Scalar = int | bool | str | bytes
LONGEST: Final = 16
"""Longer constants of text or octets stay names: a copy in each module would cost more."""


def inline_constants(modules: dict[str, Module]) -> None:
    """Put the values of Final constants where their names stand, in all modules but the program's.

    Private constants that no name refers to any more are dropped; public ones stay, for
    `tree_shake`.
    """
    known: dict[str, dict[str, Scalar]] = {name: {} for name in modules}
    stored = {
        node.attr
        for module in modules.values()
        for node in ast.walk(module.tree)
        if isinstance(node, ast.Attribute) and not isinstance(node.ctx, ast.Load)
    }
    ours = [module for module in modules.values() if not module.own]
    for module in ours:
        module.tree = _Fold().visit(module.tree)
    times = {module.name: times_bound(module.tree) for module in ours}
    classes = {it.name: _classes_of_constants(it, times[it.name], stored) for it in ours}
    again = True
    while again:
        again = False
        for module in ours:
            # Constants made of constants: one more round for each step between them.
            once = times[module.name]
            found = _constants(module, _visible(module, known, classes, once), once, stored)
            again = again or found != known[module.name]
            known[module.name] = found
    for module in ours:
        seen = _visible(module, known, classes, times[module.name])
        module.tree = _Inline(seen).visit(module.tree)
        module.tree = _Fold().visit(module.tree)
    used = named_from_outside(modules.values())
    for module in ours:
        _drop_private(module, known[module.name], used)
        ast.fix_missing_locations(module.tree)


@dataclass
class _Visible:
    """What a module's top level sees: constants by name, and modules and classes by name."""

    names: dict[str, Scalar]
    objects: dict[str, dict[str, Scalar]]


def _visible(
    module: Module,
    known: dict[str, dict[str, Scalar]],
    classes: dict[str, dict[str, dict[str, Scalar]]],
    times: dict[str, int],
) -> _Visible:
    seen = _Visible(dict(known[module.name]), dict(classes[module.name]))
    for node in module.tree.body:
        if isinstance(node, ast.ImportFrom):
            base = absolute(node, module)
            for alias in node.names:
                here = alias.asname or alias.name
                if times.get(here) != 1:
                    continue
                if alias.name in known.get(base, {}):
                    seen.names[here] = known[base][alias.name]
                elif alias.name in classes.get(base, {}):
                    seen.objects[here] = classes[base][alias.name]
                elif f"{base}.{alias.name}" in known:
                    seen.objects[here] = known[f"{base}.{alias.name}"]
        elif isinstance(node, ast.Import):
            for alias in node.names:
                if alias.asname and alias.name in known and times.get(alias.asname) == 1:
                    seen.objects[alias.asname] = known[alias.name]
    return seen


def _constants(
    module: Module, seen: _Visible, times: dict[str, int], stored: set[str]
) -> dict[str, Scalar]:
    """The constants that a module defines: Final ones, and private ones that are never changed."""
    found: dict[str, Scalar] = {}
    for node in module.tree.body:
        if not isinstance(node, ast.Assign) or len(node.targets) != 1:
            continue
        target = node.targets[0]
        if not isinstance(target, ast.Name) or times[target.id] != 1 or target.id in stored:
            continue
        if target.id not in module.finals and not _is_private(target.id):
            continue
        value = _small_value(node.value, seen)
        if value is not None:
            found[target.id] = value
    return found


def _classes_of_constants(
    module: Module, times: dict[str, int], stored: set[str]
) -> dict[str, dict[str, Scalar]]:
    """The classes of a module that are lists of constants, such as policies of QoS."""
    found: dict[str, dict[str, Scalar]] = {}
    nothing = _Visible({}, {})
    for node in module.tree.body:
        if not isinstance(node, ast.ClassDef) or node.bases or node.keywords:
            continue
        names = list(bound(node.body))
        given = [_small_value(it.value, nothing) for it in node.body if isinstance(it, ast.Assign)]
        values = {name: it for name, it in zip(names, given, strict=False) if it is not None}
        plain = len(values) == len(names) == len(node.body) and not stored.intersection(names)
        if plain and times[node.name] == 1 and not node.decorator_list:
            found[node.name] = values
    return found


def _is_private(name: str) -> bool:
    return name.startswith("_") and not name.startswith("__")


def _small_value(node: ast.expr, seen: _Visible) -> Scalar | None:
    """The value of a constant expression, None where it is none or a long text."""
    value = _value(node, seen)
    return None if isinstance(value, (str, bytes)) and len(value) > LONGEST else value


def _value(node: ast.expr, seen: _Visible) -> Scalar | None:
    """The value of a constant expression, None where it is none."""
    if isinstance(node, ast.Constant):
        return node.value if isinstance(node.value, (int, bool, str, bytes)) else None
    if isinstance(node, ast.Name):
        return seen.names.get(node.id)
    if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name):
        return seen.objects.get(node.value.id, {}).get(node.attr)
    if isinstance(node, ast.UnaryOp) and type(node.op) in _UNARY:
        value = _value(node.operand, seen)
        return _UNARY[type(node.op)](value) if type(value) is int else None
    if isinstance(node, ast.BinOp) and type(node.op) in _BINARY:
        left, right = _value(node.left, seen), _value(node.right, seen)
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
    """Puts values in, where no inner scope has the name for something else."""

    def __init__(self, seen: _Visible) -> None:
        super().__init__()
        self.seen = seen

    def visit_Name(self, node: ast.Name) -> ast.expr:
        if isinstance(node.ctx, ast.Load) and node.id in self.seen.names:
            if not self.hidden(node.id):
                return _literal(self.seen.names[node.id], node)
        return node

    def visit_Attribute(self, node: ast.Attribute) -> ast.AST:
        base = node.value
        if isinstance(base, ast.Name) and isinstance(node.ctx, ast.Load):
            values = self.seen.objects.get(base.id, {})
            if node.attr in values and not self.hidden(base.id):
                return _literal(values[node.attr], node)
        return self.generic_visit(node)


def _literal(value: Scalar, at: ast.AST) -> ast.expr:
    if type(value) is int and value < 0:
        return ast.copy_location(ast.UnaryOp(ast.USub(), ast.Constant(-value)), at)
    return ast.copy_location(ast.Constant(value), at)


def _drop_private(module: Module, names: Iterable[str], used: set[str]) -> None:
    private = {name for name in names if _is_private(name)} - used
    for node in ast.walk(module.tree):
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


class _Fold(ast.NodeTransformer):
    """Decides what is known before the program runs: on which Python, and constants in ifs."""

    def visit_Attribute(self, node: ast.Attribute) -> ast.AST:
        if ast.unparse(node) == "sys.implementation.name":
            return ast.copy_location(ast.Constant("micropython"), node)
        if ast.unparse(node) == "sys.byteorder":  # of all boards that there are files for
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
                continue  # it decides nothing, and something follows
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
            node.bases = []  # it is one without saying so, and a base takes memory
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
    """Whether a bool constant is true; None for anything else."""
    return node.value if isinstance(node, ast.Constant) and type(node.value) is bool else None
