"""Replaces the only call of a method by the body of the method.

A method costs a board some 50 bytes besides its body. A method is inlined if its class has only one
call of it, which is a statement, and no other code can name it. Its parameters and variables become
variables of the caller.

A call is inlined only if the result is provably the same:

- Caller and method are plain methods: no inner scope, no generator, no coroutine, no ``global``, no
  ``del``, no import, no ``raise`` without an error. The first parameter of both is ``self``, and
  neither binds ``self`` again.
- Arguments are evaluated at the call, in their order, into variables of their own. Only a constant
  or a parameter of the caller replaces the method's parameter, because the method cannot change it,
  and it is always bound. A global does not, since it may be rebound between the call and its use.
- Each variable of the method is bound before it is read, on every path (`_is_bound_first`).
  Otherwise an iteration of a loop in the caller could read what the previous one left there.
- The method returns no value, and does not return from within a loop, a ``try`` or a ``with``.
- A global that one of the two methods reads is not a variable of the other.
"""

from __future__ import annotations

import ast
import copy
from collections import Counter
from collections.abc import Iterable
from typing import Final

from ..scopes import COMPREHENSIONS, FUNCTIONS, Transformer, bound, parameters, walk

_INNER: Final = (
    *FUNCTIONS, *COMPREHENSIONS, ast.Lambda, ast.Yield, ast.YieldFrom, ast.Await, ast.Global,
    ast.Nonlocal, ast.ClassDef, ast.Delete, ast.Import, ast.ImportFrom, ast.NamedExpr,
)  # fmt: skip


def inline_methods(tree: ast.Module, named: Iterable[str]) -> None:
    """Inline methods of a bundle.

    Args:
        tree: The bundle; it is changed.
        named: Names that other modules may use; methods with these names stay.
    """
    fixed = set(named)
    uses = _Uses(tree)
    while _inline_one(tree, fixed, uses):
        pass


class _Uses:
    """How often the parts of a bundle, methods above all, use each name.

    Inlining one method changes two others of many hundred, so a part is traversed again only after
    `forget`.
    """

    def __init__(self, tree: ast.Module) -> None:
        self._tree = tree
        self.defined = Counter(
            name
            for node in walk(tree)
            if isinstance(node, ast.ClassDef)
            for name in bound(node.body)
        )  # how often class bodies bind each name, before any method was inlined
        self._attributes: dict[ast.AST, Counter[str]] = {}
        self._names: dict[ast.AST, Counter[str]] = {}
        self._plain: dict[ast.AST, bool] = {}

    def forget(self, part: ast.AST) -> None:
        """Forget a part that was changed."""
        for known in (self._attributes, self._names, self._plain):
            known.pop(part, None)

    def attributes(self, part: ast.AST) -> Counter[str]:
        """Return how often a part uses each attribute."""
        if part not in self._attributes:
            nodes = list(walk(part))
            self._attributes[part] = Counter(n.attr for n in nodes if isinstance(n, ast.Attribute))
            self._names[part] = Counter(n.id for n in nodes if isinstance(n, ast.Name))
        return self._attributes[part]

    def is_plain(self, method: ast.FunctionDef) -> bool:
        """Return the result of `_is_plain`."""
        if method not in self._plain:
            self._plain[method] = _is_plain(method)
        return self._plain[method]

    def total(self) -> Counter[str]:
        """Return how often the whole bundle uses each name, as an attribute or a plain name.

        A class body refers to its own methods by plain names.
        """
        total: Counter[str] = Counter()
        for statement in self._tree.body:
            parts: list[ast.AST] = [statement]
            if isinstance(statement, ast.ClassDef):
                outside = (*statement.bases, *statement.keywords, *statement.decorator_list)
                parts = [*statement.body, *outside]
            for part in parts:
                total.update(self.attributes(part))
                total.update(self._names[part])
        return total


def _inline_one(tree: ast.Module, fixed: set[str], uses: _Uses) -> bool:
    total = uses.total()
    for owner in tree.body:
        if not isinstance(owner, ast.ClassDef):
            continue
        callers: dict[str, ast.FunctionDef] = {}  # of an attribute used once: its user
        for caller in owner.body:
            if isinstance(caller, ast.FunctionDef):
                callers.update(dict.fromkeys(uses.attributes(caller), caller))
        for method in owner.body:
            if (
                isinstance(method, ast.FunctionDef)
                and total[method.name] == 1
                and uses.defined[method.name] == 1
                and method.name not in fixed
                and callers.get(method.name, method) is not method
                and uses.is_plain(method)
                and _CallInliner(method, callers[method.name]).done
            ):
                owner.body.remove(method)
                uses.forget(callers[method.name])
                return True
    return False


def _is_plain(method: ast.FunctionDef) -> bool:
    """Return whether the method may be inlined, wherever its call is."""
    args = method.args
    if method.decorator_list or method.name.startswith("__") or args.defaults:
        return False
    if args.vararg or args.kwarg or args.kwonlyargs or args.posonlyargs:
        return False
    if not _has_self(method) or not _returns_nothing(method.body):
        return False
    if any(isinstance(n, ast.Raise) and n.exc is None for n in walk(method)):
        return False  # it re-raises the error that the caller handles
    own = set(bound(method.body)) - set(parameters(args))
    return all(_is_bound_first(name, method.body) for name in own)


def _has_self(method: ast.FunctionDef) -> bool:
    """Return whether the method is one scope, in which ``self`` is the receiver throughout."""
    if any(isinstance(n, _INNER) for n in walk(method) if n is not method):
        return False
    first = [arg.arg for arg in method.args.args[:1]]
    return first == ["self"] and "self" not in bound(method.body)


def _returns_nothing(body: list[ast.stmt]) -> bool:
    """Return whether the body returns no value, and not from within a loop or a ``try``."""
    for node in walk(ast.Module(body, [])):
        if isinstance(node, ast.Return) and node.value is not None:
            return False
        if isinstance(node, (ast.For, ast.While, ast.Try, ast.With)):
            if any(isinstance(inner, ast.Return) for inner in walk(node)):
                return False
    return True


def _is_bound_first(name: str, body: list[ast.stmt]) -> bool:
    """Return whether a block binds the name before it reads it, on every path.

    The statements are checked in order. An assignment to the name ends the check. Each statement
    before it that contains the name must itself bind the name before it reads it.
    """
    for node in body:
        if isinstance(node, ast.Assign) and not _count(name, [node.value]):
            if len(node.targets) == 1 and name in _plain_names(node.targets[0]):
                return True
        if _count(name, [node]) and not _binds_itself(name, node):
            return False
    return True


def _binds_itself(name: str, node: ast.stmt) -> bool:
    """Return whether each block in a statement binds the name before it reads it.

    The body of ``for name in …`` finds the name bound, and so does the body of an
    ``except … as name``.
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
    """Return the names that an assignment binds; none if it binds anything else, too."""
    targets = target.elts if isinstance(target, ast.Tuple) else [target]
    names = [element.id for element in targets if isinstance(element, ast.Name)]
    return names if len(names) == len(targets) else []


def _count(name: str, nodes: Iterable[ast.AST]) -> int:
    """Count how often pieces of code bind or read a name."""
    return sum(
        (isinstance(inner, ast.Name) and inner.id == name)
        or (isinstance(inner, ast.ExceptHandler) and inner.name == name)
        for node in nodes
        for inner in walk(node)
    )


class _CallInliner(Transformer):
    """Replaces the call by the method's body; ``done`` is whether that was possible."""

    def __init__(self, method: ast.FunctionDef, caller: ast.FunctionDef) -> None:
        super().__init__()
        self.method = method
        self.done = False
        if not _has_self(caller) or not _is_undecorated(caller):
            return
        self.parameters = set(parameters(caller.args))
        self.taken = self.parameters | set(bound(caller.body))
        names = {n.id for n in walk(method) if isinstance(n, ast.Name)}
        own = set(parameters(method.args)) | set(bound(method.body))
        if (names - own) & self.taken:
            return  # a global of the method is a variable of the caller
        # A global that one of the two reads must not become a variable of the caller.
        self.taken |= names | own | {n.id for n in walk(caller) if isinstance(n, ast.Name)}
        caller.body = [self.visit(statement) for statement in caller.body]
        caller.body = _flatten_blocks(caller.body)

    def visit_Expr(self, node: ast.Expr) -> ast.AST:
        call = node.value
        if not (
            isinstance(call, ast.Call)
            and isinstance(call.func, ast.Attribute)
            and call.func.attr == self.method.name
            and isinstance(call.func.value, ast.Name)
            and call.func.value.id == "self"
            and not call.keywords
            and not any(isinstance(argument, ast.Starred) for argument in call.args)
            and len(call.args) == len(self.method.args.args) - 1
        ):
            return node
        self.done = True
        body = copy.deepcopy(self.method.body)
        own = set(bound(body))
        names: dict[str, ast.expr] = {}
        assignments: list[ast.stmt] = []
        for param, value in zip(self.method.args.args[1:], call.args, strict=True):
            is_stable = isinstance(value, ast.Constant) or (
                isinstance(value, ast.Name) and value.id in self.parameters
            )
            if is_stable and param.arg not in own:
                names[param.arg] = value
            else:
                own.add(param.arg)
                assignments.append(ast.Assign([ast.Name(param.arg, ast.Store())], value))
        fresh = {name: self.fresh(name) for name in own}
        for assign in assignments:
            assert isinstance(assign, ast.Assign) and isinstance(assign.targets[0], ast.Name)
            assign.targets[0].id = fresh[assign.targets[0].id]
        block = ast.Module(body, [])
        _SubstituteNames(names, fresh).visit(block)
        if any(isinstance(inner, ast.Return) for inner in walk(block)):
            _ReturnToBreak().visit(block)
            if not isinstance(block.body[-1], ast.Break):
                block.body.append(ast.Break())
            block.body = [ast.While(ast.Constant(True), block.body, [])]
        wrapped = ast.If(ast.Constant(True), [*assignments, *block.body], [])
        return ast.copy_location(wrapped, node)

    def fresh(self, name: str) -> str:
        new, count = name, 1
        while new in self.taken:
            count += 1
            new = f"{name}_{count}"
        self.taken.add(new)
        return new


def _is_undecorated(caller: ast.FunctionDef) -> bool:
    """Return whether a method gets its receiver as ``self``: static methods do not."""
    return all(
        (isinstance(decorator, ast.Name) and decorator.id == "property")
        or (isinstance(decorator, ast.Attribute) and decorator.attr == "setter")
        for decorator in caller.decorator_list
    )


def _flatten_blocks(body: list[ast.stmt]) -> list[ast.stmt]:
    """Remove the ``if True`` around an inlined body."""
    statements: list[ast.stmt] = []
    for node in body:
        for field in ("body", "orelse", "finalbody"):
            inner = getattr(node, field, None)
            if isinstance(inner, list):
                setattr(node, field, _flatten_blocks(inner))
        for handler in getattr(node, "handlers", ()):
            handler.body = _flatten_blocks(handler.body)
        test = node.test if isinstance(node, ast.If) else None
        if isinstance(node, ast.If) and isinstance(test, ast.Constant) and test.value is True:
            statements += node.body
        else:
            statements.append(node)
    return statements


class _SubstituteNames(Transformer):
    def __init__(self, values: dict[str, ast.expr], fresh: dict[str, str]) -> None:
        super().__init__()
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


class _ReturnToBreak(Transformer):
    def visit_Return(self, node: ast.Return) -> ast.AST:
        return ast.copy_location(ast.Break(), node)
