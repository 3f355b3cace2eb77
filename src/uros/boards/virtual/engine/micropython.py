"""Runs a board's program on MicroPython, as WebAssembly in a Node process of its own.

What the program asks for comes through a pipe and is answered through another;
``engine_micropython.mjs`` is the other end and says how they look. The process ends with this one,
however that ends.
"""

from __future__ import annotations

import errno
import os
import shlex
import shutil
import struct
import subprocess
from pathlib import Path
from typing import Final

from ..shims import _ops as ops
from .syscalls import BoardHost, Reset

_HERE: Final = Path(__file__).parent
RUNNER: Final = _HERE / "micropython.mjs"
PACKAGE: Final = "@micropython/micropython-webassembly-pyscript"
VERSION: Final = "1.27.0"
"""Of the package: the one that the shims are tested with."""
_MODULE: Final = Path("node_modules", *PACKAGE.split("/"), "micropython.mjs")
_SILENT: Final = (ops.CONSOLE, ops.HEAP)

# MicroPython numbers errors the same on every machine, namely as Linux does.
_ERRORS: Final = {
    "ENOENT": 2, "EIO": 5, "EBADF": 9, "EAGAIN": 11, "ENOMEM": 12, "ENODEV": 19, "EINVAL": 22,
    "ECONNRESET": 104, "ENOTCONN": 107, "ETIMEDOUT": 110, "ECONNREFUSED": 111, "EHOSTUNREACH": 113,
    "EINPROGRESS": 115,
}  # fmt: skip


class NoMicroPython(RuntimeError):
    """Node or MicroPython's npm package is not here. The text has the remedy."""


def find() -> tuple[Path, Path]:
    """``(node, micropython.mjs)``. Raises NoMicroPython.

    Looked for in ``$UROS_MICROPYTHON``, a folder with node_modules, and only there if it is set;
    else in the ``build/micropython`` of the clone and of the current folder, then in the current
    folder; node beside them, or on the PATH.
    """
    named = os.environ.get("UROS_MICROPYTHON")
    clones = dict.fromkeys((_HERE.parents[4], Path.cwd()))
    folders = [Path(named)] if named else [it / "build" / "micropython" for it in clones]
    if not named:
        folders.append(Path.cwd())
    for folder in folders:
        module = folder / _MODULE
        if not module.exists():
            continue
        beside = folder / "node"
        node = str(beside) if os.access(beside, os.X_OK) else shutil.which("node")
        if node is None:
            raise NoMicroPython("the engine micropython needs Node 18 or newer: install node")
        return Path(node), module
    raise NoMicroPython(_remedy(named, [it for it in clones if _is_clone(it)]))


def _is_clone(folder: Path) -> bool:
    return (folder / "scripts" / "env.py").exists() and (folder / "src" / "uros").is_dir()


def _remedy(named: str | None, clones: list[Path]) -> str:
    """What to say where nothing was found; its commands can be typed as they stand."""
    script = ""
    if clones:
        file = os.path.relpath(clones[0] / "scripts" / "env.py")
        script = f"python3 {shlex.quote(file)} micropython"
    npm = f"npm install {PACKAGE}@{VERSION} --prefix"
    if named:
        place = Path(named, "node_modules")
        text = f"there is no MicroPython in {place}; install it with: {npm} {shlex.quote(named)}"
        other = f"unset UROS_MICROPYTHON and: {script}" if script else "name another folder by it"
        return f"{text} (UROS_MICROPYTHON names that folder), or {other}"
    if script:
        place = clones[0] / "build" / "micropython"
        return f"there is no MicroPython in {place}; install it with: {script}"
    here = "~/micropython"
    return (
        "there is no MicroPython in node_modules here, and UROS_MICROPYTHON names no other folder;"
        f" install it with: {npm} {here} && export UROS_MICROPYTHON={here}"
    )


class MicroPythonEngine:
    """One run of a program, or where ``core`` is the name of a module, of that on the board's
    second core. :meth:`stop` and :meth:`ask_heap` may come from another thread.
    """

    def __init__(self, root: Path, host: BoardHost, measure: bool = False, core: str = "") -> None:
        node, module = find()
        self._host = host
        requests, theirs = os.pipe()
        answers, ours = os.pipe()
        self._requests = requests
        self._answers = ours
        shims = _HERE.parent / "shims"
        try:
            self._process = subprocess.Popen(
                [node, "--no-warnings", RUNNER, module, root, shims, str(theirs), str(answers),
                 str(int(measure)), core],
                stdin=subprocess.PIPE, stdout=2, pass_fds=(theirs, answers),
            )  # fmt: skip
        finally:
            os.close(theirs)
            os.close(answers)

    def run(self) -> None:
        """Serve the program until it ends, however. Raises Reset when it asks for one."""
        while True:
            head = self._receive(4)
            data = self._receive(int.from_bytes(head, "little"))
            if not data:
                return
            operation = data[0]
            status, number, out = 0, 0, b""
            try:
                answer = self._host.call(operation, data[1:])
            except OSError as error:
                status = _ERRORS.get(errno.errorcode.get(error.errno or 0, ""), _ERRORS["EIO"])
            else:
                if operation in _SILENT:
                    continue
                if isinstance(answer, int):
                    number = answer
                else:
                    number, out = len(answer), answer
            try:
                os.write(self._answers, struct.pack("<IBI", len(out) + 5, status, number) + out)
            except BrokenPipeError:
                return

    def _receive(self, length: int) -> bytes:
        """So many octets, or none when the process is gone."""
        data = b""
        while len(data) < length:
            some = os.read(self._requests, length - len(data))
            if not some:
                return b""
            data += some
        return data

    def ask_heap(self) -> None:
        """The host is told after the slice that runs."""
        assert self._process.stdin is not None
        try:
            self._process.stdin.write(b"heap\n")
            self._process.stdin.flush()
        except OSError:
            pass  # it has just ended

    def stop(self) -> None:
        """End the process."""
        self._process.kill()
        self._process.wait()

    def close(self) -> None:
        """End the process and free what was held. Not while :meth:`run` runs."""
        self.stop()
        assert self._process.stdin is not None
        try:
            self._process.stdin.close()
        except OSError:
            pass
        os.close(self._requests)
        os.close(self._answers)


def run(engine: MicroPythonEngine) -> None:
    """Run to the end; Reset is passed on."""
    try:
        engine.run()
    except Reset:
        raise
    finally:
        engine.close()
