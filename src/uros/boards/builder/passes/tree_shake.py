"""Drops what a board's program does not reach, by names.

Reachability is based on names. It starts at the program's own modules and at ``roots``, and covers
modules of uros and of interfaces:

- A definition is live if live code imports or names it.
- A method is live if live code has an attribute of its name on any receiver whose class is not
  known. The class of ``self`` and of an annotated parameter is known. A string of that name counts
  as well (``getattr``), except a bound of a comparison such as ``char <= "z"``.
- A name that a module binds is live by the same rule, if live code holds the module as an object.
- Every method of a class is live if a base of the class is not of uros, since that base may call
  it.

A name that the program composes at run time is not found, and must be given in ``roots``. Imports
and plain assignments are assumed to do nothing but bind their names.
"""

from __future__ import annotations

import ast
from collections.abc import Iterable
from dataclasses import dataclass, field

from ..foreign_names import CLASSES
from ..modules import Module, absolute
from ..scopes import bound, walk
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
            shaker.mark_module_imported(module.name)
            shaker.mark_names_in(module, module.tree)
    for root in roots:
        name, _, attribute = root.partition(":")
        shaker.mark_root(name, attribute)
    shaker.mark_all()
    return shaker.live_modules()


@dataclass(eq=False)
class _Unit:
    """A top-level statement of a module, a statement of a class body, or one alias of an import."""

    node: ast.stmt
    names: set[str]
    effect: bool
    """The statement does more than bind its names: it is live as soon as its module is imported."""
    alias: ast.alias | None = None
    live: bool = False
    whole: bool = False
    """All members of the class are live if the class is."""
    members: list[_Unit] = field(default_factory=list)
    """The statements in the body of a class."""


class _Shaker:
    """Marks what a program reaches, and drops the rest.

    The marking rules, in the order in which `tree_shake` and `mark_all` apply them:

    1. The program's own modules are imported, and all their code is live.
    2. A root is imported and an object; the units it names are live with all their members.
    3. When a module is imported, its packages are imported too, and its units with an effect are
       live (`mark_module_imported`).
    4. When a unit becomes live, `mark_names_in` marks what its code names: names of its module as
       live, attributes and strings as used. Of a class only decorators, bases and keywords are
       scanned at that point; of an import, `follow_import` marks the module or name it takes.
    5. A module is an object if an import binds the module itself. Each used attribute is then live
       in it, and a submodule whose name is a used attribute is an object too.
    6. A member of a live class is live if the class is whole (a root, or with a base outside of
       uros), if the member has an effect (special methods included), or if its name is a used
       attribute: of any receiver of unknown class, or of a receiver of the family of the class.
       Names that a live member reads in the scope of the class count as used attributes.
    7. Rules 5 and 6 are repeated until a round marks nothing new.
    """

    def __init__(self, modules: dict[str, Module]) -> None:
        self.modules = modules
        self.units = {name: _units(m.tree.body) for name, m in modules.items() if not m.own}
        self.imported: set[str] = set()
        self.module_objects: set[str] = set()  # modules that live code has as objects
        self.attributes: set[str] = set()  # used attributes, and strings that may name one
        self.families = _families(m.tree for m in modules.values())
        # (family, attribute): used attributes of receivers whose class is known.
        self.family_attributes: set[tuple[str, str]] = set()
        self.classes: list[tuple[Module, _Unit]] = []  # live classes
        self.changed = False

    # Marking

    def mark_module_imported(self, name: str) -> None:
        """Mark a module as executed, and the packages that contain it."""
        while name and name not in self.imported:
            if name in self.modules:
                self.imported.add(name)
                self.changed = True
                for unit in self.units.get(name, ()):
                    if unit.effect:
                        self.mark_unit_live(self.modules[name], unit)
            name = name.rpartition(".")[0]

    def mark_module_as_object(self, name: str) -> None:
        """Mark a module as an object of live code, so that attributes may reach its names."""
        if name in self.modules and name not in self.module_objects:
            self.module_objects.add(name)
            self.changed = True

    def mark_root(self, name: str, attribute: str) -> None:
        """Mark a module, or one name in it, as live with all members of its classes: a root."""
        self.mark_module_imported(name)
        self.mark_module_as_object(name)
        for unit in self.units.get(name, ()):
            if not attribute or attribute in unit.names:
                unit.whole = True
                self.mark_unit_live(self.modules[name], unit)

    def mark_name_used(self, name: str, attribute: str) -> None:
        """Mark the units of a module that bind ``attribute`` as live, since live code names it."""
        for unit in self.units.get(name, ()):
            if attribute in unit.names:
                self.mark_unit_live(self.modules[name], unit)

    def mark_unit_live(self, module: Module, unit: _Unit) -> None:
        """Mark a unit as live; the first time, mark what its code names."""
        if unit.live:
            return
        unit.live = True
        self.changed = True
        node = unit.node
        if unit.alias:
            self.follow_import(module, node, unit.alias)
        elif isinstance(node, ast.ClassDef):
            for part in (*node.decorator_list, *node.bases, *node.keywords):
                self.mark_names_in(module, part)
            unit.whole = unit.whole or any(self.is_foreign(module, b) for b in node.bases)
            self.classes.append((module, unit))
        else:
            self.mark_names_in(module, node)

    def is_foreign(self, module: Module, base: ast.expr) -> bool:
        """Whether a base class is not of uros, so that it may call any method of the class."""
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

    def follow_import(self, module: Module, node: ast.stmt, alias: ast.alias) -> None:
        """Mark what one alias of a live import takes: a module, or a name of a module."""
        if isinstance(node, ast.Import):
            self.mark_module_imported(alias.name)
            name = alias.name
            while name:  # import a.b.c makes all three reachable
                self.mark_module_as_object(name)
                name = name.rpartition(".")[0]
            return
        assert isinstance(node, ast.ImportFrom)
        base = absolute(node, module)
        self.mark_module_imported(base)
        if alias.name == "*":
            self.mark_root(base, "")
        elif f"{base}.{alias.name}" in self.modules:
            self.mark_module_imported(f"{base}.{alias.name}")
            self.mark_module_as_object(f"{base}.{alias.name}")
        else:
            self.mark_name_used(base, alias.name)

    def mark_names_in(self, module: Module, code: ast.AST) -> None:
        """Mark all names, attributes and imports in a piece of live code."""
        order_operands: set[ast.expr] = set()
        for node in walk(code):  # `walk` yields a comparison before its operands
            if isinstance(node, ast.Compare):
                order_operands.update(_bounds(node))
            elif isinstance(node, ast.Name):
                self.mark_name_used(module.name, node.id)
            elif isinstance(node, ast.Attribute):
                family = self.families.get(receiver(node), "")
                if family:
                    self.mark_family_attribute_used(family, node.attr)
                else:
                    self.mark_attribute_used(node.attr)
            elif isinstance(node, ast.Constant) and isinstance(node.value, str):
                if node.value.isidentifier() and node not in order_operands:
                    self.mark_attribute_used(node.value)
            elif isinstance(node, (ast.Import, ast.ImportFrom)):
                for alias in node.names:
                    self.follow_import(module, node, alias)

    def mark_attribute_used(self, attribute: str) -> None:
        """Mark an attribute of a receiver of unknown class as used."""
        if attribute not in self.attributes:
            self.attributes.add(attribute)
            self.changed = True

    def mark_family_attribute_used(self, family: str, attribute: str) -> None:
        """Mark an attribute of a receiver whose family of classes is known as used."""
        if (family, attribute) not in self.family_attributes:
            self.family_attributes.add((family, attribute))
            self.changed = True

    def is_used(self, unit: _Unit, member: _Unit) -> bool:
        """Return whether live code may use the member of the class."""
        assert isinstance(unit.node, ast.ClassDef)
        family = self.families.get(unit.node.name, "")
        return any(
            name in self.attributes or (family, name) in self.family_attributes
            for name in member.names
        )

    def mark_all(self) -> None:
        """Apply rules 5 and 6 until a round marks nothing new."""
        self.changed = True
        while self.changed:
            self.changed = False
            for name in list(self.module_objects):
                for attribute in list(self.attributes):
                    self.mark_name_used(name, attribute)
                for child in list(self.imported):
                    parent, _, child_name = child.rpartition(".")
                    if parent == name and child_name in self.attributes:
                        self.mark_module_as_object(child)
            for module, unit in list(self.classes):
                for member in unit.members:
                    if unit.whole or member.effect or self.is_used(unit, member):
                        if not member.live:
                            self.mark_unit_live(module, member)
                            for name in _class_scope(member.node):
                                if any(name in candidate.names for candidate in unit.members):
                                    self.mark_attribute_used(name)

    # Result

    def live_modules(self) -> dict[str, Module]:
        """Return the live modules, each without its dead statements."""
        live: dict[str, Module] = {}
        for name, module in self.modules.items():
            if name not in self.imported:
                continue
            if not module.own:
                module.tree.body = _rebuild(self.units[name])
                if not module.tree.body and (module.package or name not in self.module_objects):
                    continue  # MicroPython accepts a folder without __init__ as a package
            live[name] = module
        return live


def _families(trees: Iterable[ast.Module]) -> dict[str, str]:
    """Return for each class the name of its family.

    Classes that derive from each other, directly or not, are one family, identified by the name of
    one of its classes. A family is left out if one of its classes has an unknown base, or shares
    its name with another class.
    """
    bases: dict[str, list[str]] = {}
    incomplete: set[str] = set()  # classes with an unknown base, or an ambiguous name
    for tree in trees:
        original_names = {
            alias.asname: alias.name
            for node in walk(tree)
            if isinstance(node, ast.ImportFrom)
            for alias in node.names
            if alias.asname
        }
        for node in walk(tree):
            if not isinstance(node, ast.ClassDef):
                continue
            if node.name in bases:
                incomplete.add(node.name)
            names = map(ast.unparse, node.bases)
            bases.setdefault(node.name, []).extend(original_names.get(name, name) for name in names)
    family = {name: name for name in bases}

    def join(first: str, second: str) -> None:
        old, new = family[first], family[second]
        for name, root in family.items():
            if root == old:
                family[name] = new

    for name, base_names in bases.items():
        for base in base_names:
            if base in family:
                join(name, base)
            elif base not in CLASSES:
                incomplete.add(name)
    unknown = {family[name] for name in incomplete}
    return {name: root for name, root in family.items() if root not in unknown}


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
        for n in walk(part)
        if isinstance(n, ast.Name) and isinstance(n.ctx, ast.Load)
    }


def _is_dunder(name: str) -> bool:
    """Return whether Python itself looks up the name; MicroPython does not look up __slots__."""
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
    """Return the statements of the live units, with the live aliases of an import in one."""
    body: list[ast.stmt] = []
    previous: ast.stmt | None = None
    for unit in units:
        if not unit.live:
            continue
        if unit.alias:
            assert isinstance(unit.node, (ast.Import, ast.ImportFrom))
            if unit.node is not previous:
                unit.node.names = []
                body.append(unit.node)
                previous = unit.node
            unit.node.names.append(unit.alias)
            continue
        if isinstance(unit.node, ast.ClassDef):
            unit.node.body = _rebuild(unit.members) or [ast.Pass()]
        body.append(unit.node)
    return body
