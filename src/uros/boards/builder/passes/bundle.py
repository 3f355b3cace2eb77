"""Puts the modules of uros and of interfaces into one.

A module by itself costs a board some 300 bytes: its object, its table of names, and one entry more
for each name that another module imports. The modules that the program itself imports stay, each
as a line that takes its names from the one (a front); so do those that only a function of the
program imports.

The program's own modules are no part of it: put elsewhere, one would have another ``__name__``,
other globals, and another time at which it runs, and what others set in it (``app.x = 1``) would be
lost. For the same reason a bundle is refused where the program sets a name of one of uros's
modules, or does with such a module anything else than to take a name from it.
"""

from __future__ import annotations

import ast
from collections.abc import Iterable, Iterator
from typing import Final

from ..foreign_names import BUILTINS
from ..modules import Module, absolute, imports
from ..scopes import Renaming, Scopes, bound, scoped_names

BUNDLE: Final = "uros._all"
"""The module that holds all others."""


class NotBundled(Exception):
    """The modules cannot become one; the text says where and why."""


def bundle(modules: dict[str, Module]) -> dict[str, Module]:
    """The program's modules, one that holds all others, and those the program needs by name.

    Raises `NotBundled` where a module is used as a value, other than to take its names.
    """
    ordered = _in_order(modules)
    parts = {module.name: module for module in ordered if not module.own}
    if not parts:
        return modules
    for module in modules.values():
        if module.own:
            _only_takes_names(module, modules, parts)
    names = _Names(modules, parts)
    fronts = _fronts([m for m in modules.values() if m.name not in parts], parts, names)
    body: list[ast.stmt] = []
    for part in parts.values():
        body += _Rename(part, names).visit(part.tree).body
    whole = Module(BUNDLE, False, "uros", "", ast.Module(_without_doubles(body), []))
    ast.fix_missing_locations(whole.tree)
    left = {name: module for name, module in modules.items() if name not in parts}
    return {**left, BUNDLE: whole, **fronts}


def _only_takes_names(module: Module, modules: dict[str, Module], parts: dict[str, Module]) -> None:
    """Raises `NotBundled` where a module of the program does more with uros's than take names."""
    held: dict[str, str] = {}  # by the name here, the module that it is
    for node in ast.walk(module.tree):
        if isinstance(node, ast.Import):
            for alias in node.names:
                top = alias.name.partition(".")[0]
                held[alias.asname or top] = alias.name if alias.asname else top
        elif isinstance(node, ast.ImportFrom):
            base = absolute(node, module)
            for alias in node.names:
                if f"{base}.{alias.name}" in modules:
                    held[alias.asname or alias.name] = f"{base}.{alias.name}"
    packages = {name.rsplit(".", up)[0] for name in parts for up in range(name.count(".") + 1)}
    held = {here: name for here, name in held.items() if name in packages}
    others = {n.id for n in ast.walk(module.tree) if isinstance(n, ast.Name) and _is_bound(n)}
    others |= {n.arg for n in ast.walk(module.tree) if isinstance(n, ast.arg)}
    seen = _Seen()
    seen.visit(module.tree)
    above = {
        id(child): node for node in ast.walk(module.tree) for child in ast.iter_child_nodes(node)
    }
    for node in ast.walk(module.tree):
        if not isinstance(node, ast.Name) or node.id not in held:
            continue
        if node.id in others and id(node) not in seen.names:
            continue  # a variable of the same name
        what, place = held[node.id], f"{module.source}:{node.lineno}"
        asked = above[id(node)]
        while isinstance(asked, ast.Attribute) and f"{what}.{asked.attr}" in packages:
            what += f".{asked.attr}"
            asked = above[id(asked)]
        if not isinstance(asked, ast.Attribute):
            if isinstance(node.ctx, ast.Load):
                raise NotBundled(f"{place}: the module {what} is used as a value")
        elif not isinstance(asked.ctx, ast.Load) and what in parts:
            raise NotBundled(f"{place}: sets {what}.{asked.attr}, which uros would not see")


def _in_order(modules: dict[str, Module]) -> list[Module]:
    """What runs when the program starts, in that order: what a module imports comes before it.

    What uros itself imports later, in a function that the program has asked for, comes behind it.
    Not what else is imported later, or may fail: that waits for its time.
    """
    ordered: dict[str, Module] = {}
    seen: set[str] = set()

    def place(name: str) -> None:
        if name not in modules or name in seen:
            return
        seen.add(name)
        place(name.rpartition(".")[0])
        late = []
        for wanted in imports(modules[name]):
            asked = wanted.late and not (wanted.perhaps or wanted.optional)
            if asked and wanted.module.startswith("uros."):
                late.append(wanted.module)
            if not wanted.late and not wanted.optional:
                place(wanted.module)
                for there, _ in wanted.names or ():
                    place(f"{wanted.module}.{there}")
        ordered[name] = modules[name]
        if not modules[name].own:
            for other in late:
                place(other)

    own = [name for name, module in modules.items() if module.own]
    for name in [name for name in ("boot", "main") if name in own] or own:
        place(name)
    return list(ordered.values())


class _Names:
    """What each module's names are called in the bundle."""

    def __init__(self, modules: dict[str, Module], parts: dict[str, Module]) -> None:
        self.modules = modules
        self.parts = parts
        self.new: dict[tuple[str, str], str] = {}  # (module, its name) -> name in the bundle
        self.brought: dict[tuple[str, str], tuple[str, str]] = {}  # the same -> whence imported
        # Name in the bundle -> what it stands for. What one module calls like a builtin must not
        # hide that from the others.
        owners: dict[str, object] = {name: "a builtin" for name in sorted(BUILTINS)}
        # A module that has another spelling for a name may have a local variable of its real one.
        for name in _respelled(parts.values()) & _locals(parts.values()):
            owners[name] = "a local variable"
        self.everywhere = _identifiers(parts.values())
        for module in parts.values():
            for node in module.tree.body:
                self.imported(module, node, owners)
        for module in parts.values():
            for name in dict.fromkeys(_top_level(module)):
                if (module.name, name) not in self.brought and (module.name, name) not in self.new:
                    self.take(module, name, (module.name, name), owners)

    def imported(self, module: Module, node: ast.stmt, owners: dict[str, object]) -> None:
        if isinstance(node, ast.ImportFrom):
            base = absolute(node, module)
            for alias in node.names:
                here = (module.name, alias.asname or alias.name)
                if base in self.parts and alias.name in _rebound(self.parts[base]):
                    what = f"{base}.{alias.name}"
                    raise NotBundled(f"{module.source}:{node.lineno}: {what} changes")
                if base in self.parts or f"{base}.{alias.name}" in self.parts:
                    self.brought[here] = (base, alias.name)
                else:
                    self.take(module, here[1], (base, alias.name), owners)
        elif isinstance(node, ast.Import):
            for alias in node.names:
                if alias.name in self.parts:
                    raise NotBundled(f"{module.source}:{node.lineno}: import {alias.name}")
                self.take(module, alias.asname or alias.name, alias.name, owners)

    def take(self, module: Module, name: str, what: object, owners: dict[str, object]) -> None:
        new, count = name, 1
        while owners.setdefault(new, what) != what or (count > 1 and new in self.everywhere):
            count += 1
            new = f"{name}_{count}"
        self.new[module.name, name] = new

    def find(self, module: str, name: str) -> str | None:
        """What ``module.name`` is called; None where it is a module, or nothing."""
        while (module, name) in self.brought:
            module, name = self.brought[module, name]
        return self.new.get((module, name))

    def module(self, module: str, name: str) -> str:
        """The module of the bundle that ``module.name`` is, "" where it is none."""
        while (module, name) in self.brought:
            module, name = self.brought[module, name]
            if f"{module}.{name}" in self.parts and (module, name) not in self.new:
                return f"{module}.{name}"
        return ""


def _respelled(modules: Iterable[Module]) -> set[str]:
    """Names that are reached in another way than by themselves: as attributes, or by an alias."""
    names: set[str] = set()
    for module in modules:
        for node in ast.walk(module.tree):
            if isinstance(node, ast.Attribute):
                names.add(node.attr)
            elif isinstance(node, ast.ImportFrom):
                names.update(alias.name for alias in node.names if alias.asname)
    return names


def _locals(modules: Iterable[Module]) -> set[str]:
    """The names of all local variables and parameters."""
    return {name for module in modules for name in scoped_names(module.tree)}


def _identifiers(modules: Iterable[Module]) -> set[str]:
    return {n.id for m in modules for n in ast.walk(m.tree) if isinstance(n, ast.Name)}


def _is_bound(node: ast.Name) -> bool:
    return not isinstance(node.ctx, ast.Load)


class _Seen(Scopes):
    """The places of names that are the module's, and no inner scope's."""

    def __init__(self) -> None:
        super().__init__()
        self.names: set[int] = set()

    def visit_Name(self, node: ast.Name) -> ast.AST:
        if not self.hidden(node.id):
            self.names.add(id(node))
        return node


def _rebound(module: Module) -> set[str]:
    """The names of a module that its functions bind anew."""
    return {
        name
        for node in ast.walk(module.tree)
        if isinstance(node, ast.Global)
        for name in node.names
    }


def _top_level(module: Module) -> Iterator[str]:
    yield from bound(module.tree.body)
    for node in ast.walk(module.tree):
        if isinstance(node, ast.Global):
            yield from node.names


class _Rename(Renaming):
    """Gives a module's names their new ones, and takes its imports of other parts out."""

    def __init__(self, module: Module, names: _Names) -> None:
        super().__init__()
        self.module = module
        self.names = names

    def name(self, name: str) -> str:
        if self.hidden(name):
            return name
        if self.names.module(self.module.name, name):
            raise NotBundled(f"{self.module.source}: the module {name} is used as a value")
        return self.names.find(self.module.name, name) or name

    def visit_Attribute(self, node: ast.Attribute) -> ast.AST:
        base = node.value
        if isinstance(base, ast.Name) and not self.hidden(base.id):
            part = self.names.module(self.module.name, base.id)
            if part:
                found = self.names.find(part, node.attr)
                if found is None:
                    raise NotBundled(f"{self.module.source}: no name {base.id}.{node.attr}")
                if not isinstance(node.ctx, ast.Load):
                    raise NotBundled(f"{self.module.source}: sets {base.id}.{node.attr}")
                return ast.copy_location(ast.Name(found, node.ctx), node)
        return self.generic_visit(node)

    def visit_Global(self, node: ast.Global) -> ast.AST:
        node.names = [self.names.find(self.module.name, n) or n for n in node.names]
        return node

    def visit_Import(self, node: ast.Import) -> ast.AST:
        for alias in node.names:
            here = alias.asname or alias.name.partition(".")[0]
            new = self.name(here)
            if new != here:
                alias.asname = new
        return node

    def visit_ImportFrom(self, node: ast.ImportFrom) -> list[ast.ImportFrom]:
        base = absolute(node, self.module)
        aliases: dict[str, list[ast.alias]] = {}  # by the module that they come from now
        for alias in node.names:
            here = alias.asname or alias.name
            if not self.scopes and (self.module.name, here) in self.names.brought:
                continue
            origin, there, full = base, alias.name, f"{base}.{alias.name}"
            if full in self.names.parts:
                raise NotBundled(f"{self.module.source}:{node.lineno}: a module in a function")
            if base in self.names.parts and full not in self.names.modules:
                origin, there = BUNDLE, self.names.find(base, alias.name) or ""
                if not there:
                    raise NotBundled(f"{self.module.source}:{node.lineno}: no name {alias.name}")
            new = here if self.scopes else self.name(here)
            taken = ast.alias(there, new if new != there else None)
            aliases.setdefault(origin, []).append(taken)
        return [ast.ImportFrom(origin, taken, 0) for origin, taken in aliases.items()]


def _without_doubles(body: list[ast.stmt]) -> list[ast.stmt]:
    """Imports that several modules made stand once."""
    seen: set[str] = set()
    kept: list[ast.stmt] = []
    for node in body:
        if isinstance(node, (ast.Import, ast.ImportFrom)):
            base = node.module if isinstance(node, ast.ImportFrom) else ""
            fresh = {f"{base}:{a.name}:{a.asname}": a for a in node.names}
            node.names = [alias for key, alias in fresh.items() if key not in seen]
            seen.update(fresh)
            if not node.names:
                continue
        kept.append(node)
    return kept


def _fronts(others: list[Module], parts: dict[str, Module], names: _Names) -> dict[str, Module]:
    """The modules that other modules name, each with what these may take from them."""
    wanted: dict[str, dict[str, None]] = {}

    def hold(name: str) -> None:
        module = parts[name]
        wanted.setdefault(name, {}).update(dict.fromkeys(_top_level(module)))

    for module in others:
        for want in imports(module):
            base = want.module
            for there, _ in want.names or ():
                if f"{base}.{there}" in parts:
                    hold(f"{base}.{there}")
                elif there == "*":
                    hold(base)
                elif base in parts:
                    wanted.setdefault(base, {})[there] = None
            while want.names is None and base:  # import a.b.c makes all three reachable
                if base in parts:
                    hold(base)
                base = base.rpartition(".")[0]
    fronts: dict[str, Module] = {}
    for name, taken in wanted.items():
        changing = _rebound(parts[name]) & taken.keys()
        if changing:
            what = f"{name}.{min(changing)}"
            raise NotBundled(f"{parts[name].source}: {what} is asked from outside, and changes")
        pairs = [(names.find(name, n), n) for n in taken]
        aliases = [ast.alias(new, n if n != new else None) for new, n in pairs if new]
        body: list[ast.stmt] = [ast.ImportFrom(BUNDLE, aliases, 0)] if aliases else []
        part = parts[name]
        fronts[name] = Module(name, part.package, part.source, "", ast.Module(body, []))
    return fronts
