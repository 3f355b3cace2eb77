"""Renames names that no module outside of the bundle uses to names in MicroPython's ROM.

A new name costs a board some 20 bytes, a name that MicroPython itself uses costs none, and one of
two letters costs half. The pass renames parameters that no call names, and attributes, functions
and classes that neither the program nor another module outside of the bundle names; exceptions are
never renamed. A traceback shows the new names. As in `tree_shake`, a name that the program composes
at run time is not found.
"""

from __future__ import annotations

import ast
from collections.abc import Iterable, Iterator
from typing import Final

from ..foreign_names import ATTRIBUTES, BUILTINS, CLASSES
from ..modules import Module, known_names
from ..scopes import (
    FUNCTIONS,
    Renaming,
    Transformer,
    bound,
    parameters,
    scoped_names,
    times_bound,
    walk,
)
from .strip import receiver

# MicroPython gives these fixed numbers (py/makeqstrdata.py), which bytecode files rely on.
_IN_ROM: Final = (
    "args clear close const copy count end find format get index insert items join key keys little"
    " lower lstrip next pop popitem pow read readinto readline remove replace reverse rfind rindex"
    " rsplit rstrip send sep setdefault sort split start startswith step stop strip sum throw"
    " update upper value values write"
).split()
_IN_MPY: Final = (
    "ArithmeticError AssertionError AttributeError BaseException EOFError Ellipsis Exception"
    " GeneratorExit ImportError IndentationError IndexError KeyError KeyboardInterrupt LookupError"
    " MemoryError NameError NoneType NotImplementedError OSError OverflowError RuntimeError"
    " StopIteration SyntaxError SystemExit TypeError ValueError ZeroDivisionError"
    " abs all any bool builtins bytearray bytecode bytes callable chr classmethod dict dir divmod"
    " endswith eval exec extend from_bytes getattr globals hasattr hash id int isalpha isdigit"
    " isinstance islower isspace issubclass isupper iter len list locals main map micropython"
    " object open ord print range repr round set setattr sorted staticmethod str super to_bytes"
    " tuple type zip"
).split()

# Names of modules in the firmware of every port: math, random, json, struct, binascii, hashlib, os,
# gc, heapq, collections, micropython, sys. If a firmware lacks one, that name costs 20 bytes.
_IN_FIRMWARE: Final = (
    "acos asin atan atan2 ceil copysign cos degrees exp fabs floor fmod frexp isfinite isinf isnan"
    " ldexp log modf pi radians sin sqrt tan trunc choice getrandbits randint random randrange seed"
    " uniform dump dumps load loads calcsize pack unpack a2b_base64 b2a_base64 crc32 hexlify"
    " unhexlify digest sha1 sha256 chdir getcwd ilistdir listdir mkdir remove rename rmdir stat"
    " statvfs uname collect isenabled mem_alloc mem_free threshold heapify heappop heappush deque"
    " namedtuple OrderedDict heap_lock heap_unlock mem_info opt_level qstr_info schedule stack_use"
    " argv byteorder implementation maxsize modules path platform stderr stdin stdout version"
).split()


def mangle(bundled: Module, others: Iterable[Module]) -> None:
    """Rename names of the bundle ``bundled``; ``others`` are all modules outside of it."""
    others = list(others)
    fixed = known_names(bundled.tree, others)
    _drop_aliases(bundled.tree, fixed)
    trees = [bundled.tree, *(other.tree for other in others)]
    _rename_attributes(bundled.tree, fixed, _free_names(trees))
    _rename_globals(bundled.tree, fixed)
    names = {n.attr for n in walk(bundled.tree) if isinstance(n, ast.Attribute)}
    names |= set(bound(bundled.tree.body)) | set(_IN_ROM) | {"self"}
    for tree in trees:
        for node in walk(tree):
            if isinstance(node, ast.keyword) and node.arg:
                names.add(node.arg)
            elif isinstance(node, ast.Constant) and isinstance(node.value, str):
                names.add(node.value)
    for node in walk(bundled.tree):
        if isinstance(node, FUNCTIONS):
            _rename_parameters(node, names)


def _free_names(trees: list[ast.Module]) -> list[str]:
    """Return names that the bundle contains in any case, and that no attribute has."""
    present: set[str] = set()
    taken: set[str] = set()
    for node in walk(trees[0]):
        if isinstance(node, ast.Name) and node.id in BUILTINS:
            present.add(node.id)
        elif isinstance(node, (ast.Import, ast.ImportFrom)):
            present.update(bound([node]))
    for tree in trees:
        for node in walk(tree):
            if isinstance(node, ast.Attribute):
                taken.add(node.attr)
            elif isinstance(node, ast.ClassDef):
                taken.update(bound(node.body))
            elif isinstance(node, ast.Constant) and isinstance(node.value, str):
                taken.add(node.value)
    return sorted(present - taken - ATTRIBUTES - set(_IN_MPY) - set(_IN_ROM))


def _two_letter_names() -> Iterator[str]:
    """Yield names of two letters; none is a keyword of Python."""
    letters = "abcdefghijklmnopqrstuvwxyz"
    for first in letters.upper():
        for second in letters:
            yield first + second


def _new_names(old_names: Iterable[str], taken: set[str], pool: Iterable[str]) -> dict[str, str]:
    """Return a new name for each old one: from the pool, or of two letters."""
    free = (name for name in dict.fromkeys((*pool, *_two_letter_names())) if name not in taken)
    return {name: next(free) for name in old_names if len(name) > 1}


# --- attributes ----------------------------------------------------------------------------------


def _rename_attributes(tree: ast.Module, fixed: set[str], free: list[str]) -> None:
    """Rename attributes that classes of the bundle bind, unless other objects may have the name."""
    used = {n.attr for n in walk(tree) if isinstance(n, ast.Attribute)}
    classes = [n for n in walk(tree) if isinstance(n, ast.ClassDef)]
    own_classes = {node.name for node in classes}
    fixed_names = fixed | ATTRIBUTES | _module_attributes(tree)
    defined: set[str] = set()
    for node in classes:
        own = set(bound(node.body))
        own |= {
            n.attr
            for n in walk(node)
            if isinstance(n, ast.Attribute)
            and isinstance(n.ctx, ast.Store)
            and isinstance(n.value, ast.Name)
            and n.value.id == "self"
        }
        defined |= own
        if any(not _is_known_base(base, own_classes) for base in node.bases):
            # A base from outside of uros may have an attribute of any name.
            fixed_names |= own | {n.attr for n in walk(node) if isinstance(n, ast.Attribute)}
    renamed = {name for name in defined - fixed_names if not name.startswith("__")}
    families = _families(classes)
    families_of = _families_by_attribute(tree, families)
    # Attributes that only one family uses, on self, may share a name with those of another family.
    private: dict[str, set[str]] = {}
    for name in renamed:
        if len(families_of[name]) == 1 and "" not in families_of[name]:
            private.setdefault(next(iter(families_of[name])), set()).add(name)
    taken = ((used | defined | fixed_names) - set(free)) | _loaded_by_bodies(classes)
    pool = [*_IN_MPY, *_IN_ROM, *free, *_IN_FIRMWARE]
    new: dict[tuple[str, str], str] = {}  # (family, "" for all; name): the new name
    for family, names in sorted(private.items()):
        new_names = _new_names(sorted(names), taken, pool)
        new.update({(family, old): new_name for old, new_name in new_names.items()})
        renamed -= names
    new_names = _new_names(sorted(renamed), taken.union(new.values()), pool)
    new.update({("", old): new_name for old, new_name in new_names.items()})
    for node in classes:
        family = families[node.name]
        members = set(bound(node.body))
        _rename_members(
            node, {name: new.get((family, name), new.get(("", name), name)) for name in members}
        )
    _AttributeRenamer(families, new).visit(tree)


class _AttributeRenamer(Transformer):
    """Renames attributes, and collects which families of classes use each (`families_of`)."""

    def __init__(self, families: dict[str, str], new: dict[tuple[str, str], str]) -> None:
        super().__init__()
        self.families = families
        self.new = new
        self.families_of: dict[str, set[str]] = {}
        self.family = ""

    def visit_ClassDef(self, node: ast.ClassDef) -> ast.AST:
        outer, self.family = self.family, self.families.get(node.name, "")
        for name in bound(node.body):
            self.families_of.setdefault(name, set()).add(self.family)
        self.generic_visit(node)
        self.family = outer
        return node

    def visit_Attribute(self, node: ast.Attribute) -> ast.AST:
        family = self.families.get(receiver(node), "")  # by the annotation of the receiver
        if isinstance(node.value, ast.Name) and node.value.id == "self":
            family = self.family
        if isinstance(node.value, ast.Call) and isinstance(node.value.func, ast.Name):
            family = self.family if node.value.func.id == "super" else ""
        self.families_of.setdefault(node.attr, set()).add(family)
        general = self.new.get(("", node.attr), node.attr)
        node.attr = self.new.get((family, node.attr), general)
        return self.generic_visit(node)


def _loaded_by_bodies(classes: list[ast.ClassDef]) -> set[str]:
    """Return the names that class bodies themselves load, for example decorators.

    A method with such a name would hide the name from the body.
    """
    parts: list[ast.AST] = []
    for node in classes:
        for member in node.body:
            if isinstance(member, FUNCTIONS):
                parts += [*member.decorator_list, *member.args.defaults]
                parts += [default for default in member.args.kw_defaults if default is not None]
            else:
                parts.append(member)
    names = (n for part in parts for n in walk(part) if isinstance(n, ast.Name))
    return {n.id for n in names if isinstance(n.ctx, ast.Load)}


def _families_by_attribute(tree: ast.Module, families: dict[str, str]) -> dict[str, set[str]]:
    """Return for each attribute the families that use it on self; "" for any other use."""
    collector = _AttributeRenamer(families, {})
    collector.visit(tree)
    return collector.families_of


def _families(classes: list[ast.ClassDef]) -> dict[str, str]:
    """Return for each class the name of its family: classes with common bases or subclasses."""
    family = {node.name: node.name for node in classes}
    for node in classes:
        for base in node.bases:
            if isinstance(base, ast.Name) and base.id in family:
                old, new = family[node.name], family[base.id]
                family = {
                    name: new if current == old else current for name, current in family.items()
                }
    return family


def _module_attributes(tree: ast.Module) -> set[str]:
    """Return the attributes of modules and of their objects: ``sys.implementation.name``."""
    modules = {
        alias.asname or alias.name.partition(".")[0]
        for node in walk(tree)
        if isinstance(node, ast.Import)
        for alias in node.names
    }
    attributes = set()
    for node in walk(tree):
        value = node
        while isinstance(value, ast.Attribute):
            value = value.value
        if isinstance(node, ast.Attribute) and isinstance(value, ast.Name):
            if value.id in modules:
                attributes.add(node.attr)
    return attributes


def _is_known_base(base: ast.expr, own_classes: set[str]) -> bool:
    """Whether a base class is of the bundle or builtin, so that its attributes are known."""
    return isinstance(base, ast.Name) and (base.id in own_classes or base.id in CLASSES)


def _rename_members(node: ast.ClassDef, new: dict[str, str]) -> None:
    """Rename what a class body binds, and its reads of these names after they are bound.

    Before that, a name in the body still means the module's.
    """
    bound_names: set[str] = set()
    for member in node.body:
        binds = set(bound([member]))
        parts: list[ast.AST] = [member]
        if isinstance(member, FUNCTIONS):
            parts = [*member.decorator_list, *member.args.defaults]
            parts += [default for default in member.args.kw_defaults if default]
            member.name = new.get(member.name, member.name)
        elif isinstance(member, ast.ClassDef):
            parts = [*member.decorator_list, *member.bases]
            member.name = new.get(member.name, member.name)
        for part in parts:
            for inner in walk(part):
                if isinstance(inner, ast.Name):
                    if inner.id in bound_names or not isinstance(inner.ctx, ast.Load):
                        inner.id = new.get(inner.id, inner.id)
        bound_names |= binds


# --- functions and classes -----------------------------------------------------------------------


def _rename_globals(tree: ast.Module, fixed: set[str]) -> None:
    """Rename functions, classes and values of the bundle to names that it contains in any case."""
    own_classes = {node.name for node in tree.body if isinstance(node, ast.ClassDef)}
    renamed = set()
    for node in tree.body:
        if isinstance(node, ast.ClassDef):
            # An exception is printed with its name.
            if all(isinstance(base, ast.Name) and base.id in own_classes for base in node.bases):
                renamed.add(node.name)
        elif not isinstance(node, (ast.Import, ast.ImportFrom)):
            renamed |= set(bound([node]))
    for node in reversed(tree.body):
        if isinstance(node, ast.ClassDef) and not renamed.issuperset(
            base.id for base in node.bases if isinstance(base, ast.Name)
        ):
            renamed.discard(node.name)
    imported = {
        name
        for node in walk(tree)
        if isinstance(node, (ast.Import, ast.ImportFrom))
        for name in bound([node])
    }
    for inner in walk(tree):
        if isinstance(inner, ast.ClassDef):  # X = X in a class body reads the module's X
            renamed -= set(bound(inner.body))
    names = {n.id for n in walk(tree) if isinstance(n, ast.Name)}
    names |= {n.arg for n in walk(tree) if isinstance(n, ast.arg)}
    names |= {n.name for n in walk(tree) if isinstance(n, (*FUNCTIONS, ast.ClassDef))}
    attributes = {n.attr for n in walk(tree) if isinstance(n, ast.Attribute)}
    attributes = {name for name in attributes if not name.startswith("__") and name not in BUILTINS}
    old_names = sorted(
        name
        for name in renamed - fixed - imported
        if not (name.startswith("__") and name.endswith("__"))
    )
    pool = [*_IN_ROM, *sorted(attributes - set(_IN_ROM))]
    # MicroPython's compiler handles a call of the name const itself.
    new = _new_names(old_names, names | fixed | {"const"} | BUILTINS, pool)
    _GlobalRenamer(new).visit(tree)


def _drop_aliases(tree: ast.Module, fixed: set[str]) -> None:
    """Replace the second name of an object (``Error = ValueError``) by the first."""
    times = times_bound(tree)
    for node in list(tree.body):
        if not (isinstance(node, ast.Assign) and isinstance(node.value, ast.Name)):
            continue
        target, original = node.targets[0], node.value.id
        if len(node.targets) > 1 or not isinstance(target, ast.Name) or target.id in fixed:
            continue
        once = times.get(original) == 1 or (original in BUILTINS and original not in times)
        if times[target.id] == 1 and once:
            others = [statement for statement in tree.body if statement is not node]
            users = [statement for statement in others if target.id in _names(statement)]
            if not any(original in _inner_names(statement) for statement in users):
                tree.body = others
                _GlobalRenamer({target.id: original}).visit(tree)


def _names(node: ast.AST) -> set[str]:
    return {n.id for n in walk(node) if isinstance(n, ast.Name)}


def _inner_names(statement: ast.stmt) -> set[str]:
    """Return all names that functions, classes and comprehensions in a statement bind locally."""
    names = scoped_names(statement)
    for node in walk(statement):
        if isinstance(node, ast.ClassDef):
            names.update(bound(node.body))
    return names


class _GlobalRenamer(Renaming):
    def __init__(self, new: dict[str, str]) -> None:
        super().__init__()
        self.new = new

    def name(self, name: str) -> str:
        return name if self.hidden(name) else self.new.get(name, name)

    def visit_Global(self, node: ast.Global) -> ast.AST:
        node.names = [self.new.get(name, name) for name in node.names]
        return node


# --- parameters ----------------------------------------------------------------------------------


def _rename_parameters(function: ast.FunctionDef | ast.AsyncFunctionDef, fixed: set[str]) -> None:
    taken = {n.id for n in walk(function) if isinstance(n, ast.Name)}
    taken |= {n.arg for n in walk(function) if isinstance(n, ast.arg)}
    taken |= set(bound(function.body))
    own = set(parameters(function.args)) - fixed
    for node in walk(function):
        # Names that an inner scope binds, or declares global or nonlocal, do not change.
        if isinstance(node, ast.ClassDef):
            own -= set(bound(node.body))
        elif isinstance(node, (ast.Global, ast.Nonlocal)):
            own -= set(node.names)
        elif isinstance(node, ast.comprehension):
            own -= set(bound([node.target]))
        elif isinstance(node, (*FUNCTIONS, ast.Lambda)) and node is not function:
            own -= set(parameters(node.args))
            own -= set(bound([node.body] if isinstance(node, ast.Lambda) else node.body))
    free = [name for name in _IN_ROM if name not in taken]
    renamed = [name for name in parameters(function.args) if name in own]
    new = dict(zip(renamed, free, strict=False))
    args = function.args
    for arg in (*args.args, *args.kwonlyargs, args.vararg, args.kwarg):
        if arg:
            arg.arg = new.get(arg.arg, arg.arg)
    for statement in function.body:
        for inner in walk(statement):
            if isinstance(inner, ast.Name):
                inner.id = new.get(inner.id, inner.id)
