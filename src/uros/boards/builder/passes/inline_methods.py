"""Puts the body of a method where its only call stands.

A method costs a board some 50 bytes besides its body. One that the class itself calls in one place,
for what it does and not for a value, and that nobody else can name, is taken apart: its parameters
and variables become variables of the caller.

A call stays a call unless the result can be seen to be the same:

- Both are plain methods: no other scope in them, no generator, no coroutine, no ``global``, no
  ``del``, no import, no ``raise`` without an error. In both, the first parameter is ``self``, and
  stays what it is.
- Arguments are evaluated where the call stands, in their order, into variables of their own. Only
  a constant, or a parameter of the caller, stands for the method's parameter itself: the method
  cannot change it, and it is always bound. A module's name may mean something else a line later.
- Each variable of the method is bound before it is read, on every path (`_is_bound_first`). What
  one turn of a loop left in it, the next could read.
- The method returns nothing, and not out of a loop, a ``try`` or a ``with``.
- A name of the module that either reads is no variable of the other.
"""

from __future__ import annotations

import ast
import copy
from collections.abc import Iterable
from typing import Final

from ..scopes import COMPREHENSIONS, FUNCTIONS, bound, parameters

_INNER: Final = (
    *FUNCTIONS, *COMPREHENSIONS, ast.Lambda, ast.Yield, ast.YieldFrom, ast.Await, ast.Global,
    ast.Nonlocal, ast.ClassDef, ast.Delete, ast.Import, ast.ImportFrom, ast.NamedExpr,
)  # fmt: skip


def inline_methods(tree: ast.Module, named: Iterable[str]) -> None:
    """Unfold methods of a bundle; those that others may know by a name of ``named`` stay."""
    kept = set(named)
    while _once(tree, kept):
        pass


def _once(tree: ast.Module, kept: set[str]) -> bool:
    asked: dict[str, int] = {}
    defined: dict[str, int] = {}
    for node in ast.walk(tree):
        if isinstance(node, ast.Attribute):
            asked[node.attr] = asked.get(node.attr, 0) + 1
        elif isinstance(node, ast.Name):  # as a class's body names its own
            asked[node.id] = asked.get(node.id, 0) + 1
        elif isinstance(node, ast.ClassDef):
            for name in bound(node.body):
                defined[name] = defined.get(name, 0) + 1
    for owner in tree.body:
        if not isinstance(owner, ast.ClassDef):
            continue
        for method in owner.body:
            if (
                isinstance(method, ast.FunctionDef)
                and asked.get(method.name) == 1
                and defined[method.name] == 1
                and method.name not in kept
                and _is_plain(method)
            ):
                for caller in owner.body:
                    if isinstance(caller, ast.FunctionDef) and caller is not method:
                        if _Put(method, caller).done:
                            owner.body.remove(method)
                            return True
    return False


def _is_plain(method: ast.FunctionDef) -> bool:
    """Whether the method may be taken apart, wherever it is called."""
    args = method.args
    if method.decorator_list or method.name.startswith("__") or args.defaults:
        return False
    if args.vararg or args.kwarg or args.kwonlyargs or args.posonlyargs:
        return False
    if not _has_self(method) or not _returns_nothing(method.body):
        return False
    if any(isinstance(n, ast.Raise) and n.exc is None for n in ast.walk(method)):
        return False  # it raises again what the caller handles
    own = set(bound(method.body)) - set(parameters(args))
    return all(_is_bound_first(name, method.body) for name in own)


def _has_self(method: ast.FunctionDef) -> bool:
    """Whether it is one scope, in which self is what the method was called on."""
    if any(isinstance(n, _INNER) for n in ast.walk(method) if n is not method):
        return False
    first = [arg.arg for arg in method.args.args[:1]]
    return first == ["self"] and "self" not in bound(method.body)


def _returns_nothing(body: list[ast.stmt]) -> bool:
    """Whether the body returns nothing, and not out of a loop or a try."""
    for node in ast.walk(ast.Module(body, [])):
        if isinstance(node, ast.Return) and node.value is not None:
            return False
        if isinstance(node, (ast.For, ast.While, ast.Try, ast.With)):
            if any(isinstance(inner, ast.Return) for inner in ast.walk(node)):
                return False
    return True


def _is_bound_first(name: str, body: list[ast.stmt]) -> bool:
    """Whether a block binds the name before it reads it, on every path.

    Each statement with the name does so by itself, up to one that assigns to it.
    """
    for node in body:
        if isinstance(node, ast.Assign) and not _count(name, [node.value]):
            if len(node.targets) == 1 and name in _plain_names(node.targets[0]):
                return True
        if _count(name, [node]) and not _binds_itself(name, node):
            return False
    return True


def _binds_itself(name: str, node: ast.stmt) -> bool:
    """Whether each block in a statement binds the name first. A loop over the name has bound it in
    its body, and so has a handler that gives it to an error.
    """
    if isinstance(node, ast.For) and name in _plain_names(node.target):
        return not _count(name, [node.iter, *node.orelse])
    blocks = [block for field in _BLOCKS if (block := getattr(node, field, None))]
    outside = _count(name, [node]) - sum(_count(name, block) for block in blocks)
    for handler in getattr(node, "handlers", ()):
        outside -= _count(name, handler.body) + (handler.name == name)
        if handler.name != name:
            blocks.append(handler.body)
    return not outside and all(_is_bound_first(name, block) for block in blocks)


_BLOCKS: Final = ("body", "orelse", "finalbody")


def _plain_names(target: ast.expr) -> list[str]:
    """The names that an assignment binds, if it binds names alone."""
    targets = target.elts if isinstance(target, ast.Tuple) else [target]
    names = [it.id for it in targets if isinstance(it, ast.Name)]
    return names if len(names) == len(targets) else []


def _count(name: str, nodes: Iterable[ast.AST]) -> int:
    """How often the name is bound or read in some pieces of code."""
    return sum(
        (isinstance(inner, ast.Name) and inner.id == name)
        or (isinstance(inner, ast.ExceptHandler) and inner.name == name)
        for node in nodes
        for inner in ast.walk(node)
    )


class _Put(ast.NodeTransformer):
    """Puts the method's body where the caller calls it; ``done`` says whether it could."""

    def __init__(self, method: ast.FunctionDef, caller: ast.FunctionDef) -> None:
        self.method = method
        self.done = False
        if not _has_self(caller) or not _is_undecorated(caller):
            return
        self.parameters = set(parameters(caller.args))
        self.taken = self.parameters | set(bound(caller.body))
        names = {n.id for n in ast.walk(method) if isinstance(n, ast.Name)}
        own = set(parameters(method.args)) | set(bound(method.body))
        if (names - own) & self.taken:
            return  # what is the module's there is the caller's own here
        # A name that either reads from the module must not become a variable of the caller.
        self.taken |= names | own | {n.id for n in ast.walk(caller) if isinstance(n, ast.Name)}
        caller.body = [self.visit(it) for it in caller.body]
        caller.body = _flat(caller.body)

    def visit_Expr(self, node: ast.Expr) -> ast.AST:
        call = node.value
        if not (
            isinstance(call, ast.Call)
            and isinstance(call.func, ast.Attribute)
            and call.func.attr == self.method.name
            and isinstance(call.func.value, ast.Name)
            and call.func.value.id == "self"
            and not call.keywords
            and not any(isinstance(it, ast.Starred) for it in call.args)
            and len(call.args) == len(self.method.args.args) - 1
        ):
            return node
        self.done = True
        body = copy.deepcopy(self.method.body)
        own = set(bound(body))
        names: dict[str, ast.expr] = {}
        first: list[ast.stmt] = []
        for param, value in zip(self.method.args.args[1:], call.args, strict=True):
            kept = isinstance(value, ast.Constant) or (
                isinstance(value, ast.Name) and value.id in self.parameters
            )
            if kept and param.arg not in own:
                names[param.arg] = value
            else:
                own.add(param.arg)
                first.append(ast.Assign([ast.Name(param.arg, ast.Store())], value))
        fresh = {name: self.fresh(name) for name in own}
        for assign in first:
            assert isinstance(assign, ast.Assign) and isinstance(assign.targets[0], ast.Name)
            assign.targets[0].id = fresh[assign.targets[0].id]
        block = ast.Module(body, [])
        _Names(names, fresh).visit(block)
        if any(isinstance(it, ast.Return) for it in ast.walk(block)):
            _Leave().visit(block)
            if not isinstance(block.body[-1], ast.Break):
                block.body.append(ast.Break())
            block.body = [ast.While(ast.Constant(True), block.body, [])]
        whole = ast.If(ast.Constant(True), [*first, *block.body], [])
        return ast.copy_location(whole, node)

    def fresh(self, name: str) -> str:
        new, count = name, 1
        while new in self.taken:
            count += 1
            new = f"{name}_{count}"
        self.taken.add(new)
        return new


def _is_undecorated(caller: ast.FunctionDef) -> bool:
    """Whether what it is called on is its self: properties are, static methods are not."""
    return all(
        (isinstance(it, ast.Name) and it.id == "property")
        or (isinstance(it, ast.Attribute) and it.attr == "setter")
        for it in caller.decorator_list
    )


def _flat(body: list[ast.stmt]) -> list[ast.stmt]:
    """Without the ``if True`` in which an unfolded body came."""
    out: list[ast.stmt] = []
    for node in body:
        for field in ("body", "orelse", "finalbody"):
            inner = getattr(node, field, None)
            if isinstance(inner, list):
                setattr(node, field, _flat(inner))
        for handler in getattr(node, "handlers", ()):
            handler.body = _flat(handler.body)
        test = node.test if isinstance(node, ast.If) else None
        if isinstance(node, ast.If) and isinstance(test, ast.Constant) and test.value is True:
            out += node.body
        else:
            out.append(node)
    return out


class _Names(ast.NodeTransformer):
    def __init__(self, values: dict[str, ast.expr], fresh: dict[str, str]) -> None:
        self.values = values
        self.fresh = fresh

    def visit_Name(self, node: ast.Name) -> ast.AST:
        if node.id in self.values:
            return copy.deepcopy(self.values[node.id])
        node.id = self.fresh.get(node.id, node.id)
        return node

    def visit_ExceptHandler(self, node: ast.ExceptHandler) -> ast.AST:
        if node.name:
            node.name = self.fresh.get(node.name, node.name)
        return self.generic_visit(node)


class _Leave(ast.NodeTransformer):
    def visit_Return(self, node: ast.Return) -> ast.AST:
        return ast.copy_location(ast.Break(), node)
