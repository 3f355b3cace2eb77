"""Drops what a board's program does not reach, by names.

Kept is, in modules of uros and of interfaces: what the program imports or names, what that names in
turn, and so on. An attribute may belong to anything, but for those of ``self`` and of annotated
parameters, so a method is kept when anything that is kept has an attribute, or a string (for
getattr), of its name, but for a string that only bounds something (``char <= "z"``); so is what a
module binds, if the module itself is at hand as an object; all methods, where a class has a base
that is not ours. What such a reading cannot see is a name that is put together at run time: keep
that by ``roots``. Imports and plain assignments are taken to do nothing but bind.
"""

from __future__ import annotations

import ast
from collections.abc import Iterable
from dataclasses import dataclass, field

from ..foreign_names import CLASSES
from ..modules import Module, absolute
from ..scopes import bound
from .strip import receiver

_DEFINITIONS = (ast.FunctionDef, ast.AsyncFunctionDef, ast.ClassDef)
_ORDERS = (ast.Lt, ast.LtE, ast.Gt, ast.GtE)


def tree_shake(modules: dict[str, Module], roots: Iterable[str] = ()) -> dict[str, Module]:
    """The modules that are left, with what is left of each; the program's own stay whole.

    ``roots`` are further modules (``uros.wire.session``) or names in them
    (``uros.wire.session:push_info``) to keep, classes with all their methods.
    """
    shaker = _Shaker(modules)
    for module in modules.values():
        if module.own:
            shaker.load(module.name)
            shaker.scan(module, module.tree)
    for root in roots:
        name, _, attribute = root.partition(":")
        shaker.keep(name, attribute)
    shaker.run()
    return shaker.left()


@dataclass(eq=False)
class _Unit:
    """A statement at the top level of a module (or in a class), or one alias of an import."""

    node: ast.stmt
    names: set[str]
    effect: bool
    """It does something besides binding its names, so it runs if its module does."""
    alias: ast.alias | None = None
    live: bool = False
    whole: bool = False
    members: list[_Unit] = field(default_factory=list)
    """Of a class."""


class _Shaker:
    def __init__(self, modules: dict[str, Module]) -> None:
        self.modules = modules
        self.units = {name: _units(m.tree.body) for name, m in modules.items() if not m.own}
        self.loaded: set[str] = set()
        self.objects: set[str] = set()  # modules that something holds as an object
        self.used: set[str] = set()  # attributes, and strings that may be names of some
        self.families = _families(m.tree for m in modules.values())
        self.typed: set[tuple[str, str]] = set()  # (family, attribute): those of a known class
        self.classes: list[tuple[Module, _Unit]] = []  # the live ones
        self.changed = False

    # What is reached

    def load(self, name: str) -> None:
        """The module runs, and the packages it is in before it."""
        while name and name not in self.loaded:
            if name in self.modules:
                self.loaded.add(name)
                self.changed = True
                for unit in self.units.get(name, ()):
                    if unit.effect:
                        self.revive(self.modules[name], unit)
            name = name.rpartition(".")[0]

    def hold(self, name: str) -> None:
        if name in self.modules and name not in self.objects:
            self.objects.add(name)
            self.changed = True

    def keep(self, name: str, attribute: str) -> None:
        self.load(name)
        self.hold(name)
        for unit in self.units.get(name, ()):
            if not attribute or attribute in unit.names:
                unit.whole = True
                self.revive(self.modules[name], unit)

    def use(self, name: str, attribute: str) -> None:
        """Something names what a module binds."""
        for unit in self.units.get(name, ()):
            if attribute in unit.names:
                self.revive(self.modules[name], unit)

    def revive(self, module: Module, unit: _Unit) -> None:
        if unit.live:
            return
        unit.live = True
        self.changed = True
        node = unit.node
        if unit.alias:
            self.bring(module, node, unit.alias)
        elif isinstance(node, ast.ClassDef):
            for part in (*node.decorator_list, *node.bases, *node.keywords):
                self.scan(module, part)
            unit.whole = unit.whole or any(self.is_foreign(module, b) for b in node.bases)
            self.classes.append((module, unit))
        else:
            self.scan(module, node)

    def is_foreign(self, module: Module, base: ast.expr) -> bool:
        """Whether a base class is not ours, so that its methods may call any of the class's."""
        name = module.name
        attribute = base.id if isinstance(base, ast.Name) else ""
        while attribute:
            units = [unit for unit in self.units.get(name, ()) if attribute in unit.names]
            if not units:
                return attribute not in CLASSES
            node, alias = units[0].node, units[0].alias
            if isinstance(node, ast.ClassDef):
                return any(self.is_foreign(self.modules[name], b) for b in node.bases)
            if len(units) > 1 or alias is None or not isinstance(node, ast.ImportFrom):
                return True
            name, attribute = absolute(node, self.modules[name]), alias.name
            if name not in self.units:
                return True
        return True

    def bring(self, module: Module, node: ast.stmt, alias: ast.alias) -> None:
        """One alias of an import that is live."""
        if isinstance(node, ast.Import):
            self.load(alias.name)
            name = alias.name
            while name:  # import a.b.c makes all three reachable
                self.hold(name)
                name = name.rpartition(".")[0]
            return
        assert isinstance(node, ast.ImportFrom)
        base = absolute(node, module)
        self.load(base)
        if alias.name == "*":
            self.keep(base, "")
        elif f"{base}.{alias.name}" in self.modules:
            self.load(f"{base}.{alias.name}")
            self.hold(f"{base}.{alias.name}")
        else:
            self.use(base, alias.name)

    def scan(self, module: Module, root: ast.AST) -> None:
        """All that a piece of live code names."""
        bounds: set[ast.expr] = set()
        for node in ast.walk(root):  # a comparison comes before what it compares
            if isinstance(node, ast.Compare):
                bounds.update(_bounds(node))
            elif isinstance(node, ast.Name):
                self.use(module.name, node.id)
            elif isinstance(node, ast.Attribute):
                family = self.families.get(receiver(node), "")
                if family:
                    self.note_typed(family, node.attr)
                else:
                    self.note(node.attr)
            elif isinstance(node, ast.Constant) and isinstance(node.value, str):
                if node.value.isidentifier() and node not in bounds:
                    self.note(node.value)
            elif isinstance(node, (ast.Import, ast.ImportFrom)):
                for alias in node.names:
                    self.bring(module, node, alias)

    def note(self, attribute: str) -> None:
        if attribute not in self.used:
            self.used.add(attribute)
            self.changed = True

    def note_typed(self, family: str, attribute: str) -> None:
        if (family, attribute) not in self.typed:
            self.typed.add((family, attribute))
            self.changed = True

    def is_used(self, unit: _Unit, member: _Unit) -> bool:
        """Whether anything may ask for the member of the class."""
        assert isinstance(unit.node, ast.ClassDef)
        family = self.families.get(unit.node.name, "")
        return any(name in self.used or (family, name) in self.typed for name in member.names)

    def run(self) -> None:
        """Go on until nothing new is reached."""
        self.changed = True
        while self.changed:
            self.changed = False
            for name in list(self.objects):
                for attribute in list(self.used):
                    self.use(name, attribute)
                for child in list(self.loaded):
                    parent, _, last = child.rpartition(".")
                    if parent == name and last in self.used:
                        self.hold(child)
            for module, unit in list(self.classes):
                for member in unit.members:
                    if unit.whole or member.effect or self.is_used(unit, member):
                        if not member.live:
                            self.revive(module, member)
                            for name in _class_scope(member.node):
                                if any(name in other.names for other in unit.members):
                                    self.note(name)

    # What is left

    def left(self) -> dict[str, Module]:
        kept: dict[str, Module] = {}
        for name, module in self.modules.items():
            if name not in self.loaded:
                continue
            if not module.own:
                module.tree.body = _rebuild(self.units[name])
                if not module.tree.body and (module.package or name not in self.objects):
                    continue  # MicroPython takes a folder without __init__ for a package
            kept[name] = module
        return kept


def _families(trees: Iterable[ast.Module]) -> dict[str, str]:
    """Each class's name, and one for all that it has bases or heirs in common with.

    Only those whose bases are all known, and that have a name for themselves.
    """
    bases: dict[str, list[str]] = {}
    open_: set[str] = set()
    for tree in trees:
        other = {
            alias.asname: alias.name
            for node in ast.walk(tree)
            if isinstance(node, ast.ImportFrom)
            for alias in node.names
            if alias.asname
        }
        for node in ast.walk(tree):
            if not isinstance(node, ast.ClassDef):
                continue
            if node.name in bases:
                open_.add(node.name)
            names = [other.get(it, it) for it in map(ast.unparse, node.bases)]
            bases.setdefault(node.name, []).extend(names)
    family = {name: name for name in bases}

    def join(a: str, b: str) -> None:
        old, new = family[a], family[b]
        for name, its in family.items():
            if its == old:
                family[name] = new

    for name, its in bases.items():
        for base in its:
            if base in family:
                join(name, base)
            elif base not in CLASSES:
                open_.add(name)
    unknown = {family[name] for name in open_}
    return {name: its for name, its in family.items() if its not in unknown}


def _units(body: list[ast.stmt]) -> list[_Unit]:
    units = []
    for node in body:
        if isinstance(node, ast.ImportFrom) or isinstance(node, ast.Import):
            for alias in node.names:
                name = alias.asname or alias.name
                if isinstance(node, ast.Import):
                    name = alias.asname or alias.name.partition(".")[0]
                units.append(_Unit(node, {name}, alias.name == "*", alias))
        elif isinstance(node, ast.Pass):
            continue
        else:
            unit = _Unit(node, set(bound([node])) | _changed(node), _has_effect(node))
            if isinstance(node, ast.ClassDef):
                unit.members = _units(node.body)
                for member in unit.members:
                    member.effect = member.effect or any(_is_dunder(n) for n in member.names)
            units.append(unit)
    return units


def _class_scope(node: ast.stmt) -> set[str]:
    """The names that a member looks up in the class's own scope: not those in a function's body."""
    parts: list[ast.AST] = [node]
    if isinstance(node, (ast.FunctionDef, ast.AsyncFunctionDef)):
        parts = [*node.decorator_list, node.args]
    return {
        n.id
        for part in parts
        for n in ast.walk(part)
        if isinstance(n, ast.Name) and isinstance(n.ctx, ast.Load)
    }


def _is_dunder(name: str) -> bool:
    """Whether Python itself looks the name up; MicroPython does not for __slots__."""
    return name.startswith("__") and name.endswith("__") and name != "__slots__"


def _changed(node: ast.stmt) -> set[str]:
    """The names whose things an assignment changes: ``TABLE[1] = 2``, ``function.x = 3``."""
    targets = node.targets if isinstance(node, ast.Assign) else []
    names = set()
    for target in targets:
        while isinstance(target, (ast.Subscript, ast.Attribute)):
            target = target.value
            if isinstance(target, ast.Name):
                names.add(target.id)
    return names


def _bounds(node: ast.Compare) -> list[ast.expr]:
    """The operands that are compared for their order alone."""
    return [
        operand
        for at, operand in enumerate((node.left, *node.comparators))
        if all(isinstance(op, _ORDERS) for op in node.ops[max(at - 1, 0) : at + 1])
    ]


def _has_effect(node: ast.stmt) -> bool:
    if isinstance(node, _DEFINITIONS):
        return False
    if isinstance(node, ast.Assign):
        return not (set(bound([node])) | _changed(node))
    if isinstance(node, ast.AugAssign):
        return not isinstance(node.target, ast.Name)
    if isinstance(node, (ast.Try, ast.If)):
        parts = [child for child in ast.iter_child_nodes(node) if isinstance(child, ast.stmt)]
        for handler in getattr(node, "handlers", ()):
            parts += handler.body
        return any(_has_effect(part) for part in parts)
    return not isinstance(node, (ast.Import, ast.ImportFrom, ast.Pass))


def _rebuild(units: list[_Unit]) -> list[ast.stmt]:
    """The statements of what is live; aliases of one import come together again."""
    body: list[ast.stmt] = []
    last: ast.stmt | None = None
    for unit in units:
        if not unit.live:
            continue
        if unit.alias:
            assert isinstance(unit.node, (ast.Import, ast.ImportFrom))
            if unit.node is not last:
                unit.node.names = []
                body.append(unit.node)
                last = unit.node
            unit.node.names.append(unit.alias)
            continue
        if isinstance(unit.node, ast.ClassDef):
            unit.node.body = _rebuild(unit.members) or [ast.Pass()]
        body.append(unit.node)
    return body
