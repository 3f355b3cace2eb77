"""Puts the body of a method where its only call stands.

A method costs a board some 50 bytes besides its body. One that the class itself calls in one place,
for what it does and not for a value, and that nobody else can name, is taken apart: its parameters
and variables become variables of the caller.
"""

from __future__ import annotations

import ast
import copy
from collections.abc import Iterable

from .shrink import COMPREHENSIONS, FUNCTIONS, bound, parameters

_INNER = (*FUNCTIONS, *COMPREHENSIONS, ast.Lambda, ast.Yield, ast.YieldFrom, ast.Await, ast.Global,
          ast.Nonlocal, ast.ClassDef)  # fmt: skip


def unfold(tree: ast.Module, named: Iterable[str]) -> None:
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
    args = method.args
    if method.decorator_list or method.name.startswith("__") or args.defaults:
        return False
    if args.vararg or args.kwarg or args.kwonlyargs or not args.args or args.args[0].arg != "self":
        return False
    if any(isinstance(n, _INNER) for n in ast.walk(method) if n is not method):
        return False
    return _returns(method.body)


def _returns(body: list[ast.stmt]) -> bool:
    """Whether the body returns nothing, and not out of a loop or a try."""
    for node in ast.walk(ast.Module(body, [])):
        if isinstance(node, ast.Return) and node.value is not None:
            return False
        if isinstance(node, (ast.For, ast.While, ast.Try, ast.With)):
            if any(isinstance(inner, ast.Return) for inner in ast.walk(node)):
                return False
    return True


class _Put(ast.NodeTransformer):
    def __init__(self, method: ast.FunctionDef, caller: ast.FunctionDef) -> None:
        self.method = method
        self.done = False
        inner = any(isinstance(n, _INNER) for n in ast.walk(caller) if n is not caller)
        if inner or caller.args.args[:1] == [] or caller.args.args[0].arg != "self":
            return
        self.taken = set(parameters(caller.args)) | set(bound(caller.body))
        own = set(parameters(method.args)) | set(bound(method.body))
        if ({n.id for n in ast.walk(method) if isinstance(n, ast.Name)} - own) & self.taken:
            return  # what is the module's there is the caller's own here
        # A name that the caller reads from the module must not become a variable of it.
        self.taken |= {n.id for n in ast.walk(caller) if isinstance(n, ast.Name)}
        self.caller = caller
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
            if isinstance(value, (ast.Constant, ast.Name)) and param.arg not in own:
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
