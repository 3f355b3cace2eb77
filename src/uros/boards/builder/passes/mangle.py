"""Renames what nobody outside of the bundle can see to names that MicroPython has in its ROM.

A new name costs a board some 20 bytes, a name that MicroPython itself uses costs none, and one of
two letters costs half. The pass renames parameters that no call names, and attributes, functions
and classes that neither the program nor a module beside the bundle names; exceptions are never
renamed. A traceback shows the new names. As with `tree_shake`, a name that is put together at run
time cannot be seen.
"""

from __future__ import annotations

import ast
from collections.abc import Iterable, Iterator
from typing import Final

from ..foreign_names import ATTRIBUTES, BUILTINS, CLASSES
from ..modules import Module, known_names
from ..scopes import FUNCTIONS, Renaming, bound, parameters, scoped_names, times_bound
from .strip import receiver

# MicroPython numbers these in every build (py/makeqstrdata.py); files of bytecode rely on it.
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

# What the firmware of every port has in its modules: math, random, json, struct, binascii, hashlib,
# os, gc, heapq, collections, micropython, sys. Where one is missing, its name costs as any other.
_IN_FIRMWARE: Final = (
    "acos asin atan atan2 ceil copysign cos degrees exp fabs floor fmod frexp isfinite isinf isnan"
    " ldexp log modf pi radians sin sqrt tan trunc choice getrandbits randint random randrange seed"
    " uniform dump dumps load loads calcsize pack unpack a2b_base64 b2a_base64 crc32 hexlify"
    " unhexlify digest sha1 sha256 chdir getcwd ilistdir listdir mkdir remove rename rmdir stat"
    " statvfs uname collect isenabled mem_alloc mem_free threshold heapify heappop heappush deque"
    " namedtuple OrderedDict heap_lock heap_unlock mem_info opt_level qstr_info schedule stack_use"
    " argv byteorder implementation maxsize modules path platform stderr stdin stdout version"
).split()


def mangle(whole: Module, others: Iterable[Module]) -> None:
    """Rename in the bundle ``whole``; ``others`` are all modules that run beside it."""
    others = list(others)
    fixed = known_names(whole.tree, others)
    _drop_aliases(whole.tree, fixed)
    trees = [whole.tree, *(other.tree for other in others)]
    _rename_attributes(whole.tree, fixed, _idle(trees))
    _rename_globals(whole.tree, fixed)
    names = {n.attr for n in ast.walk(whole.tree) if isinstance(n, ast.Attribute)}
    names |= set(bound(whole.tree.body)) | set(_IN_ROM) | {"self"}
    for tree in trees:
        for node in ast.walk(tree):
            if isinstance(node, ast.keyword) and node.arg:
                names.add(node.arg)
            elif isinstance(node, ast.Constant) and isinstance(node.value, str):
                names.add(node.value)
    for node in ast.walk(whole.tree):
        if isinstance(node, FUNCTIONS):
            _rename_parameters(node, names)


def _idle(trees: list[ast.Module]) -> list[str]:
    """Names that the bundle has anyway and that nothing has as an attribute."""
    there: set[str] = set()
    taken: set[str] = set()
    for node in ast.walk(trees[0]):
        if isinstance(node, ast.Name) and node.id in BUILTINS:
            there.add(node.id)
        elif isinstance(node, (ast.Import, ast.ImportFrom)):
            there.update(bound([node]))
    for tree in trees:
        for node in ast.walk(tree):
            if isinstance(node, ast.Attribute):
                taken.add(node.attr)
            elif isinstance(node, ast.ClassDef):
                taken.update(bound(node.body))
            elif isinstance(node, ast.Constant) and isinstance(node.value, str):
                taken.add(node.value)
    return sorted(there - taken - ATTRIBUTES - set(_IN_MPY) - set(_IN_ROM))


def _short() -> Iterator[str]:
    """Names of two letters, none of which is a word of Python."""
    letters = "abcdefghijklmnopqrstuvwxyz"
    for first in letters.upper():
        for second in letters:
            yield first + second


def _take(wanted: Iterable[str], taken: set[str], pool: Iterable[str]) -> dict[str, str]:
    """A new name for each that is wanted: of the pool, or of two letters."""
    free = (name for name in dict.fromkeys((*pool, *_short())) if name not in taken)
    return {old: next(free) for old in wanted if len(old) > 1}


# --- attributes ----------------------------------------------------------------------------------


def _rename_attributes(tree: ast.Module, fixed: set[str], idle: list[str]) -> None:
    """Those that classes of the bundle bind, unless something else may have one of that name."""
    used = {n.attr for n in ast.walk(tree) if isinstance(n, ast.Attribute)}
    classes = [n for n in ast.walk(tree) if isinstance(n, ast.ClassDef)]
    ours = {node.name for node in classes}
    kept = fixed | ATTRIBUTES | _of_modules(tree)
    defined: set[str] = set()
    for node in classes:
        own = set(bound(node.body))
        own |= {
            n.attr
            for n in ast.walk(node)
            if isinstance(n, ast.Attribute)
            and isinstance(n.ctx, ast.Store)
            and isinstance(n.value, ast.Name)
            and n.value.id == "self"
        }
        defined |= own
        if any(not _is_ours(base, ours) for base in node.bases):
            # A base that is not ours may have an attribute of any name.
            kept |= own | {n.attr for n in ast.walk(node) if isinstance(n, ast.Attribute)}
    wanted = {name for name in defined - kept if not name.startswith("__")}
    families = _families(classes)
    homes = _homes(tree, families)
    # What only one family asks of itself may be called as what another does.
    private: dict[str, set[str]] = {}
    for name in wanted:
        if len(homes[name]) == 1 and "" not in homes[name]:
            private.setdefault(next(iter(homes[name])), set()).add(name)
    taken = ((used | defined | kept) - set(idle)) | _loaded_by_bodies(classes)
    pool = [*_IN_MPY, *_IN_ROM, *idle, *_IN_FIRMWARE]
    new: dict[tuple[str, str], str] = {}  # (family, "" for all; name): the new name
    for family, names in sorted(private.items()):
        chosen = _take(sorted(names), taken, pool)
        new.update({(family, old): it for old, it in chosen.items()})
        wanted -= names
    chosen = _take(sorted(wanted), taken.union(new.values()), pool)
    new.update({("", old): it for old, it in chosen.items()})
    for node in classes:
        its = families[node.name]
        members = set(bound(node.body))
        _rename_members(
            node, {name: new.get((its, name), new.get(("", name), name)) for name in members}
        )
    _Attributes(families, new).visit(tree)


class _Attributes(ast.NodeTransformer):
    """Renames attributes, or with nothing to rename notes the families that ask for each."""

    def __init__(self, families: dict[str, str], new: dict[tuple[str, str], str]) -> None:
        self.families = families
        self.new = new
        self.homes: dict[str, set[str]] = {}
        self.family = ""

    def visit_ClassDef(self, node: ast.ClassDef) -> ast.AST:
        outer, self.family = self.family, self.families.get(node.name, "")
        for name in bound(node.body):
            self.homes.setdefault(name, set()).add(self.family)
        self.generic_visit(node)
        self.family = outer
        return node

    def visit_Attribute(self, node: ast.Attribute) -> ast.AST:
        family = self.families.get(receiver(node), "")  # as its annotation says
        if isinstance(node.value, ast.Name) and node.value.id == "self":
            family = self.family
        if isinstance(node.value, ast.Call) and isinstance(node.value.func, ast.Name):
            family = self.family if node.value.func.id == "super" else ""
        self.homes.setdefault(node.attr, set()).add(family)
        general = self.new.get(("", node.attr), node.attr)
        node.attr = self.new.get((family, node.attr), general)
        return self.generic_visit(node)


def _loaded_by_bodies(classes: list[ast.ClassDef]) -> set[str]:
    """Return the names that class bodies load themselves, as decorators are.

    A method of such a name would hide what the body means.
    """
    parts: list[ast.AST] = []
    for node in classes:
        for it in node.body:
            if isinstance(it, FUNCTIONS):
                parts += [*it.decorator_list, *it.args.defaults]
                parts += [default for default in it.args.kw_defaults if default is not None]
            else:
                parts.append(it)
    names = (n for part in parts for n in ast.walk(part) if isinstance(n, ast.Name))
    return {n.id for n in names if isinstance(n.ctx, ast.Load)}


def _homes(tree: ast.Module, families: dict[str, str]) -> dict[str, set[str]]:
    """By each attribute, the families that ask themselves for it; "" where others ask."""
    walk = _Attributes(families, {})
    walk.visit(tree)
    return walk.homes


def _families(classes: list[ast.ClassDef]) -> dict[str, str]:
    """Each class's name, and one for all that it has bases or heirs in common with."""
    family = {node.name: node.name for node in classes}
    for node in classes:
        for base in node.bases:
            if isinstance(base, ast.Name) and base.id in family:
                old, its = family[node.name], family[base.id]
                family = {name: its if it == old else it for name, it in family.items()}
    return family


def _of_modules(tree: ast.Module) -> set[str]:
    """Return the attributes of modules and of what modules hold: ``sys.implementation.name``."""
    modules = {
        alias.asname or alias.name.partition(".")[0]
        for node in ast.walk(tree)
        if isinstance(node, ast.Import)
        for alias in node.names
    }
    found = set()
    for node in ast.walk(tree):
        value = node
        while isinstance(value, ast.Attribute):
            value = value.value
        if isinstance(node, ast.Attribute) and isinstance(value, ast.Name):
            if value.id in modules:
                found.add(node.attr)
    return found


def _is_ours(base: ast.expr, ours: set[str]) -> bool:
    """Whether a base class is of the bundle; those of Python itself have names that are known."""
    return isinstance(base, ast.Name) and (base.id in ours or base.id in CLASSES)


def _rename_members(node: ast.ClassDef, new: dict[str, str]) -> None:
    """Rename what a class body binds, and its reads of these names after they are bound.

    Before that, a name in the body still means the module's.
    """
    there: set[str] = set()
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
            for inner in ast.walk(part):
                if isinstance(inner, ast.Name):
                    if inner.id in there or not isinstance(inner.ctx, ast.Load):
                        inner.id = new.get(inner.id, inner.id)
        there |= binds


# --- functions and classes -----------------------------------------------------------------------


def _rename_globals(tree: ast.Module, fixed: set[str]) -> None:
    """Functions, classes and values of the bundle, by names that something in it has anyway."""
    ours = {node.name for node in tree.body if isinstance(node, ast.ClassDef)}
    wanted = set()
    for node in tree.body:
        if isinstance(node, ast.ClassDef):
            # An exception is printed by its name.
            if all(isinstance(base, ast.Name) and base.id in ours for base in node.bases):
                wanted.add(node.name)
        elif not isinstance(node, (ast.Import, ast.ImportFrom)):
            wanted |= set(bound([node]))
    for node in reversed(tree.body):
        if isinstance(node, ast.ClassDef) and not wanted.issuperset(
            base.id for base in node.bases if isinstance(base, ast.Name)
        ):
            wanted.discard(node.name)
    imported = {
        name
        for node in ast.walk(tree)
        if isinstance(node, (ast.Import, ast.ImportFrom))
        for name in bound([node])
    }
    for inner in ast.walk(tree):
        if isinstance(inner, ast.ClassDef):  # one in which it says X = X reads the module's
            wanted -= set(bound(inner.body))
    names = {n.id for n in ast.walk(tree) if isinstance(n, ast.Name)}
    names |= {n.arg for n in ast.walk(tree) if isinstance(n, ast.arg)}
    names |= {n.name for n in ast.walk(tree) if isinstance(n, (*FUNCTIONS, ast.ClassDef))}
    there = {n.attr for n in ast.walk(tree) if isinstance(n, ast.Attribute)}
    there = {it for it in there if not it.startswith("__") and it not in BUILTINS}
    final = sorted(
        it for it in wanted - fixed - imported if not (it.startswith("__") and it.endswith("__"))
    )
    pool = [*_IN_ROM, *sorted(there - set(_IN_ROM))]
    # MicroPython's compiler takes a call of const for its own.
    new = _take(final, names | fixed | {"const"} | BUILTINS, pool)
    _Globals(new).visit(tree)


def _drop_aliases(tree: ast.Module, fixed: set[str]) -> None:
    """Where the module has two names for one object (``Error = ValueError``), use one alone."""
    times = times_bound(tree)
    for node in list(tree.body):
        if not (isinstance(node, ast.Assign) and isinstance(node.value, ast.Name)):
            continue
        target, real = node.targets[0], node.value.id
        if len(node.targets) > 1 or not isinstance(target, ast.Name) or target.id in fixed:
            continue
        once = times.get(real) == 1 or (real in BUILTINS and real not in times)
        if times[target.id] == 1 and once:
            others = [it for it in tree.body if it is not node]
            asking = [it for it in others if target.id in _names(it)]
            if not any(real in _inner_names(it) for it in asking):
                tree.body = others
                _Globals({target.id: real}).visit(tree)


def _names(node: ast.AST) -> set[str]:
    return {n.id for n in ast.walk(node) if isinstance(n, ast.Name)}


def _inner_names(statement: ast.stmt) -> set[str]:
    """All that functions, classes and comprehensions in a statement bind for themselves."""
    names = scoped_names(statement)
    for node in ast.walk(statement):
        if isinstance(node, ast.ClassDef):
            names.update(bound(node.body))
    return names


class _Globals(Renaming):
    def __init__(self, new: dict[str, str]) -> None:
        super().__init__()
        self.new = new

    def name(self, name: str) -> str:
        return name if self.hidden(name) else self.new.get(name, name)

    def visit_Global(self, node: ast.Global) -> ast.AST:
        node.names = [self.new.get(name, name) for name in node.names]
        return node


# --- parameters ----------------------------------------------------------------------------------


def _rename_parameters(function: ast.FunctionDef | ast.AsyncFunctionDef, kept: set[str]) -> None:
    taken = {n.id for n in ast.walk(function) if isinstance(n, ast.Name)}
    taken |= {n.arg for n in ast.walk(function) if isinstance(n, ast.arg)}
    taken |= set(bound(function.body))
    own = set(parameters(function.args)) - kept
    for node in ast.walk(function):
        # What an inner scope binds, and what one shares by name, stays as it is.
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
        for inner in ast.walk(statement):
            if isinstance(inner, ast.Name):
                inner.id = new.get(inner.id, inner.id)
