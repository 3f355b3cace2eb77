"""Finds what a program imports: its own modules, modules of uros, and interface types."""

from __future__ import annotations

import ast
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Final

from uros import moved
from uros.interfaces import InterfaceError, package, registry
from uros.similar import closest

from . import secrets_file
from .errors import BuildError, MissingModule, SourceError
from .modules import ABSENT, Module, Wanted, imports
from .passes.strip import strip
from .portable import FOLDERS, MODULES, SOURCE, is_portable
from .scopes import bound, walk

# The modules of MicroPython 1.27 and its ports, and those that micropython-lib adds.
_PROVIDED: Final = {
    "_thread", "aioble", "array", "asyncio", "binascii", "bluetooth", "btree", "builtins",
    "camera", "cmath", "collections", "cryptolib", "deflate", "dht", "ds18x20", "errno", "esp",
    "esp32", "espnow", "framebuf", "gc", "hashlib", "heapq", "io", "jffi", "js", "json",
    "jsffi", "lcd160cr", "lwip", "machine", "marshal", "math", "micropython", "mimxrt", "mip",
    "neopixel", "network", "ntptime", "onewire", "openamp", "os", "platform", "pyb", "random",
    "re", "renesas", "requests", "rp2", "samd", "select", "socket", "ssl", "stm", "struct",
    "sys", "time", "tls", "uarray", "uasyncio", "ubinascii", "ucollections", "uctypes",
    "uerrno", "uhashlib", "uheapq", "uio", "ujson", "umachine", "uos", "upysh", "urandom",
    "ure", "urequests", "uselect", "usb", "usocket", "ussl", "ustruct", "usys", "utime",
    "uzlib", "vfs", "webrepl", "websocket", "wipy", "zephyr", "zlib", "zsensor",
}  # fmt: skip
_DEFINING: Final = (ast.FunctionDef, ast.AsyncFunctionDef, ast.ClassDef, ast.Assign, ast.AnnAssign)


def program_files(program: Path) -> Iterator[tuple[Path, Path]]:
    """Yield the files of a program that go to the board, sorted: path in the folder, and path."""
    for file in sorted(program.rglob("*")):
        relative_path = file.relative_to(program)
        if any(part.startswith((".", "__pycache__")) for part in relative_path.parts):
            continue
        if relative_path.parts[0] in (secrets_file.TESTS, secrets_file.FILE):
            continue
        if file.suffix == ".py" or (file.is_file() and file.suffix != ".md"):
            yield relative_path, file


class Resolver:
    """Finds and parses all modules that a program needs.

    Args:
        program: The program's folder.
        provided: Names of further modules that the board has, beside those of MicroPython.
        terse: Whether interface modules are generated without error texts (pass ``terse-errors``).
        checked: Whether messages refuse attributes that are not fields; switches ``terse`` off.
    """

    def __init__(self, program: Path, provided: set[str], terse: bool, checked: bool) -> None:
        self.program = program
        self.terse = terse and not checked
        self.checked = checked
        self.provided = _PROVIDED | {secrets_file.MODULE} | provided
        self.modules: dict[str, Module] = {}
        self.types: dict[str, Module] = {}  # names of types, and the first module that imports each
        self.data_files: dict[str, bytes] = {}  # the program's files that are not Python
        self.top_names: set[str] = set()  # top-level names of the program's modules and packages

    def run(self, roots: Iterable[str]) -> dict[str, Module]:
        """Return all modules that the program and ``roots`` need, by full name.

        Args:
            roots: Modules (``uros.wire.session``) or names in them (``module:name``) to add.

        Raises:
            SourceError: The folder, or a Python file in it, is missing; or a file is not Python.
            MissingModule: An import cannot be resolved.
            BuildError: The modules of the interface types cannot be generated.
        """
        if not self.program.is_dir():
            raise SourceError(f"{self.program}: no such folder; give the folder of a main.py")
        for relative_path, file in program_files(self.program):
            if file.suffix == ".py":
                self.parse_program_file(file, relative_path)
            else:
                self.data_files[relative_path.as_posix()] = file.read_bytes()
        if not self.modules:
            raise SourceError(f"{self.program}: no Python file in it; give the folder of a main.py")
        for module in list(self.modules.values()):
            self.resolve_imports(module)
        importer = Module("", False, "roots", "", ast.Module([], []))
        for root in roots:
            name, _, attribute = root.partition(":")
            names = ((attribute, attribute),) if attribute else None
            self.resolve_import(Wanted(name, names, 0, False, False), importer)
        self.generate_interfaces()
        return self.modules

    def parse_program_file(self, file: Path, relative_path: Path) -> None:
        """Parse a file of the program; ``relative_path`` is its path below the program's folder."""
        is_package = relative_path.name == "__init__.py"
        parts = relative_path.parent.parts if is_package else relative_path.with_suffix("").parts
        name = ".".join(parts)
        self.modules[name] = _parse(name, is_package, str(file), _read(file), own=True)
        self.top_names.add(parts[0] if parts else "")

    def resolve_imports(self, module: Module) -> None:
        """Resolve every import of a module."""
        for wanted in imports(module):
            self.resolve_import(wanted, module)

    def resolve_import(self, wanted: Wanted, importer: Module) -> None:
        """Resolve one import of ``importer``; raise MissingModule if nothing provides it."""
        name = wanted.module
        top = name.partition(".")[0]
        if self.is_own(name):
            return
        if top == "uros":
            self.resolve_uros_import(wanted, importer)
        elif top in self.provided or name in self.provided:
            return
        elif registry.has_package(top):
            self.resolve_interface_import(wanted, importer)
        elif not wanted.optional:
            raise MissingModule(f"{_location(importer, wanted)}: {self.advice(name)}")

    def is_own(self, name: str) -> bool:
        """Whether a module or package is the program's own."""
        top = name.partition(".")[0]
        if top not in self.top_names or top == "uros":
            return False
        # MicroPython, too, accepts a folder without __init__.py as a package.
        return name in self.modules or any(other.startswith(name + ".") for other in self.modules)

    def advice(self, name: str) -> str:
        """Return the error text for a module that nothing provides: the fault and its remedy."""
        top, _, rest = name.partition(".")
        if name in ABSENT or top in ABSENT:
            return (
                f"MicroPython has no {name}; import it in a try with except ImportError, or put a"
                " module of that name into the program's folder"
            )
        if top.endswith(("_msgs", "_srvs", "_interfaces")) or rest in registry.KINDS:
            close = _did_you_mean(top, registry.packages(), 0.8)
            own = f"{close} If it is your own," if close else ";"
            return (
                f"no definitions of a package {top}{own} give the folder of its .msg files by"
                " --interfaces DIR"
            )
        return (
            f"no module {name}; put it into the program's folder, or if the board brings it, name"
            f" it as provided (--provided {top})"
        )

    # Modules of uros

    def resolve_uros_import(self, wanted: Wanted, importer: Module) -> None:
        """Add the modules of uros that one import needs.

        An import in a function (``late``) of a module of uros may name a module for hosts: the
        board does not get that module, and the build goes on.

        Raises:
            MissingModule: The module does not exist, has moved or is for hosts.
        """
        full_names = [f"{wanted.module}.{name}" for name, _ in wanted.names or ()]
        if wanted.module == "uros" and full_names:
            names = full_names  # boards do not get uros/__init__.py, which is for hosts
        else:
            names = [wanted.module, *filter(self.uros_file, full_names)]
        for name in names:
            file = self.uros_file(name)
            if file and is_portable(name):
                self.add_uros_module(name, file)
            elif not wanted.optional and (importer.own or not importer.name or not wanted.late):
                hint = "" if file else self.module_hint(name)
                text = _moved_advice(name) or _uros_advice(name, bool(file)) + hint
                raise MissingModule(f"{_location(importer, wanted)}: {text}")
        if not wanted.optional and (importer.own or not importer.name):
            self.check_uros_names(wanted, importer)

    def check_uros_names(self, wanted: Wanted, importer: Module) -> None:
        """Raise MissingModule if the program imports a name that its module never binds.

        Otherwise `tree_shake` would drop such a module, since nothing uses it.
        """
        module = self.modules.get(wanted.module)
        if module is None:
            return
        names = _bound_names(module)
        if names & {"*", "__getattr__"}:
            return
        for name, _ in wanted.names or ():
            if name in names or name == "*" or (name[:2] == name[-2:] == "__"):
                continue
            if self.uros_file(f"{wanted.module}.{name}"):
                continue
            if wanted.line in _type_checking_lines(importer):
                continue
            text = _moved_advice(f"{wanted.module}.{name}")
            text = text or f"{wanted.module} has no {name}" + self.name_hint(module, name, names)
            raise MissingModule(f"{_location(importer, wanted)}: {text}")

    def name_hint(self, module: Module, name: str, names: set[str]) -> str:
        """Return a hint for a name that a module lacks: a submodule with it, or close names."""
        submodules = self.uros_submodules(module.name) if module.package else []
        for submodule in submodules:
            file = self.uros_file(f"{module.name}.{submodule}")
            body = _parse("", False, str(file), _read(file)).tree.body if file else []
            if name in bound(node for node in body if isinstance(node, _DEFINING)):
                return f"; write from {module.name}.{submodule} import {name}"
        public = {public_name for public_name in names if not public_name.startswith("_")}
        return _did_you_mean(name, public.union(submodules))

    def module_hint(self, name: str) -> str:
        """Return close names for the first part of a module's dotted name that does not exist."""
        parts = name.split(".")
        for length in range(2, len(parts) + 1):
            parent = ".".join(parts[: length - 1])
            if not self.uros_file(".".join(parts[:length])):
                return _did_you_mean(parts[length - 1], self.uros_submodules(parent))
        return ""

    def uros_submodules(self, package: str) -> list[str]:
        """Return the names of the modules of a package that boards may have."""
        folder = SOURCE.joinpath(*package.split(".")[1:])
        names = sorted({file.stem if file.is_file() else file.name for file in folder.glob("*")})
        return [
            name
            for name in names
            if self.uros_file(f"{package}.{name}") and is_portable(f"{package}.{name}")
        ]

    def uros_file(self, name: str) -> Path | None:
        """Return the file of a module of uros; None if there is no such module."""
        base = SOURCE.joinpath(*name.split(".")[1:])
        for file in (base.with_suffix(".py"), base / "__init__.py"):
            if file.is_file():
                return file
        return None

    def add_uros_module(self, name: str, file: Path) -> None:
        """Add a module of uros, its parent packages, and what they import."""
        parent = name.rpartition(".")[0]
        parent_file = self.uros_file(parent)
        if parent != "uros" and parent_file:
            self.add_uros_module(parent, parent_file)
        if name not in self.modules:
            module = _parse(name, file.name == "__init__.py", str(file), _read(file))
            strip(module)
            self.modules[name] = module
            self.resolve_imports(module)

    # Modules of interfaces

    def resolve_interface_import(self, wanted: Wanted, importer: Module) -> None:
        """Note the interface types that one import needs; raise MissingModule if one is unknown."""
        parts = wanted.module.split(".")
        kinds = [parts[1]] if len(parts) > 1 else [n for n, _ in wanted.names or ()]
        for kind in kinds:
            if len(parts) > 2 or kind not in registry.KINDS:
                raise MissingModule(
                    f"{_location(importer, wanted)}: {wanted.module} has no {kind} for boards;"
                    f" write from {parts[0]}.msg import Name"
                )
        if len(parts) == 2 and wanted.names is not None:
            for name, _ in wanted.names:
                full = "/".join((*parts, name))
                if name == "*" or not registry.exists(full):
                    raise MissingModule(
                        f"{_location(importer, wanted)}: "
                        + ("name the types to import" if name == "*" else f"no type {full}")
                        + _did_you_mean(name, registry.names_in(parts[0], parts[1]))
                    )
                self.types.setdefault(registry.file_type(full), importer)
            return
        # The import binds the module itself, so its types that are named as attributes are needed.
        attributes = {n.attr for n in walk(importer.tree) if isinstance(n, ast.Attribute)}
        for kind in kinds:
            for name in attributes.intersection(registry.names_in(parts[0], kind)):
                self.types.setdefault(f"{parts[0]}/{kind}/{name}", importer)

    def uses_unpack_into(self) -> bool:
        """Whether any module deserializes into an existing message (``unpack_into``)."""
        return any(
            isinstance(node, ast.Attribute) and node.attr == "unpack_into"
            for name, module in self.modules.items()
            if not name.startswith("uros.interfaces.")
            for node in walk(module.tree)
        )

    def generate_interfaces(self) -> None:
        """Generate the modules of the noted types; raise BuildError if that fails."""
        try:
            sources = package.modules(
                sorted(self.types), self.terse, self.uses_unpack_into(), self.checked
            )
        except InterfaceError as error:
            raise BuildError(str(error)) from error
        for name, text in sources.items():
            module = _parse(name, False, f"<{name}>", text)
            strip(module)
            self.modules[name] = module
        for name in sources:
            self.resolve_imports(self.modules[name])


def _did_you_mean(name: str, known: Iterable[str], alike: float = 0.6) -> str:
    close = closest(name, sorted(known), alike)
    return f"; did you mean {' or '.join(close)}?" if close else ""


def _bound_names(module: Module) -> set[str]:
    """Return all names that a module may bind, conditional bindings included."""
    names = set(bound(module.tree.body))
    for node in walk(module.tree):
        if isinstance(node, ast.Global):
            names.update(node.names)
    return names


def _type_checking_lines(module: Module) -> set[int]:
    """Return the lines of imports under ``if TYPE_CHECKING:``, which never run on a board."""
    return {
        inner.lineno
        for node in walk(module.tree)
        if isinstance(node, ast.If)
        and ast.unparse(node.test) in ("TYPE_CHECKING", "typing.TYPE_CHECKING")
        for statement in node.body
        for inner in walk(statement)
        if isinstance(inner, ast.ImportFrom)
    }


def _moved_advice(name: str) -> str:
    """Return the advice for a name of uros that has moved; "" if it has not."""
    text = moved.advice(name)
    return text + ("" if not text or is_portable(text.split()[-1]) else ", which is for hosts")


def _uros_advice(name: str, exists: bool) -> str:
    if name in ("uros", "uros.Node"):
        return "uros itself is for hosts; on a board, write from uros.client import Node"
    if exists:
        portable = ", ".join(f"uros.{module}" for module in (*FOLDERS, *MODULES))
        return f"{name} is for hosts, boards have {portable}"
    parts = name.split(".")
    if len(parts) > 2 and parts[1] == "interfaces" and registry.has_package(parts[2]):
        return f"on a board, types are imported from {'.'.join(parts[2:])}"
    return f"uros has no module {name}"


def _location(importer: Module, wanted: Wanted) -> str:
    return f"{importer.source}:{wanted.line}" if wanted.line else importer.source


def _read(file: Path) -> str:
    try:
        return file.read_text(encoding="utf-8")
    except UnicodeDecodeError as error:
        raise SourceError(f"{file}: not UTF-8 text ({error}); save it as UTF-8") from error


def _parse(name: str, is_package: bool, source: str, text: str, own: bool = False) -> Module:
    try:
        tree = ast.parse(text, source)
    except SyntaxError as error:
        line = error.lineno or 1
        source_line = (error.text or "").strip() or "this is no Python"
        raise SourceError(f"{source}:{line}: {error.msg}: {source_line}") from error
    except ValueError as error:  # null bytes, before Python 3.12
        raise SourceError(f"{source}:1: {error}: this is no Python") from error
    return Module(name, is_package, source, text, tree, own)
