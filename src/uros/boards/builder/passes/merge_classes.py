"""Merges a base class with its only subclass, if only the subclass names the base.

A class costs a board 150 bytes, and each look-up that goes from a subclass to its base takes time.
The subclass keeps its name and its position in the module. A method of the base that the subclass
calls by ``super()`` becomes a method of another name.

Two classes are merged only if the result is provably the same:

- Both class bodies only bind methods and constants with one target. The values of the constants use
  no name of the class or of the module, so it does not matter when and in which body they are
  evaluated, nor that a constant which the subclass overrides is not evaluated at all.
- Each body binds each name once, except a property with its setter. A name that both bind is a
  plain method in both, or a constant in both.
- The subclass uses ``super()`` only to get, in a method of its own, a method that it overrides: to
  call it, or to pass it on (``attempt(super().execute)``).
- The names of both classes, and of the base's base, are bound once in the module.
"""

from __future__ import annotations

import ast
from collections.abc import Iterable, Iterator
from typing import TYPE_CHECKING, Final

from ..scopes import COMPREHENSIONS, FUNCTIONS, bound, parameters, times_bound, walk

if TYPE_CHECKING:
    from typing import TypeGuard

_INNER: Final = (*FUNCTIONS, *COMPREHENSIONS, ast.Lambda, ast.ClassDef)
_DECORATORS: Final = {"property", "staticmethod", "classmethod"}


def merge_classes(tree: ast.Module, named: Iterable[str]) -> None:
    """Merge classes of a bundle.

    Args:
        tree: The bundle; it is changed.
        named: Names that other modules may use; classes with these names stay.
    """
    fixed = set(named)
    while _merge_one(tree, fixed):
        pass


def _merge_one(tree: ast.Module, fixed: set[str]) -> bool:
    classes = {node.name: node for node in tree.body if isinstance(node, ast.ClassDef)}
    times = times_bound(tree)
    uses: dict[str, int] = {}
    names_in_use = set(fixed)
    for node in walk(tree):
        if isinstance(node, ast.Name):
            uses[node.id] = uses.get(node.id, 0) + 1
        elif isinstance(node, ast.Attribute):
            names_in_use.add(node.attr)
        elif isinstance(node, ast.ClassDef):
            names_in_use.update(bound(node.body))
    for subclass in classes.values():
        if len(subclass.bases) == 1 and isinstance(subclass.bases[0], ast.Name):
            base = classes.get(subclass.bases[0].id)
            if base and base.name not in fixed and uses[base.name] == 1:
                pair = _Pair(base, subclass)
                if pair.is_plain(times) and pair.may_override(names_in_use):
                    pair.merge()
                    tree.body.remove(base)
                    return True
    return False


def overridden(name: str, base: str) -> str:
    """Return the name of a base's method in a subclass that overrides it."""
    return "_" + name.strip("_") + "_of_" + base


class _Pair:
    def __init__(self, base: ast.ClassDef, subclass: ast.ClassDef) -> None:
        self.base = base
        self.subclass = subclass
        self.base_members = _members(base)  # statements of the base's body by the names they bind
        self.subclass_members = _members(subclass)
        self.super_uses: list[ast.Attribute] = []  # uses of overridden methods by super()

    def is_plain(self, times: dict[str, int]) -> bool:
        """Whether both classes only bind methods and constants."""
        for node in (self.base, self.subclass):
            if node.decorator_list or node.keywords or times.get(node.name) != 1:
                return False
            if any(name in _DECORATORS for name in bound(node.body)):
                return False
        if _DECORATORS & times.keys() or len(self.base.bases) > 1:
            return False
        for base in self.base.bases:
            if not isinstance(base, ast.Name) or times.get(base.id, 1) != 1:
                return False
        return _is_binding(self.base) and _is_binding(self.subclass)

    def may_override(self, names_in_use: set[str]) -> bool:
        """Whether overridden members and their uses by super() can be kept apart in one class."""
        both = self.base_members.keys() & self.subclass_members.keys()
        for name in both:
            pair = (self.base_members[name], self.subclass_members[name])
            if not all(map(_is_replaceable, pair)):
                return False
            if overridden(name, self.base.name) in names_in_use:
                return False
        return (
            _uses_plain_super(self.base)
            and _uses_plain_super(self.subclass)
            and self.collect_super_uses(both)
        )

    def collect_super_uses(self, both: set[str]) -> bool:
        """Collect the uses of base members by super(); return False if one cannot be replaced."""
        for member in self.subclass.body:
            in_all_scopes = [node for node in walk(member) if self.is_super_use(node)]
            in_own_scope = [node for node in _own_scope(member) if self.is_super_use(node)]
            if len(in_own_scope) < len(in_all_scopes):
                return False
            for node in in_own_scope:
                if node.attr not in both or not isinstance(self.base_members[node.attr], FUNCTIONS):
                    return False
            self.super_uses += in_own_scope
        return True

    def is_super_use(self, node: ast.AST) -> TypeGuard[ast.Attribute]:
        """Whether a node is ``super().name``, with the name of a base member."""
        return (
            isinstance(node, ast.Attribute)
            and _is_super(node.value)
            and node.attr in self.base_members
        )

    def merge(self) -> None:
        used = {use.attr for use in self.super_uses}
        for use in self.super_uses:
            use.attr = overridden(use.attr, self.base.name)
            use.value = ast.copy_location(ast.Name("self", ast.Load()), use.value)
        body: list[ast.stmt] = []
        for node in self.base.body:
            name = next(bound([node]), "")
            if name in used and isinstance(node, FUNCTIONS):
                node.name = overridden(name, self.base.name)
            elif name in self.subclass_members:
                continue  # the subclass overrides it
            body.append(node)
        self.subclass.body = [*body, *self.subclass.body]
        self.subclass.bases = self.base.bases


def _members(owner: ast.ClassDef) -> dict[str, ast.stmt]:
    return {name: node for node in owner.body for name in bound([node])}


def _is_binding(owner: ast.ClassDef) -> bool:
    """Whether a class body only binds names, each one once."""
    bound_names: set[str] = set()
    for node in owner.body:
        names = set(bound([node]))
        if isinstance(node, FUNCTIONS):
            if not all(map(_is_constant, node.args.defaults)):
                return False
            if not all(
                default is None or _is_constant(default) for default in node.args.kw_defaults
            ):
                return False
            if _is_setter(node, bound_names):
                continue
            for decorator in node.decorator_list:
                if not isinstance(decorator, ast.Name) or decorator.id not in _DECORATORS:
                    return False
        elif isinstance(node, ast.Assign):
            if len(node.targets) != 1 or not isinstance(node.targets[0], ast.Name):
                return False
            if not _is_constant(node.value):
                return False
        elif not isinstance(node, ast.Pass):
            return False
        if names & bound_names:
            return False
        bound_names |= names
    return True


def _is_setter(node: ast.FunctionDef | ast.AsyncFunctionDef, bound_names: set[str]) -> bool:
    """Whether a function is the setter of a property that the body has bound before."""
    return (
        len(node.decorator_list) == 1
        and isinstance(decorator := node.decorator_list[0], ast.Attribute)
        and decorator.attr == "setter"
        and isinstance(decorator.value, ast.Name)
        and decorator.value.id == node.name
        and node.name in bound_names
    )


def _is_constant(node: ast.expr) -> bool:
    """Whether an expression names nothing, and its evaluation has no side effect."""
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


def _uses_plain_super(owner: ast.ClassDef) -> bool:
    """Whether the class uses super only as ``super().name``."""
    names = sum(isinstance(n, ast.Name) and n.id == "super" for n in walk(owner))
    attributes = sum(isinstance(n, ast.Attribute) and _is_super(n.value) for n in walk(owner))
    return names == attributes


def _own_scope(member: ast.stmt) -> Iterator[ast.AST]:
    """Yield what a plain method with a ``self`` has in its own scope; nothing of other members."""
    if not isinstance(member, FUNCTIONS) or member.decorator_list:
        return
    if list(parameters(member.args))[:1] != ["self"] or "self" in bound(member.body):
        return
    pending: list[ast.AST] = list(member.body)
    while pending:
        node = pending.pop()
        if not isinstance(node, _INNER):
            yield node
            pending.extend(ast.iter_child_nodes(node))
