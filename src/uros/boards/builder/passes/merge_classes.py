"""Merges a base class with its only subclass, if only the subclass names the base.

A class costs a board 150 bytes, and each look-up that goes from a subclass to its base takes time.
The subclass keeps its name and place. A method of the base that the subclass calls by ``super()``
becomes a method of another name.

Two classes are merged only if the result is provably the same:

- Both class bodies only bind methods and constants with one target. The values of the constants use
  no name of the class or of the module. So it does not matter when and in which body they are
  evaluated, nor that a constant which the subclass overrides is not evaluated at all.
- Each body binds each name once, except a property with its setter. A name that both bind is a
  plain method in both, or a constant in both.
- The subclass uses ``super()`` only to call, from a method of its own, a method that it overrides.
- The names of both classes, and of the base's base, are bound once in the module.
"""

from __future__ import annotations

import ast
from collections.abc import Iterable
from typing import Final

from ..scopes import COMPREHENSIONS, FUNCTIONS, bound, parameters, times_bound

_INNER: Final = (*FUNCTIONS, *COMPREHENSIONS, ast.Lambda, ast.ClassDef)
_DECORATORS: Final = {"property", "staticmethod", "classmethod"}


def merge_classes(tree: ast.Module, named: Iterable[str]) -> None:
    """Merge classes of a bundle.

    Args:
        tree: The bundle; it is changed.
        named: Names that other modules may use; classes with these names stay.
    """
    kept = set(named)
    while _once(tree, kept):
        pass


def _once(tree: ast.Module, kept: set[str]) -> bool:
    classes = {node.name: node for node in tree.body if isinstance(node, ast.ClassDef)}
    times = times_bound(tree)
    asked: dict[str, int] = {}
    spoken = set(kept)
    for node in ast.walk(tree):
        if isinstance(node, ast.Name):
            asked[node.id] = asked.get(node.id, 0) + 1
        elif isinstance(node, ast.Attribute):
            spoken.add(node.attr)
        elif isinstance(node, ast.ClassDef):
            spoken.update(bound(node.body))
    for heir in classes.values():
        if len(heir.bases) == 1 and isinstance(heir.bases[0], ast.Name):
            base = classes.get(heir.bases[0].id)
            if base and base.name not in kept and asked[base.name] == 1:
                pair = _Pair(base, heir)
                if pair.is_plain(times) and pair.may_override(spoken):
                    pair.join()
                    tree.body.remove(base)
                    return True
    return False


def overridden(name: str, base: str) -> str:
    """What a base's method is called in an heir that overrides it."""
    return "_" + name.strip("_") + "_of_" + base


class _Pair:
    def __init__(self, base: ast.ClassDef, heir: ast.ClassDef) -> None:
        self.base = base
        self.heir = heir
        self.above = _members(base)  # what the base binds
        self.here = _members(heir)
        self.calls: list[ast.Attribute] = []  # of what is above, by super()

    def is_plain(self, times: dict[str, int]) -> bool:
        """Whether both statements do nothing but bind methods and constants."""
        for node in (self.base, self.heir):
            if node.decorator_list or node.keywords or times.get(node.name) != 1:
                return False
            if any(name in _DECORATORS for name in bound(node.body)):
                return False
        if _DECORATORS & times.keys() or len(self.base.bases) > 1:
            return False
        for base in self.base.bases:
            if not isinstance(base, ast.Name) or times.get(base.id, 1) != 1:
                return False
        return _is_binding(self.base) and _is_binding(self.heir)

    def may_override(self, spoken: set[str]) -> bool:
        """Whether what both bind, and what the heir asks by super(), can be told apart."""
        both = self.above.keys() & self.here.keys()
        for name in both:
            if not _is_replaceable(self.above[name]) or not _is_replaceable(self.here[name]):
                return False
            if overridden(name, self.base.name) in spoken:
                return False
        return _knows_super(self.base) and _knows_super(self.heir) and self.finds_calls(both)

    def finds_calls(self, both: set[str]) -> bool:
        """Note the calls by super() of what is above; False where something else is asked of it."""
        for member in self.heir.body:
            asked = {
                id(node): node
                for node in ast.walk(member)
                if isinstance(node, ast.Attribute)
                and _is_super(node.value)
                and node.attr in self.above
            }
            for node in _own_calls(member):
                if isinstance(node, ast.Attribute) and id(node) in asked:
                    if node.attr in both and isinstance(self.above[node.attr], FUNCTIONS):
                        self.calls.append(asked.pop(id(node)))
            if asked:
                return False
        return True

    def join(self) -> None:
        called = {call.attr for call in self.calls}
        for call in self.calls:
            call.attr = overridden(call.attr, self.base.name)
            call.value = ast.copy_location(ast.Name("self", ast.Load()), call.value)
        body: list[ast.stmt] = []
        for node in self.base.body:
            name = next(bound([node]), "")
            if name in called and isinstance(node, FUNCTIONS):
                node.name = overridden(name, self.base.name)
            elif name in self.here:
                continue  # the heir's is what counts
            body.append(node)
        self.heir.body = [*body, *self.heir.body]
        self.heir.bases = self.base.bases


def _members(owner: ast.ClassDef) -> dict[str, ast.stmt]:
    return {name: node for node in owner.body for name in bound([node])}


def _is_binding(owner: ast.ClassDef) -> bool:
    """Whether a class's body only binds, each name once."""
    seen: set[str] = set()
    for node in owner.body:
        names = set(bound([node]))
        if isinstance(node, FUNCTIONS):
            if not all(map(_is_constant, node.args.defaults)):
                return False
            if not all(it is None or _is_constant(it) for it in node.args.kw_defaults):
                return False
            if _is_setter(node, seen):
                continue
            for it in node.decorator_list:
                if not isinstance(it, ast.Name) or it.id not in _DECORATORS:
                    return False
        elif isinstance(node, ast.Assign):
            if len(node.targets) != 1 or not isinstance(node.targets[0], ast.Name):
                return False
            if not _is_constant(node.value):
                return False
        elif not isinstance(node, ast.Pass):
            return False
        if names & seen:
            return False
        seen |= names
    return True


def _is_setter(node: ast.FunctionDef | ast.AsyncFunctionDef, seen: set[str]) -> bool:
    """Whether it completes a property that the body has bound before by the same name."""
    return (
        len(node.decorator_list) == 1
        and isinstance(it := node.decorator_list[0], ast.Attribute)
        and it.attr == "setter"
        and isinstance(it.value, ast.Name)
        and it.value.id == node.name
        and node.name in seen
    )


def _is_constant(node: ast.expr) -> bool:
    """Whether a value needs no name, and evaluating it does nothing else."""
    if isinstance(node, (ast.Tuple, ast.List)):
        return all(map(_is_constant, node.elts))
    if isinstance(node, ast.Dict):
        keys = all(isinstance(key, ast.Constant) for key in node.keys)
        return keys and all(map(_is_constant, node.values))
    if isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.USub):
        return isinstance(node.operand, ast.Constant) and isinstance(
            node.operand.value, (int, float)
        )
    return isinstance(node, ast.Constant)


def _is_replaceable(node: ast.stmt) -> bool:
    return isinstance(node, ast.Assign) or (isinstance(node, FUNCTIONS) and not node.decorator_list)


def _is_super(node: ast.expr) -> bool:
    return (
        isinstance(node, ast.Call)
        and isinstance(node.func, ast.Name)
        and node.func.id == "super"
        and not node.args
        and not node.keywords
    )


def _knows_super(owner: ast.ClassDef) -> bool:
    """Whether super stands there only as ``super().name``."""
    named = sum(isinstance(n, ast.Name) and n.id == "super" for n in ast.walk(owner))
    asked = sum(isinstance(n, ast.Attribute) and _is_super(n.value) for n in ast.walk(owner))
    return named == asked


def _own_calls(member: ast.stmt) -> Iterable[ast.expr]:
    """What a plain method with a self calls in its own scope."""
    if not isinstance(member, FUNCTIONS) or member.decorator_list:
        return []
    if list(parameters(member.args))[:1] != ["self"] or "self" in bound(member.body):
        return []
    calls: list[ast.expr] = []
    left: list[ast.AST] = list(member.body)
    while left:
        node = left.pop()
        if isinstance(node, _INNER):
            continue
        if isinstance(node, ast.Call):
            calls.append(node.func)
        left.extend(ast.iter_child_nodes(node))
    return calls
