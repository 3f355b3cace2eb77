"""Runs a board's program on CPython, next to the virtual hardware.

The program gets what it would have on a board and nothing else: modules from the board's file
system, the shims, and those of CPython that MicroPython has too. Its modules live in a table of
their own and not in ``sys.modules``, so that it has the board's ``time`` while the host keeps its
own, and that a reset forgets all of them. Annotations are not evaluated, and tracebacks look as
MicroPython prints them.
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

# What tracebacks call the place of what is built in.
_SHIMS_ON_BOARD: Final = "/shims/"

# CPython's own that stand for MicroPython's.
_NATIVE: Final = frozenset(
    """array asyncio binascii cmath collections errno hashlib heapq io json math os platform random
    re zlib""".split()
)  # fmt: skip


def run(root: Path, host: BoardHost) -> None:
    """Run ``main.py`` of a board's file system until it ends, and report its end to the host.

    Raises Reset when the program asks for one.
    """
    board = _Modules(root, host)
    traceback = ""
    try:
        board.run_main()
    except Reset:
        raise
    except SystemExit:
        raise Reset from None  # what a board does
    except BaseException as error:
        traceback = board.format_exception(error)
    host.ended(traceback)


def run_core(root: Path, host: BoardHost, name: str) -> None:
    """Run a module of a board's file system on its second core, until Reset ends it, which is
    raised, or an error, which is reported to the host.
    """
    board = _Modules(root, host)
    try:
        board.run_core(name)
    except Reset:
        raise
    except BaseException as error:
        host.ended(board.format_exception(error))


class _Modules:
    """The modules of one run of a program, and what is built in for them."""

    def __init__(self, root: Path, host: BoardHost) -> None:
        self._root = root
        self._host = host
        self._files: set[str] = set()  # as tracebacks call them
        self.modules: dict[str, ModuleType] = {}
        self._builtins = dict(vars(builtins))
        self._builtins["__import__"] = self._import
        self._builtins["print"] = self._print
        made = {"_host": self._host_module(), "micropython": _micropython(), "gc": _gc()}
        made["struct"] = _struct()
        self._made: Mapping[str, ModuleType] = {**made, "sys": self._sys()}

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
        """What an ``import`` statement of the firmware calls."""
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
        """The module of an absolute name, its packages loaded before it."""
        if name in self.modules:
            return self.modules[name]
        parent, _, last = name.rpartition(".")
        if parent:
            package = self._load(parent)
            if name in self.modules:
                return self.modules[name]  # loaded by its package
        module = self._made.get(name)
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
        """A package may do without a file of its own."""
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

    # --- what is built in -------------------------------------------------------------

    def _host_module(self) -> ModuleType:
        def call(op: int, data: bytes = b"") -> bytes | int:
            try:
                return self._host.call(op, data)
            except OSError as error:
                # With the text that MicroPython has for it; what the host knows stays with it.
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
            # Programs and modules made for boards ask which one it is to know what they have.
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
        """The traceback as MicroPython prints it, without the frames of the host."""
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
    """MicroPython's: its ``s`` takes any buffer, and what does not fit is a ValueError."""

    def told(call: Callable[..., Any]) -> Callable[..., Any]:
        def it(*values: Any) -> Any:
            try:
                return call(
                    *values[:2],
                    *[bytes(v) if isinstance(v, (array, memoryview)) else v for v in values[2:]],
                )
            except struct.error as error:
                raise ValueError(str(error)) from None

        return it

    module = ModuleType("struct")
    vars(module).update(
        calcsize=struct.calcsize, pack_into=told(struct.pack_into), unpack=told(struct.unpack),
        unpack_from=told(struct.unpack_from),
        pack=told(lambda *values: struct.pack(
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
    """As MicroPython does: annotations are not evaluated. A reset compiles nothing again."""
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
    """CPython's collector; how much there is on the heap it does not know, which is -1."""
    module = ModuleType("gc")
    unknown: Callable[[], int] = lambda: -1  # noqa: E731
    vars(module).update(
        collect=gc.collect, enable=gc.enable, disable=gc.disable, isenabled=gc.isenabled,
        mem_alloc=unknown, mem_free=unknown, threshold=lambda *_: -1,
    )  # fmt: skip
    return module
