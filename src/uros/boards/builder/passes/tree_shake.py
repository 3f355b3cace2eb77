"""Drops what a board's program does not reach, by names.

Reachability is based on names. It starts at the program's own modules and at ``roots``, and covers
modules of uros and of interfaces:

- A definition is live if live code imports or names it.
- A method is live if live code has an attribute of its name on any receiver whose class is not
  known. The class of ``self`` and of an annotated parameter is known. A string of that name counts
  as well (``getattr``), except a bound of a comparison such as ``char <= "z"``.
- A name that a module binds is live by the same rule, if live code holds the module as an object.
- Every method of a class is live if a base of the class is not ours, since that base may call it.

A name that is put together at run time cannot be seen: name it in ``roots``. Imports and plain
assignments are assumed to do nothing but bind their names.
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
    """Return the modules that are reached, without the code that is not.

    The program's own modules stay whole.

    Args:
        modules: All modules by their names.
        roots: Further modules (``uros.wire.session``) or names in them
            (``uros.wire.session:push_info``) to keep; classes with all their methods.
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
        """Mark a module as executed, and the packages that contain it."""
        while name and name not in self.loaded:
            if name in self.modules:
                self.loaded.add(name)
                self.changed = True
                for unit in self.units.get(name, ()):
                    if unit.effect:
                        self.revive(self.modules[name], unit)
            name = name.rpartition(".")[0]

    def hold(self, name: str) -> None:
        """Mark a module as held as an object, so that attributes may reach its names."""
        if name in self.modules and name not in self.objects:
            self.objects.add(name)
            self.changed = True

    def keep(self, name: str, attribute: str) -> None:
        """Mark a module, or one name in it, as live with all that belongs to it: a root."""
        self.load(name)
        self.hold(name)
        for unit in self.units.get(name, ()):
            if not attribute or attribute in unit.names:
                unit.whole = True
                self.revive(self.modules[name], unit)

    def use(self, name: str, attribute: str) -> None:
        """Mark what a module binds to a name as live: live code names it."""
        for unit in self.units.get(name, ()):
            if attribute in unit.names:
                self.revive(self.modules[name], unit)

    def revive(self, module: Module, unit: _Unit) -> None:
        """Mark a statement as live, and scan it once."""
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
        """Follow one alias of a live import to the module that it names."""
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
        """Mark all that a piece of live code names."""
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
        """Record an attribute of a receiver whose class is not known."""
        if attribute not in self.used:
            self.used.add(attribute)
            self.changed = True

    def note_typed(self, family: str, attribute: str) -> None:
        """Record an attribute of a receiver whose family of classes is known."""
        if (family, attribute) not in self.typed:
            self.typed.add((family, attribute))
            self.changed = True

    def is_used(self, unit: _Unit, member: _Unit) -> bool:
        """Return whether live code may use the member of the class."""
        assert isinstance(unit.node, ast.ClassDef)
        family = self.families.get(unit.node.name, "")
        return any(name in self.used or (family, name) in self.typed for name in member.names)

    def run(self) -> None:
        """Mark what is reached, until a round reaches nothing new."""
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
        """Return the live modules, each without its dead statements."""
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
    """Return for each class the name of its family.

    Classes that derive from each other, directly or not, are one family; one of their names stands
    for it. A family is left out if one of its classes has an unknown base, or shares its name with
    another class.
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
    """Return the names that a member looks up in the scope of the class.

    Those in the body of a function are not among them.
    """
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
    """Return whether Python itself looks the name up; MicroPython does not look up __slots__."""
    return name.startswith("__") and name.endswith("__") and name != "__slots__"


def _changed(node: ast.stmt) -> set[str]:
    """Return the names whose values an assignment changes: ``TABLE[1] = 2``, ``function.x = 3``."""
    targets = node.targets if isinstance(node, ast.Assign) else []
    names = set()
    for target in targets:
        while isinstance(target, (ast.Subscript, ast.Attribute)):
            target = target.value
            if isinstance(target, ast.Name):
                names.add(target.id)
    return names


def _bounds(node: ast.Compare) -> list[ast.expr]:
    """Return the operands of a comparison that are compared only by their order."""
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
