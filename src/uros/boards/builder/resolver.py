"""Finds what a program imports: its own modules, modules of uros, and interface types."""

from __future__ import annotations

import ast
import difflib
from collections.abc import Iterable
from pathlib import Path
from typing import Final

from uros import moved
from uros.interfaces import InterfaceError, package, registry

from .errors import BuildError, MissingModule, SourceError
from .modules import ABSENT, Module, Wanted, imports
from .passes.strip import strip
from .portable import FOLDERS, MODULES, SOURCE, is_portable
from .scopes import bound

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


class Resolver:
    """Finds and parses all modules that a program needs.

    Args:
        program: The program's folder.
        provided: Names of further modules that the board has, beside those of MicroPython.
        lean: Whether interface modules are generated without error texts (pass ``terse-errors``).
        checked: Whether messages refuse attributes that are no fields; switches ``lean`` off.
    """

    def __init__(self, program: Path, provided: set[str], lean: bool, checked: bool) -> None:
        self.program = program
        self.lean = lean and not checked
        self.checked = checked
        self.provided = _PROVIDED | provided
        self.modules: dict[str, Module] = {}
        self.types: dict[str, Module] = {}  # names of types, and the first module that imports each
        self.other: dict[str, bytes] = {}  # the program's files that are not Python
        self.tops: set[str] = set()  # top-level names of the program's modules and packages

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
        for file in sorted(self.program.rglob("*")):
            inside = file.relative_to(self.program)
            if any(part.startswith((".", "__pycache__")) for part in inside.parts):
                continue
            if file.suffix == ".py":
                self.own(file, inside)
            elif file.is_file() and file.suffix != ".md":
                self.other[inside.as_posix()] = file.read_bytes()
        if not self.modules:
            raise SourceError(f"{self.program}: no Python file in it; give the folder of a main.py")
        for module in list(self.modules.values()):
            self.follow(module)
        start = Module("", False, "roots", "", ast.Module([], []))
        for root in roots:
            name, _, attribute = root.partition(":")
            names = ((attribute, attribute),) if attribute else None
            self.need(Wanted(name, names, 0, False, False), start)
        self.interfaces()
        return self.modules

    def own(self, file: Path, inside: Path) -> None:
        """Parse a file of the program; ``inside`` is its path below the program's folder."""
        is_package = inside.name == "__init__.py"
        parts = inside.parent.parts if is_package else inside.with_suffix("").parts
        name = ".".join(parts)
        self.modules[name] = _parse(name, is_package, str(file), _read(file), own=True)
        self.tops.add(parts[0] if parts else "")

    def follow(self, module: Module) -> None:
        """Resolve every import of a module."""
        for wanted in imports(module):
            self.need(wanted, module)

    def need(self, wanted: Wanted, by: Module) -> None:
        """Resolve one import of the module ``by``; raise MissingModule if nothing provides it."""
        name = wanted.module
        top = name.partition(".")[0]
        if self.is_own(name):
            return
        if top == "uros":
            self.uros(wanted, by)
        elif top in self.provided or name in self.provided:
            return
        elif registry.has_package(top):
            self.interface(wanted, by)
        elif not wanted.optional:
            raise MissingModule(f"{_place(by, wanted)}: {self.advice(name)}")

    def is_own(self, name: str) -> bool:
        """Whether a module or package is the program's own."""
        top = name.partition(".")[0]
        if top not in self.tops or top == "uros":
            return False
        # On MicroPython, too, a folder without __init__.py is a package.
        return name in self.modules or any(m.startswith(name + ".") for m in self.modules)

    def advice(self, name: str) -> str:
        """The error text for a module that nothing provides: the fault and its remedy."""
        top = name.partition(".")[0]
        if name in ABSENT or top in ABSENT:
            return (
                f"MicroPython has no {name}; import it in a try with except ImportError, or put a"
                " module of that name into the program's folder"
            )
        if top.endswith(("_msgs", "_srvs", "_interfaces")):
            return (
                f"no definitions of a package {top}; give the folder of its .msg files by"
                " --interfaces DIR"
            )
        return (
            f"no module {name}; put it into the program's folder, or if the board brings it, name"
            f" it as provided (--provided {top})"
        )

    # Modules of uros

    def uros(self, wanted: Wanted, by: Module) -> None:
        """Add the modules of uros that one import needs.

        An import in a function (``late``) of a module of uros may name a module for hosts: the
        board does not get that module, and the build goes on.

        Raises:
            MissingModule: The module does not exist, has moved or is for hosts.
        """
        inside = [f"{wanted.module}.{name}" for name, _ in wanted.names or ()]
        if wanted.module == "uros" and inside:
            names = inside  # boards do not get uros/__init__.py: all it holds is for hosts
        else:
            names = [wanted.module, *filter(self.uros_file, inside)]
        for name in names:
            file = self.uros_file(name)
            if file and is_portable(name):
                self.uros_module(name, file)
            elif not wanted.optional and (by.own or not by.name or not wanted.late):
                hint = "" if file else self.module_hint(name)
                text = _new_name(name) or _uros_advice(name, bool(file)) + hint
                raise MissingModule(f"{_place(by, wanted)}: {text}")
        if not wanted.optional and (by.own or not by.name):
            self.uros_names(wanted, by)

    def uros_names(self, wanted: Wanted, by: Module) -> None:
        """Raise MissingModule where the program imports a name that its module never binds.

        `tree_shake` would drop such a module, since nothing uses it.
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
            if self.uros_file(f"{wanted.module}.{name}") or wanted.line in _lines_for_checkers(by):
                continue
            text = _new_name(f"{wanted.module}.{name}")
            text = text or f"{wanted.module} has no {name}" + self.name_hint(module, name, names)
            raise MissingModule(f"{_place(by, wanted)}: {text}")

    def name_hint(self, module: Module, name: str, names: set[str]) -> str:
        """A hint for a name that a module lacks: the submodule that has it, or close names."""
        children = self.uros_children(module.name) if module.package else []
        for child in children:
            file = self.uros_file(f"{module.name}.{child}")
            body = _parse("", False, str(file), _read(file)).tree.body if file else []
            if name in bound(node for node in body if isinstance(node, _DEFINING)):
                return f"; write from {module.name}.{child} import {name}"
        return _did_you_mean(name, {n for n in names if not n.startswith("_")}.union(children))

    def module_hint(self, name: str) -> str:
        """Close names for the first part of a module's dotted name that does not exist."""
        parts = name.split(".")
        for length in range(2, len(parts) + 1):
            parent = ".".join(parts[: length - 1])
            if not self.uros_file(".".join(parts[:length])):
                return _did_you_mean(parts[length - 1], self.uros_children(parent))
        return ""

    def uros_children(self, package: str) -> list[str]:
        """The modules of a package that boards may have."""
        folder = SOURCE.joinpath(*package.split(".")[1:])
        names = sorted({file.stem if file.is_file() else file.name for file in folder.glob("*")})
        full = {name: f"{package}.{name}" for name in names}
        return [n for n in names if self.uros_file(full[n]) and is_portable(full[n])]

    def uros_file(self, name: str) -> Path | None:
        """The file of a module of uros; None if there is no such module."""
        base = SOURCE.joinpath(*name.split(".")[1:])
        for file in (base.with_suffix(".py"), base / "__init__.py"):
            if file.is_file():
                return file
        return None

    def uros_module(self, name: str, file: Path) -> None:
        """Add a module of uros, its parent packages, and what they import."""
        parent = name.rpartition(".")[0]
        parent_file = self.uros_file(parent)
        if parent != "uros" and parent_file:
            self.uros_module(parent, parent_file)
        if name not in self.modules:
            module = _parse(name, file.name == "__init__.py", str(file), _read(file))
            strip(module)
            self.modules[name] = module
            self.follow(module)

    # Modules of interfaces

    def interface(self, wanted: Wanted, by: Module) -> None:
        """Note the interface types that one import needs; raise MissingModule if one is unknown."""
        parts = wanted.module.split(".")
        kinds = [parts[1]] if len(parts) > 1 else [n for n, _ in wanted.names or ()]
        for kind in kinds:
            if len(parts) > 2 or kind not in registry.KINDS:
                raise MissingModule(
                    f"{_place(by, wanted)}: {wanted.module} has no {kind} for boards; write"
                    f" from {parts[0]}.msg import Name"
                )
        if len(parts) == 2 and wanted.names is not None:
            for name, _ in wanted.names:
                full = "/".join((*parts, name))
                if name == "*" or not registry.exists(full):
                    raise MissingModule(
                        f"{_place(by, wanted)}: "
                        + ("name the types to import" if name == "*" else f"no type {full}")
                        + _did_you_mean(name, registry.names_in(parts[0], parts[1]))
                    )
                self.types.setdefault(registry.file_type(full), by)
            return
        # The import binds the module itself: its types that are named as attributes are needed.
        attributes = {n.attr for n in ast.walk(by.tree) if isinstance(n, ast.Attribute)}
        for kind in kinds:
            for name in attributes.intersection(registry.names_in(parts[0], kind)):
                self.types.setdefault(f"{parts[0]}/{kind}/{name}", by)

    def reuses(self) -> bool:
        """Whether any module deserializes into an existing message (``unpack_into``)."""
        return any(
            isinstance(node, ast.Attribute) and node.attr == "unpack_into"
            for name, module in self.modules.items()
            if not name.startswith("uros.interfaces.")
            for node in ast.walk(module.tree)
        )

    def interfaces(self) -> None:
        """Generate the modules of the noted types; raise BuildError if that fails."""
        try:
            sources = package.modules(sorted(self.types), self.lean, self.reuses(), self.checked)
        except InterfaceError as error:
            raise BuildError(str(error)) from error
        for name, text in sources.items():
            module = _parse(name, False, f"<{name}>", text)
            strip(module)
            self.modules[name] = module
        for name in sources:
            self.follow(self.modules[name])


def _did_you_mean(name: str, known: Iterable[str]) -> str:
    close = difflib.get_close_matches(name, sorted(known), 3, 0.6)
    return f"; did you mean {' or '.join(close)}?" if close else ""


def _bound_names(module: Module) -> set[str]:
    """All names that a module may bind, conditional bindings included."""
    names = set(bound(module.tree.body))
    for node in ast.walk(module.tree):
        if isinstance(node, ast.Global):
            names.update(node.names)
    return names


def _lines_for_checkers(module: Module) -> set[int]:
    """The lines of imports under ``if TYPE_CHECKING:``, which never run on a board."""
    return {
        inner.lineno
        for node in ast.walk(module.tree)
        if isinstance(node, ast.If)
        and ast.unparse(node.test) in ("TYPE_CHECKING", "typing.TYPE_CHECKING")
        for statement in node.body
        for inner in ast.walk(statement)
        if isinstance(inner, ast.ImportFrom)
    }


def _new_name(name: str) -> str:
    """The advice for a name of uros that has moved; "" if it has not."""
    text = moved.advice(name)
    return text + ("" if not text or is_portable(text.split()[-1]) else ", which is for hosts")


def _uros_advice(name: str, exists: bool) -> str:
    if name in ("uros", "uros.Node"):
        return "uros itself is for hosts; on a board, write from uros.client import Node"
    if exists:
        have = ", ".join(f"uros.{it}" for it in (*FOLDERS, *MODULES))
        return f"{name} is for hosts, boards have {have}"
    parts = name.split(".")
    if len(parts) > 2 and parts[1] == "interfaces" and registry.has_package(parts[2]):
        return f"on a board, types are imported from {'.'.join(parts[2:])}"
    return f"uros has no module {name}"


def _place(by: Module, wanted: Wanted) -> str:
    return f"{by.source}:{wanted.line}" if wanted.line else by.source


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
        words = (error.text or "").strip() or "this is no Python"
        raise SourceError(f"{source}:{line}: {error.msg}: {words}") from error
    except ValueError as error:  # null bytes, before Python 3.12
        raise SourceError(f"{source}:1: {error}: this is no Python") from error
    return Module(name, is_package, source, text, tree, own)
