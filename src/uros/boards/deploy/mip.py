"""Writes what MicroPython's package installer, ``mip``, needs to install uros on a board.

Three forms:

- ``package.json`` in the root of this project lists the client as text, for
  ``mip install github:OWNER/uros``; ``package-all.json`` lists all modules that a board may have.
- `write_index` writes an index: a folder that any web server can serve. It has the client
  (``uros``), each further module as its own package (``uros-parameters``), each message type
  (``std_msgs/msg/Int32``) and each package of types, as text and as bytecode. ``mip`` selects the
  form that the board's firmware reads.
- `write_manifest` lists the files of one program that `uros.boards.builder.file_system` built.

``python -m uros.boards.deploy.mip`` in a clone rewrites the first form, and ``manifest.py``. The
installers are micropython-lib's ``mip`` on a board and mpremote's ``mip`` on a host. Both accept
these forms, and both compare short hashes to skip files that are installed already.
"""

from __future__ import annotations

import ast
import hashlib
import itertools
import json
import os
from collections.abc import Callable, Container, Iterable, Mapping
from pathlib import Path
from typing import Final

import uros
from uros.interfaces import registry
from uros.interfaces.package import module_texts

from ..builder.compiler import bytecode
from ..builder.errors import BuildError
from ..builder.modules import Module, imports
from ..builder.passes.strip import strip
from ..builder.portable import SOURCE, portable_files
from . import frozen

CORE: Final = "uros"
MANIFEST: Final = "package.json"
MPY: Final = "6"
"""The bytecode version of MicroPython 1.27's mpy-cross."""

# Roots of the client package: a node on a serial line, and the runtime of generated types.
_CORE: Final = ("uros.client", "uros.transport.serial", "uros.interfaces.runtime")
_SHORT: Final = 8  # characters of a hash, as in micropython-lib's own index
_VERSIONS: Final = ("latest", uros.__version__)

Files = dict[str, bytes]


# --- selection of modules ---------------------------------------------------------------------


def portable() -> dict[str, Module]:
    """Return every module of uros that a board may have, by its name."""
    modules: dict[str, Module] = {}
    for file in portable_files():
        _add(modules, file)
    return modules


def _add(modules: dict[str, Module], file: Path) -> None:
    parts = file.relative_to(SOURCE.parent).with_suffix("").parts
    package = parts[-1] == "__init__"
    name = ".".join(parts[:-1] if package else parts)
    text = file.read_text("utf-8")
    modules[name] = Module(name, package, str(file), text, ast.parse(text))
    strip(modules[name])  # imports under TYPE_CHECKING must not count


def closure(
    roots: Iterable[str],
    modules: Mapping[str, Module],
    late: bool,
    but: Container[str] = frozenset(),
) -> tuple[set[str], set[str]]:
    """Return the modules that ``roots`` import, the roots included, and the interface types.

    Args:
        roots: Names of modules.
        modules: All modules that a board may have.
        late: Whether imports inside functions count.
        but: Names of modules to leave out, since they are installed already.
    """
    names: set[str] = set()
    types: set[str] = set()
    pending = list(roots)
    while pending:
        name = pending.pop()
        if name in names or name in but or name not in modules:
            continue
        names.add(name)
        pending.append(name.rpartition(".")[0])
        for wanted in imports(modules[name]):
            if wanted.late and not late:
                continue
            imported_names = [f"{wanted.module}.{name}" for name, _ in wanted.names or ()]
            pending += [wanted.module, *imported_names]
            types.update(_types(imported_names))
    return names, types


def _types(names: Iterable[str]) -> set[str]:
    """Return the interface types among dotted names such as ``std_msgs.msg.Int32``."""
    types = set()
    for name in names:
        parts = name.split(".")
        if len(parts) == 3 and parts[1] in registry.KINDS and registry.exists("/".join(parts)):
            types.add(registry.file_type("/".join(parts)))
    return types


def parts() -> dict[str, tuple[set[str], set[str]]]:
    """Return the modules and types of each package.

    The packages are the client, and one for each further module with its own imports that the
    client lacks.
    """
    modules = portable()
    core = closure(_CORE, modules, late=False)
    packages = {CORE: core}
    for name in modules:
        if name not in core[0] and not modules[name].package:
            package = f"uros-{name.rpartition('.')[2].replace('_', '-')}"
            packages[package] = closure([name], modules, late=True, but=core[0])
    return packages


# --- manifests of the project -------------------------------------------------------------------


def project_manifests() -> dict[str, str]:
    """Return the texts of ``package.json``, ``package-all.json`` and ``manifest.py``."""
    modules = portable()
    core, _ = closure(_CORE, modules, late=False)
    return {
        MANIFEST: _urls(core, modules),
        "package-all.json": _urls(modules, modules),
        frozen.MANIFEST: frozen.project_manifest(
            module.path + ".py" for module in modules.values()
        ),
    }


def _urls(names: Iterable[str], modules: Mapping[str, Module]) -> str:
    paths = sorted(modules[name].path + ".py" for name in names)
    rows = ",\n".join(f'    ["{path}", "src/{path}"]' for path in paths)
    return f'{{\n  "version": "{uros.__version__}",\n  "urls": [\n{rows}\n  ]\n}}\n'


# --- an index -----------------------------------------------------------------------------------


def write_index(
    out: str | os.PathLike[str],
    forms: Iterable[str] = ("py", "mpy"),
    interfaces: Iterable[str] | None = None,
    progress: Callable[[int, int], object] = lambda done, total: None,
) -> list[str]:
    """Write an index for ``mip install --index``; return the names of its packages.

    Args:
        out: Folder to write to.
        forms: ``"py"`` for text, ``"mpy"`` for bytecode.
        interfaces: Interface types to include, by default all known types.
        progress: Called before each package with the number of those that are written, and of all.

    Raises:
        BuildError: mpy-cross is not installed, or a form is unknown.
        OSError: A file cannot be written.
    """
    root = Path(out)
    modules = portable()
    contents = parts()
    names = list(contents)
    all_types = registry.list_types() if interfaces is None else interfaces
    types = {name: {name} for name in all_types}
    for name in sorted(types):
        types.setdefault(name.partition("/")[0], set()).add(name)
    texts = {name: ast.unparse(module.tree) + "\n" for name, module in modules.items()}

    def files(own: Iterable[str], needed_types: Iterable[str]) -> dict[str, str]:
        texts_by_path = module_texts(sorted(needed_types))
        imported = closure(_imported(texts_by_path), modules, late=True, but=contents[CORE][0])[0]
        texts_by_path.update(
            (modules[module].path + ".py", texts[module]) for module in {*own, *imported}
        )
        return texts_by_path

    stores = [_Store(root, form) for form in forms]
    total = len(stores) * (len(contents) + len(types))
    count = itertools.count()
    for store in stores:
        for name, (own, needed) in contents.items():
            progress(next(count), total)
            store.package(name, files(own, needed), [] if name == CORE else [[CORE, "latest"]])
        for name, needed_types in types.items():
            progress(next(count), total)
            store.package(name, files((), needed_types), [])
    return sorted([*names, *types])


def _imported(texts: Mapping[str, str]) -> set[str]:
    """Return the names that generated modules import."""
    names = set()
    for path, text in texts.items():
        module = Module(path[:-3].replace("/", "."), False, path, text, ast.parse(text))
        for wanted in imports(module):
            names.add(wanted.module)
            names.update(f"{wanted.module}.{name}" for name, _ in wanted.names or ())
    return names


class _Store:
    """Writes the packages of one form into an index."""

    def __init__(self, root: Path, form: str) -> None:
        if form not in ("py", "mpy"):
            raise BuildError(f"no form {form!r}; give 'py' or 'mpy'")
        self._root = root
        self._mpy = form == "mpy"
        self._known: dict[tuple[str, str], tuple[str, str]] = {}  # path, text: path, hash

    def package(self, name: str, texts: Mapping[str, str], deps: list[list[str]]) -> None:
        """Write a package's files and manifests; ``deps`` are pairs of package and version."""
        hashes = [list(self._file(path, text)) for path, text in sorted(texts.items())]
        folder = self._root / "package" / (MPY if self._mpy else "py") / name
        folder.mkdir(parents=True, exist_ok=True)
        for version in _VERSIONS:
            manifest = {"v": 1, "version": uros.__version__, "hashes": hashes, "deps": deps}
            (folder / f"{version}.json").write_text(json.dumps(manifest), encoding="utf-8")

    def _file(self, path: str, text: str) -> tuple[str, str]:
        """Store a file once, by its hash; return its path on the board and the hash."""
        if (path, text) not in self._known:
            data = text.encode()
            installed_path = path
            if self._mpy:
                installed_path = path[:-3] + ".mpy"
                data = bytecode(text, path, path)
            short = hashlib.sha256(data).hexdigest()[:_SHORT]
            target = self._root / "file" / short[:2] / short
            target.parent.mkdir(parents=True, exist_ok=True)
            target.write_bytes(data)
            self._known[path, text] = installed_path, short
        return self._known[path, text]


# --- manifest of a program ----------------------------------------------------------------------


def write_manifest(folder: str | os.PathLike[str], files: Iterable[Path]) -> Path:
    """Write ``package.json`` into a program's build folder; return the manifest's path."""
    root = Path(folder)
    paths = sorted(file.relative_to(root).as_posix() for file in files)
    manifest = {"version": uros.__version__, "urls": [[path, path] for path in paths]}
    path = root / MANIFEST
    path.write_text(json.dumps(manifest, indent=1) + "\n", encoding="utf-8")
    return path


if __name__ == "__main__":
    for manifest_name, manifest_text in project_manifests().items():
        (SOURCE.parents[1] / manifest_name).write_text(manifest_text, encoding="utf-8")
