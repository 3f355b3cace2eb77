"""Joins the modules of uros and of interfaces into one.

Each module costs a board some 300 bytes: its object, its table of names, and one entry for each
name that another module imports. A module that the program itself imports, also in a function,
stays as a re-exporting module: one line that imports its names from the bundle.

The program's own modules are not bundled. In the bundle such a module would have another
``__name__``, other globals and another time at which it runs, and names that other modules set in
it (``app.x = 1``) would be lost. For the same reason a bundle is refused if the program sets a name
of a module of uros, or uses such a module for anything but reading a name of it.
"""

from __future__ import annotations

import ast
from collections.abc import Iterable, Iterator
from typing import Final

from ..foreign_names import BUILTINS
from ..modules import Module, absolute, imports
from ..scopes import Renaming, Scopes, bound, scoped_names, walk

BUNDLE: Final = "uros._all"
"""The name of the bundle."""


class NotBundled(Exception):
    """The modules cannot become one; the text names the file, the line and the reason."""


def bundle(modules: dict[str, Module]) -> dict[str, Module]:
    """Return the program's modules, the bundle, and the re-exporting modules.

    Raises:
        NotBundled: The program sets a name of a module of uros, or uses a module as a value.
    """
    ordered = _in_order(modules)
    parts = {module.name: module for module in ordered if not module.own}
    if not parts:
        return modules
    for module in modules.values():
        if module.own:
            _check_module_uses(module, modules, parts)
    bundle_names = _BundleNames(modules, parts)
    reexports = _reexports(
        [module for module in modules.values() if module.name not in parts], parts, bundle_names
    )
    body: list[ast.stmt] = []
    for part in parts.values():
        body += _Rename(part, bundle_names).visit(part.tree).body
    bundled = Module(BUNDLE, False, "uros", "", ast.Module(_without_repeated_imports(body), []))
    ast.fix_missing_locations(bundled.tree)
    unchanged = {name: module for name, module in modules.items() if name not in parts}
    return {**unchanged, BUNDLE: bundled, **reexports}


def _check_module_uses(
    module: Module, modules: dict[str, Module], parts: dict[str, Module]
) -> None:
    """Raise NotBundled if a program's module does more than read names of uros's modules."""
    module_names: dict[str, str] = {}  # local name -> full name of the module
    for node in walk(module.tree):
        if isinstance(node, ast.Import):
            for alias in node.names:
                top = alias.name.partition(".")[0]
                module_names[alias.asname or top] = alias.name if alias.asname else top
        elif isinstance(node, ast.ImportFrom):
            base = absolute(node, module)
            for alias in node.names:
                if f"{base}.{alias.name}" in modules:
                    module_names[alias.asname or alias.name] = f"{base}.{alias.name}"
    packages = {
        name.rsplit(".", levels)[0] for name in parts for levels in range(name.count(".") + 1)
    }
    module_names = {
        local_name: name for local_name, name in module_names.items() if name in packages
    }
    rebound = {
        inner.id for inner in walk(module.tree) if isinstance(inner, ast.Name) and _is_bound(inner)
    }
    rebound |= {inner.arg for inner in walk(module.tree) if isinstance(inner, ast.arg)}
    module_level = _ModuleNames()
    module_level.visit(module.tree)
    parents = {
        id(child): node for node in walk(module.tree) for child in ast.iter_child_nodes(node)
    }
    for node in walk(module.tree):
        if not isinstance(node, ast.Name) or node.id not in module_names:
            continue
        if node.id in rebound and id(node) not in module_level.names:
            continue  # a variable of the same name
        module_name, place = module_names[node.id], f"{module.source}:{node.lineno}"
        parent = parents[id(node)]
        while isinstance(parent, ast.Attribute) and f"{module_name}.{parent.attr}" in packages:
            module_name += f".{parent.attr}"
            parent = parents[id(parent)]
        if not isinstance(parent, ast.Attribute):
            if isinstance(node.ctx, ast.Load):
                raise NotBundled(f"{place}: the module {module_name} is used as a value")
        elif not isinstance(parent.ctx, ast.Load) and module_name in parts:
            raise NotBundled(f"{place}: sets {module_name}.{parent.attr}, which uros would not see")


def _in_order(modules: dict[str, Module]) -> list[Module]:
    """Return the modules that run when the program starts, each after those that it imports.

    A module that a function of uros imports follows the module of that function, unless a special
    method imports it. Modules that other functions import, and those whose import may fail, are
    left out: they still run at their own import.
    """
    ordered: dict[str, Module] = {}
    visited: set[str] = set()

    def add(name: str) -> None:
        if name not in modules or name in visited:
            return
        visited.add(name)
        add(name.rpartition(".")[0])
        later = []
        for wanted in imports(modules[name]):
            certain = wanted.late and not (wanted.in_special_method or wanted.optional)
            if certain and wanted.module.startswith("uros."):
                later.append(wanted.module)
            if not wanted.late and not wanted.optional:
                add(wanted.module)
                for imported_name, _ in wanted.names or ():
                    add(f"{wanted.module}.{imported_name}")
        ordered[name] = modules[name]
        if not modules[name].own:
            for later_name in later:
                add(later_name)

    own = [name for name, module in modules.items() if module.own]
    for name in [name for name in ("boot", "main") if name in own] or own:
        add(name)
    return list(ordered.values())


class _BundleNames:
    """The names in the bundle for the names of each module."""

    def __init__(self, modules: dict[str, Module], parts: dict[str, Module]) -> None:
        self.modules = modules
        self.parts = parts
        self.new: dict[tuple[str, str], str] = {}  # (module, its name) -> name in the bundle
        # (module, its name) -> (module from which it imports the name, name there)
        self.imported_names: dict[tuple[str, str], tuple[str, str]] = {}
        # Name in the bundle -> its meaning. A name of one module must not hide a builtin of the
        # same name from the others.
        owners: dict[str, object] = {name: "a builtin" for name in sorted(BUILTINS)}
        # A module that uses an alias or attribute may have a local variable of the real name.
        for name in _respelled(parts.values()) & _locals(parts.values()):
            owners[name] = "a local variable"
        self.identifiers = _identifiers(parts.values())
        for module in parts.values():
            for node in module.tree.body:
                self.add_import(module, node, owners)
        for module in parts.values():
            for name in dict.fromkeys(_top_level(module)):
                key = (module.name, name)
                if key not in self.imported_names and key not in self.new:
                    self.choose_name(module, name, key, owners)

    def add_import(self, module: Module, node: ast.stmt, owners: dict[str, object]) -> None:
        if isinstance(node, ast.ImportFrom):
            base = absolute(node, module)
            for alias in node.names:
                key = (module.name, alias.asname or alias.name)
                if base in self.parts and alias.name in _rebound(self.parts[base]):
                    full_name = f"{base}.{alias.name}"
                    raise NotBundled(f"{module.source}:{node.lineno}: {full_name} changes")
                if base in self.parts or f"{base}.{alias.name}" in self.parts:
                    self.imported_names[key] = (base, alias.name)
                else:
                    self.choose_name(module, key[1], (base, alias.name), owners)
        elif isinstance(node, ast.Import):
            for alias in node.names:
                if alias.name in self.parts:
                    raise NotBundled(f"{module.source}:{node.lineno}: import {alias.name}")
                self.choose_name(module, alias.asname or alias.name, alias.name, owners)

    def choose_name(
        self, module: Module, name: str, meaning: object, owners: dict[str, object]
    ) -> None:
        new, count = name, 1
        while owners.setdefault(new, meaning) != meaning or (count > 1 and new in self.identifiers):
            count += 1
            new = f"{name}_{count}"
        self.new[module.name, name] = new

    def find(self, module: str, name: str) -> str | None:
        """Return the bundle's name for ``module.name``; None if that is a module, or unknown."""
        while (module, name) in self.imported_names:
            module, name = self.imported_names[module, name]
        return self.new.get((module, name))

    def module(self, module: str, name: str) -> str:
        """Return the bundled module that ``module.name`` is; "" if it is not one."""
        while (module, name) in self.imported_names:
            module, name = self.imported_names[module, name]
            if f"{module}.{name}" in self.parts and (module, name) not in self.new:
                return f"{module}.{name}"
        return ""


def _respelled(modules: Iterable[Module]) -> set[str]:
    """Return the names that code reaches as attributes, or by an alias."""
    names: set[str] = set()
    for module in modules:
        for node in walk(module.tree):
            if isinstance(node, ast.Attribute):
                names.add(node.attr)
            elif isinstance(node, ast.ImportFrom):
                names.update(alias.name for alias in node.names if alias.asname)
    return names


def _locals(modules: Iterable[Module]) -> set[str]:
    """Return the names of all local variables and parameters."""
    return {name for module in modules for name in scoped_names(module.tree)}


def _identifiers(modules: Iterable[Module]) -> set[str]:
    return {n.id for m in modules for n in walk(m.tree) if isinstance(n, ast.Name)}


def _is_bound(node: ast.Name) -> bool:
    return not isinstance(node.ctx, ast.Load)


class _ModuleNames(Scopes):
    """Collects the nodes of names of the module itself, and not of an inner scope."""

    def __init__(self) -> None:
        super().__init__()
        self.names: set[int] = set()

    def visit_Name(self, node: ast.Name) -> ast.AST:
        if not self.hidden(node.id):
            self.names.add(id(node))
        return node


def _rebound(module: Module) -> set[str]:
    """Return the names of a module that its functions rebind."""
    return {
        name for node in walk(module.tree) if isinstance(node, ast.Global) for name in node.names
    }


def _top_level(module: Module) -> Iterator[str]:
    yield from bound(module.tree.body)
    for node in walk(module.tree):
        if isinstance(node, ast.Global):
            yield from node.names


class _Rename(Renaming):
    """Renames a module's names for the bundle, and drops its imports of other bundled modules."""

    def __init__(self, module: Module, names: _BundleNames) -> None:
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
                new = self.names.find(part, node.attr)
                if new is None:
                    raise NotBundled(f"{self.module.source}: no name {base.id}.{node.attr}")
                if not isinstance(node.ctx, ast.Load):
                    raise NotBundled(f"{self.module.source}: sets {base.id}.{node.attr}")
                return ast.copy_location(ast.Name(new, node.ctx), node)
        return self.generic_visit(node)

    def visit_Global(self, node: ast.Global) -> ast.AST:
        node.names = [self.names.find(self.module.name, n) or n for n in node.names]
        return node

    def visit_Import(self, node: ast.Import) -> ast.AST:
        for alias in node.names:
            local_name = alias.asname or alias.name.partition(".")[0]
            new = self.name(local_name)
            if new != local_name:
                alias.asname = new
        return node

    def visit_ImportFrom(self, node: ast.ImportFrom) -> list[ast.ImportFrom]:
        base = absolute(node, self.module)
        aliases: dict[str, list[ast.alias]] = {}  # by the module that they now come from
        for alias in node.names:
            local_name = alias.asname or alias.name
            if not self.scopes and (self.module.name, local_name) in self.names.imported_names:
                continue
            origin, imported_name, full = base, alias.name, f"{base}.{alias.name}"
            if full in self.names.parts:
                raise NotBundled(f"{self.module.source}:{node.lineno}: a module in a function")
            if base in self.names.parts and full not in self.names.modules:
                origin, imported_name = BUNDLE, self.names.find(base, alias.name) or ""
                if not imported_name:
                    raise NotBundled(f"{self.module.source}:{node.lineno}: no name {alias.name}")
            new = local_name if self.scopes else self.name(local_name)
            imported = ast.alias(imported_name, new if new != imported_name else None)
            aliases.setdefault(origin, []).append(imported)
        return [ast.ImportFrom(origin, imported, 0) for origin, imported in aliases.items()]


def _without_repeated_imports(body: list[ast.stmt]) -> list[ast.stmt]:
    """Drop imports that an earlier module of the bundle has made already."""
    known: set[str] = set()
    statements: list[ast.stmt] = []
    for node in body:
        if isinstance(node, (ast.Import, ast.ImportFrom)):
            base = node.module if isinstance(node, ast.ImportFrom) else ""
            keys = {f"{base}:{alias.name}:{alias.asname}": alias for alias in node.names}
            node.names = [alias for key, alias in keys.items() if key not in known]
            known.update(keys)
            if not node.names:
                continue
        statements.append(node)
    return statements


def _reexports(
    importers: list[Module], parts: dict[str, Module], names: _BundleNames
) -> dict[str, Module]:
    """Return the modules that other modules import, each with the names that these may use."""
    needed: dict[str, dict[str, None]] = {}

    def add_all(name: str) -> None:
        module = parts[name]
        needed.setdefault(name, {}).update(dict.fromkeys(_top_level(module)))

    for module in importers:
        for imported in imports(module):
            base = imported.module
            for name, _ in imported.names or ():
                if f"{base}.{name}" in parts:
                    add_all(f"{base}.{name}")
                elif name == "*":
                    add_all(base)
                elif base in parts:
                    needed.setdefault(base, {})[name] = None
            while imported.names is None and base:  # import a.b.c makes all three reachable
                if base in parts:
                    add_all(base)
                base = base.rpartition(".")[0]
    reexports: dict[str, Module] = {}
    for name, needed_names in needed.items():
        changing = _rebound(parts[name]) & needed_names.keys()
        if changing:
            full_name = f"{name}.{min(changing)}"
            raise NotBundled(
                f"{parts[name].source}: {full_name} is asked from outside, and changes"
            )
        pairs = [(names.find(name, old), old) for old in needed_names]
        aliases = [ast.alias(new, old if old != new else None) for new, old in pairs if new]
        body: list[ast.stmt] = [ast.ImportFrom(BUNDLE, aliases, 0)] if aliases else []
        part = parts[name]
        reexports[name] = Module(name, part.package, part.source, "", ast.Module(body, []))
    return reexports
