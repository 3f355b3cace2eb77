"""Runs a board's program on CPython, in the process of the virtual hardware.

The program can import what it could on a board and nothing else: modules of the board's file
system, the shims, and the modules of CPython that MicroPython has too. Its modules are in a table
of their own and not in ``sys.modules``, so that the program uses the board's ``time`` while the
host keeps its own, and that a reset discards all of them. Annotations are not evaluated, and
tracebacks have MicroPython's format.
"""

from __future__ import annotations
import __future__

import builtins
import errno
import gc
import importlib
import struct
import sys
from array import array
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from types import CodeType, ModuleType, SimpleNamespace, TracebackType
from typing import Any, Final

from .syscalls import BoardHost, Reset

SHIMS: Final = Path(__file__).resolve().parents[1] / "shims"

# The folder of built-in modules in tracebacks.
_SHIMS_ON_BOARD: Final = "/shims/"

# Modules of CPython that are used in place of MicroPython's.
_NATIVE: Final = frozenset(
    """array asyncio binascii cmath collections errno hashlib heapq io json math os platform random
    re zlib""".split()
)  # fmt: skip


def run(root: Path, host: BoardHost) -> None:
    """Run ``main.py`` of a board's file system, and report its end to the host.

    Raises:
        Reset: The program asked for a reset.
    """
    board = _Modules(root, host)
    traceback = ""
    try:
        board.run_main()
    except Reset:
        raise
    except SystemExit:
        raise Reset from None  # a board resets at SystemExit, too
    except BaseException as error:
        traceback = board.format_exception(error)
    host.ended(traceback)


def run_core(root: Path, host: BoardHost, name: str) -> None:
    """Run a module of a board's file system on its second core.

    An error ends it and is reported to the host.

    Raises:
        Reset: A reset ended it.
    """
    board = _Modules(root, host)
    try:
        board.run_core(name)
    except Reset:
        raise
    except BaseException as error:
        host.ended(board.format_exception(error))


class _Modules:
    """The modules and built-in functions of one run of a program."""

    def __init__(self, root: Path, host: BoardHost) -> None:
        self._root = root
        self._host = host
        self._files: set[str] = set()  # their names in tracebacks
        self.modules: dict[str, ModuleType] = {}
        self._builtins = dict(vars(builtins))
        self._builtins["__import__"] = self._import
        self._builtins["print"] = self._print
        built_in = {"_host": self._host_module(), "micropython": _micropython(), "gc": _gc()}
        built_in["struct"] = _struct()
        self._built_in: Mapping[str, ModuleType] = {**built_in, "sys": self._sys()}

    def run_main(self) -> None:
        file = self._root / "main.py"
        module = ModuleType("__main__")
        self.modules["__main__"] = module
        self._execute(module, file, "main.py")

    def run_core(self, name: str) -> None:
        core: Any = self._load(name)
        mail: Any = self._load("second_core")
        core.start(mail.Mailbox(mail.TO_SECOND), mail.Mailbox(mail.TO_FIRST))
        while True:
            core.step()

    # --- import ----------------------------------------------------------------------

    def _import(
        self,
        name: str,
        globals: Mapping[str, Any] | None = None,
        locals: Mapping[str, Any] | None = None,
        fromlist: Sequence[str] | None = (),
        level: int = 0,
    ) -> ModuleType:
        """Carry out an ``import`` statement of the firmware."""
        if level:
            package = (globals or {}).get("__package__") or ""
            parts = package.split(".")
            if not package or level > len(parts):
                raise ImportError("can't perform relative import")
            base = parts[: len(parts) - level + 1]
            name = ".".join([*base, name] if name else base)
        module = self._load(name)
        if not fromlist:
            return module if level else self.modules[name.partition(".")[0]]
        if hasattr(module, "__path__"):
            for attribute in fromlist:
                if attribute != "*" and not hasattr(module, attribute):
                    try:
                        self._load(f"{name}.{attribute}")
                    except ImportError as error:
                        if error.name != f"{name}.{attribute}":
                            raise
        return module

    def _load(self, name: str) -> ModuleType:
        """Return the module of an absolute name; its packages are loaded first."""
        if name in self.modules:
            return self.modules[name]
        parent, _, last = name.rpartition(".")
        if parent:
            package = self._load(parent)
            if name in self.modules:
                return self.modules[name]  # loaded by its package
        module = self._built_in.get(name)
        if module is None:
            module = self._from_files(name)
        else:
            self.modules[name] = module
        if parent:
            setattr(package, last, module)
        return module

    def _from_files(self, name: str) -> ModuleType:
        path = name.replace(".", "/")
        for folder, shown in ((SHIMS, _SHIMS_ON_BOARD), (self._root, "")):
            for stem, package in ((f"{path}/__init__.py", True), (f"{path}.py", False)):
                if (folder / stem).is_file():
                    return self._new(name, package, folder / stem, shown + stem)
            if (folder / path).is_dir():
                return self._new(name, True, None, f"{shown}{path}/")
        if name.partition(".")[0] in _NATIVE:
            module = importlib.import_module(name)
            self.modules[name] = module
            return module
        raise ImportError(f"no module named '{name}'", name=name)

    def _new(self, name: str, package: bool, file: Path | None, shown: str) -> ModuleType:
        """Load a new module from its file; ``file`` is None for a package without ``__init__``."""
        module = ModuleType(name)
        module.__file__ = shown
        module.__package__ = name if package else name.rpartition(".")[0]
        if package:
            module.__path__ = [shown.rpartition("/")[0]]
        self.modules[name] = module
        try:
            if file is not None:
                self._execute(module, file, shown)
        except BaseException:
            self.modules.pop(name, None)
            raise
        return module

    def _execute(self, module: ModuleType, file: Path, shown: str) -> None:
        self._files.add(shown)
        module.__dict__["__builtins__"] = self._builtins
        exec(_compile(file, shown), module.__dict__)

    # --- built-in modules and functions -----------------------------------------------

    def _host_module(self) -> ModuleType:
        def call(op: int, data: bytes = b"") -> bytes | int:
            try:
                return self._host.call(op, data)
            except OSError as error:
                # With MicroPython's text; the host's text is not passed to the program.
                number = error.errno or errno.EIO
                raise OSError(number, errno.errorcode.get(number, "")) from None

        module = ModuleType("_host")
        vars(module).update(call=call, number=call)
        return module

    def _print(self, *values: object, sep: str = " ", end: str = "\n", file: Any = None) -> None:
        text = sep.join(map(str, values)) + end
        if file is None:
            self._host.print(text)
        else:
            file.write(text)

    def _sys(self) -> ModuleType:
        module = ModuleType("sys")
        console = SimpleNamespace(write=self._write, flush=lambda: None)
        real = sys.implementation
        vars(module).update(
            argv=[], byteorder=sys.byteorder, exit=sys.exit, maxsize=(1 << 31) - 1,
            modules=self.modules, path=["", ".frozen", "/lib"], platform="virtual",
            print_exception=self._print_exception, stdout=console, stderr=console,
            version=sys.version, version_info=sys.version_info,
            # Programs and modules for boards read it to know what the interpreter has.
            implementation=SimpleNamespace(
                name="micropython", version=(1, 27, 0, ""), _machine=f"{real.name} {sys.platform}"
            ),
        )  # fmt: skip
        return module

    def _write(self, text: str) -> int:
        self._host.print(text)
        return len(text)

    def _print_exception(self, error: BaseException, file: Any = None) -> None:
        text = self.format_exception(error)
        if file is None:
            self._host.print(text)
        else:
            file.write(text)

    def format_exception(self, error: BaseException) -> str:
        """Return the traceback in MicroPython's format, without the frames of the host."""
        frames = []
        if isinstance(error, SyntaxError) and error.filename in self._files:
            frames.append(f'  File "{error.filename}", line {error.lineno}\n')
        trace: TracebackType | None = error.__traceback__
        position = 0
        while trace is not None:
            code = trace.tb_frame.f_code
            file = code.co_filename
            if file in self._files and not file.startswith(_SHIMS_ON_BOARD):
                frames.insert(
                    position, f'  File "{file}", line {trace.tb_lineno}, in {code.co_name}\n'
                )
                position += 1
            trace = trace.tb_next
        head = "Traceback (most recent call last):\n" if frames else ""
        return f"{head}{''.join(frames)}{type(error).__name__}: {_text(error)}\n"


def _struct() -> ModuleType:
    """Return MicroPython's ``struct``: ``s`` takes any buffer, and errors are ValueErrors."""

    def with_value_error(function: Callable[..., Any]) -> Callable[..., Any]:
        def wrapper(*values: Any) -> Any:
            try:
                return function(
                    *values[:2],
                    *[bytes(v) if isinstance(v, (array, memoryview)) else v for v in values[2:]],
                )
            except struct.error as error:
                raise ValueError(str(error)) from None

        return wrapper

    module = ModuleType("struct")
    vars(module).update(
        calcsize=struct.calcsize, pack_into=with_value_error(struct.pack_into),
        unpack=with_value_error(struct.unpack), unpack_from=with_value_error(struct.unpack_from),
        pack=with_value_error(lambda *values: struct.pack(
            *[bytes(v) if isinstance(v, (array, memoryview)) else v for v in values]
        )),
    )  # fmt: skip
    return module


def _text(error: BaseException) -> str:
    if isinstance(error, SyntaxError):
        return "invalid syntax"
    if isinstance(error, OSError):
        return _os_error(error)
    if len(error.args) == 1:
        return str(error.args[0])
    return str(error.args) if error.args else ""


def _os_error(error: OSError) -> str:
    if error.errno is None:
        number = error.args[0] if error.args else None
        if not isinstance(number, int):
            return str(error)
    else:
        number = error.errno
    return f"[Errno {number}] {errno.errorcode.get(number, '')}".rstrip()


_compiled: dict[Path, tuple[int, CodeType]] = {}


def _compile(file: Path, shown: str) -> CodeType:
    """Compile a file as MicroPython does: annotations are not evaluated.

    The code is cached, so a reset compiles nothing again.
    """
    changed = file.stat().st_mtime_ns
    known = _compiled.get(file)
    if known is None or known[0] != changed:
        flags = __future__.annotations.compiler_flag
        code = compile(file.read_bytes(), shown, "exec", flags, dont_inherit=True)
        _compiled[file] = known = (changed, code)
    return known[1]


def _micropython() -> ModuleType:
    module = ModuleType("micropython")

    def unchanged(value: Any) -> Any:
        return value

    def nothing(*_: Any) -> None:
        pass

    vars(module).update(
        const=unchanged, native=unchanged, viper=unchanged, mem_info=nothing, heap_lock=nothing,
        heap_unlock=nothing, opt_level=lambda *_: 0, stack_use=lambda: 0,
        alloc_emergency_exception_buf=nothing, kbd_intr=nothing, qstr_info=nothing,
    )  # fmt: skip
    return module


def _gc() -> ModuleType:
    """Return ``gc`` with CPython's collector; the use of the heap is unknown, which is -1."""
    module = ModuleType("gc")
    unknown: Callable[[], int] = lambda: -1  # noqa: E731
    vars(module).update(
        collect=gc.collect, enable=gc.enable, disable=gc.disable, isenabled=gc.isenabled,
        mem_alloc=unknown, mem_free=unknown, threshold=lambda *_: -1,
    )  # fmt: skip
    return module
