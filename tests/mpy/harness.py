"""Runs MicroPython in a process, with the portable modules of uros, for tests.

    with MicroPython() as board:
        board.install(portable_sources())
        board.run("from uros.wire import cdr; print(cdr.__name__)")   -> 'uros.wire.cdr\\n'
        board.heap()                                                  -> bytes in use

Portable tests are the modules tests/unit/**/portable_*.py: plain functions test_*() with bare
asserts, which import only uros, modules of MicroPython and the SHARED modules below. pytest runs
them on CPython in place, and test_portable.py runs the same functions on MicroPython. They import
interface types from the host's package and, if that fails, from the board's:

    try:
        from uros.interfaces.std_msgs.msg import Int32
    except ImportError:  # MicroPython
        from std_msgs.msg import Int32
"""

import ast
import base64
import json
import re
import subprocess
import threading
from collections.abc import Callable, Iterable, Mapping
from functools import cache
from pathlib import Path

from uros.boards.builder.compiler import bytecode
from uros.boards.builder.portable import SOURCE, portable_files
from uros.interfaces.package import module_texts

ROOT = Path(__file__).resolve().parents[2]
RUNNER = Path(__file__).with_name("runner.mjs")
INSTALLED = ROOT / "build" / "micropython"
MODULE = INSTALLED / "node_modules/@micropython/micropython-webassembly-pyscript/micropython.mjs"

# The portable modules of src/uros, and the model of a radio network for the modems' tests.
PORTABLE = (
    *(path.relative_to(SOURCE).as_posix() for path in portable_files()),
    "boards/__init__.py",
    "boards/virtual/__init__.py",
    "boards/virtual/modems/__init__.py",
    "boards/virtual/modems/radio_network.py",
    "boards/virtual/modems/esp8266.py",
    "boards/virtual/modems/gs2200.py",
    "boards/virtual/modems/modem.py",
)

# Modules in tests/ that tests on both sides import, by the same names.
SHARED = (
    "support/__init__.py",
    "support/board.py",
    "support/chance.py",
    "support/conversation.py",
    "support/modem.py",
    "support/portable.py",
    "support/recorder.py",
    "support/script.py",
    "support/services.py",
    "unit/interfaces/rclpy_vectors.py",
    "unit/interfaces/vectors.py",
)

_TYPES = r"[a-z0-9_]+\.(msg|srv|action)"

# A test that takes longer is stuck: MicroPython has no time limit of its own.
ANSWER_SECONDS = 30


class MicroPythonError(AssertionError):
    """The code on MicroPython raised; the text is its traceback and its output."""


class MicroPython:
    """One MicroPython interpreter in a Node process. Use it as a context manager."""

    def __init__(self) -> None:
        if not MODULE.exists():
            raise FileNotFoundError(f"{MODULE}: run python3 scripts/env.py micropython")
        self._process = subprocess.Popen(
            [INSTALLED / "node", RUNNER, MODULE],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            encoding="utf-8",
        )

    def __enter__(self) -> "MicroPython":
        return self

    @property
    def ended(self) -> bool:
        """Whether the process has crashed, or was killed since it did not answer."""
        return self._process.poll() is not None

    def __exit__(self, *_: object) -> None:
        assert self._process.stdout
        self._process.kill()
        self._process.communicate()

    def _ask(self, **request: str) -> dict:
        assert self._process.stdin and self._process.stdout
        watchdog = threading.Timer(ANSWER_SECONDS, self._process.kill)
        watchdog.start()
        try:
            self._process.stdin.write(json.dumps(request) + "\n")
            self._process.stdin.flush()
            line = self._process.stdout.readline()
        except BrokenPipeError:
            line = ""
        finally:
            watchdog.cancel()
        if not line:
            status = self._process.wait()
            raise MicroPythonError(f"MicroPython ended without an answer (exit status {status})")
        return json.loads(line)

    def write(self, path: str, content: str | bytes) -> None:
        """Write a file into MicroPython's file system; /lib is on its sys.path."""
        data = content.encode() if isinstance(content, str) else content
        self._ask(do="write", path=path, base64=base64.b64encode(data).decode())

    def install(self, sources: Mapping[str, str | bytes]) -> None:
        """Write modules into /lib, from a mapping of relative path to text or .mpy bytes."""
        for path, content in sources.items():
            self.write("/lib/" + path, content)

    def run(self, source: str) -> str:
        """Run source in __main__ and return its output. Names stay for the next run."""
        answer = self._ask(do="run", source=source)
        if answer["error"]:
            raise MicroPythonError(f"{answer['error']}\n{answer['output']}".rstrip())
        return answer["output"]

    def heap(self) -> int:
        """Return the bytes in use after a collection; pointers have 32 bits, as on boards."""
        return self._ask(do="heap")["heap"]


def portable_sources(
    parts: Iterable[str] = PORTABLE, change: Callable[[str], str] = str
) -> dict[str, str]:
    """Return the text of each portable module of uros, by its path below /lib.

    ``change`` may rewrite a text, as a build for boards does; by default texts do not change. The
    ``__init__`` of uros is empty: its content is for hosts.
    """
    sources = {"uros/__init__.py": ""}
    for part in parts:
        root = ROOT / "src" / "uros" / part
        for file in sorted(root.rglob("*.py")) if root.is_dir() else [root]:
            path = file.relative_to(ROOT / "src").as_posix()
            sources[path] = change(file.read_text(encoding="utf-8"))
    return sources


def compiled(sources: Mapping[str, str]) -> dict[str, bytes]:
    """Return the same modules as bytecode, with their asserts."""
    return {
        path.removesuffix(".py") + ".mpy": _bytecode(path, text) for path, text in sources.items()
    }


@cache
def _bytecode(path: str, text: str) -> bytes:
    return bytecode(text, path, path, "-O0")


def tree(folder: Path) -> dict[str, bytes]:
    """Return the files of a folder, such as a built file system, by their paths below it."""
    files = [file for file in sorted(folder.rglob("*")) if file.is_file()]
    return {file.relative_to(folder).as_posix(): file.read_bytes() for file in files}


def shared_sources() -> dict[str, str]:
    """Return the text of each SHARED module, by its path below /lib."""
    return {path: (ROOT / "tests" / path).read_text(encoding="utf-8") for path in SHARED}


def type_sources(file: Path) -> dict[str, str]:
    """Return a module for each interface type that a test imports, and for the types they nest."""
    names = [
        f"{node.module.replace('.', '/')}/{alias.name}"
        for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"), str(file)))
        if isinstance(node, ast.ImportFrom) and re.fullmatch(_TYPES, node.module or "")
        for alias in node.names
    ]
    return module_texts(names)


def portable_tests() -> list[tuple[Path, str]]:
    """Return (module, function) for each portable test, in the order of the sources."""
    return [
        (file, node.name)
        for file in sorted((ROOT / "tests" / "unit").rglob("portable_*.py"))
        for node in ast.parse(file.read_text(encoding="utf-8"), str(file)).body
        if isinstance(node, ast.FunctionDef) and node.name.startswith("test_")
    ]
