"""A simulated board with MicroPython's raw REPL on a pseudo-terminal, with injected faults.

It behaves like a real board except where the test injects a fault, a *lie*: its file system is a
dict, and CPython runs the code with an ``os`` and an ``open`` of that file system, so a test can
check the effects of a deployment. Each output of the board is a *step*:

``banner`` ``reboot`` ``again`` (the banner after the reset), ``paste`` (it supports raw paste),
``window``, ``credit`` (room for more code), ``heard`` (all code has arrived), ``output``,
``error``, ``prompt``, ``friendly``.

A lie is a function of the step, the number of the code that runs (0: none yet) and the correct
output; it returns octets, or one of `SILENCE`, `GONE` and `Endless`.

`QuickTime` is the clock of a deployment to such a board: it advances while the board is silent.
"""

import binascii
import contextlib
import hashlib
import io
import os
import select
import threading
import time
import tty
from types import SimpleNamespace

from uros.boards.deploy import raw_repl
from uros.transport.serial_host import DevicePort

SILENCE = object()
GONE = object()
BANNER = b"raw REPL; CTRL-B to exit\r\n>"
_FOLDER, _FILE = 0x4000, 0x8000


class Endless:
    """Repeat the same octets without end."""

    def __init__(self, octets):
        self.octets = octets


class Gone(Exception):
    """The board is unplugged."""


class QuickTime:
    """A clock that skips the waiting for a board that has no more output.

    It replaces ``time`` in `uros.boards.deploy.raw_repl`, and the waiting of ports. So a timeout
    does not depend on the speed of the machine: it occurs when the board is silent, or after a
    large number of reads.
    """

    _READ_SECONDS = 0.05  # for each read: endless output then reaches the timeout

    def __init__(self, board, monkeypatch):
        self._board = board
        self._skipped = 0.0
        self._octets = [0, 0]  # sent, received
        self._read, self._write = DevicePort.read, DevicePort.write
        quick = self
        monkeypatch.setattr(raw_repl, "time", self)
        monkeypatch.setattr(DevicePort, "read", lambda port, size: quick._do_read(port, size))
        monkeypatch.setattr(DevicePort, "write", lambda port, data: quick._do_write(port, data))
        monkeypatch.setattr(DevicePort, "wait", lambda port, ms: quick._wait(port, ms))

    def monotonic(self):
        return time.monotonic() + self._skipped

    def sleep(self, seconds):
        if self._board.is_done(*self._octets):
            self._skipped += seconds
        else:
            time.sleep(min(seconds, 0.001))

    def _do_read(self, port, size):
        data = self._read(port, size)
        self._octets[1] += len(data or b"")
        return data

    def _do_write(self, port, data):
        count = self._write(port, data)
        self._octets[0] += count
        return count

    def _wait(self, port, timeout_ms):
        end = time.monotonic() + timeout_ms / 1000
        while time.monotonic() < end:
            if port._poll.poll(0):
                self._skipped += self._READ_SECONDS
                return
            if self._board.is_done(*self._octets):
                self._skipped += timeout_ms / 1000
                return
            port._poll.poll(1)


class LyingBoard:
    """The board, a context manager; ``path`` is its device, ``files`` its file system."""

    def __init__(self, lie=lambda step, count, honest: honest, files=(), window=32):
        self.files = dict(files)
        self.folders = set()
        self.lie = lie
        self.window = window
        self.steps = []
        self._master, self._slave = os.openpty()
        tty.setraw(self._slave)
        os.set_blocking(self._master, False)
        self.path = os.ttyname(self._slave)
        self._plugged = True
        self._stop, self._stopped = os.pipe()
        # For QuickTime: octets read and written, and whether the thread waits for more to read.
        self._octets = [0, 0]
        self._resting = False
        self._code = 0
        self._world = {}
        self._thread = threading.Thread(target=self._live)

    def __enter__(self):
        self._thread.start()
        return self

    def __exit__(self, *_):
        os.close(self._stopped)
        self._thread.join()
        self._unplug()
        os.close(self._stop)

    def _unplug(self):
        if self._plugged:
            self._plugged = False
            os.close(self._slave)
            os.close(self._master)

    def is_done(self, sent, received):
        """Whether the board waits for input.

        It has read all ``sent`` octets, and all of its output is ``received``.
        """
        if not self._plugged:
            return True
        before = list(self._octets)
        resting = self._resting
        return resting and before == self._octets == [sent, received]

    # --- the line ---------------------------------------------------------------------------

    def _read(self, seconds=None):
        """The octets that have arrived; b"" after ``seconds``. Raises Gone at the end."""
        self._resting = True
        ready = select.select([self._master, self._stop], [], [], seconds)[0]
        self._resting = False  # before it has read: see is_done
        if self._stop in ready:
            raise Gone
        try:
            octets = os.read(self._master, 65536) if ready else b""
        except OSError:
            raise Gone from None
        self._octets[0] += len(octets)
        return octets

    def _write(self, octets):
        while octets:
            ready = select.select([self._stop], [self._master], [])
            if ready[0]:
                raise Gone
            try:
                count = os.write(self._master, octets)
                self._octets[1] += count
                octets = octets[count:]
            except BlockingIOError:
                continue
            except OSError:
                raise Gone from None

    def _say(self, step, honest):
        self.steps.append(step)
        output = self.lie(step, self._code, honest)
        if output is SILENCE:
            while True:
                self._read()
        if output is GONE:
            raise Gone
        if isinstance(output, Endless):
            while True:
                self._write(output.octets * 64)
        self._write(output)

    def _live(self):
        try:
            self._serve()
        except Gone:
            self._unplug()

    # --- the REPL ---------------------------------------------------------------------------

    def _serve(self):
        raw = False
        line = b""
        while True:
            line += self._read()
            while line:
                key, line = line[:1], line[1:]
                if key == b"\x01":
                    raw = True
                    self._say("banner", BANNER)
                elif key == b"\x02":
                    raw = False
                    self._say("friendly", b"\r\n>>> ")
                elif key == b"\x04" and raw:
                    self._world = {}
                    self._say("reboot", b"OK\r\nMPY: soft reboot\r\n")
                    self._say("again", BANNER)
                elif key == b"\x05" and raw:
                    while len(line) < 2:
                        line += self._read()
                    line = self._paste(line[2:])

    def _paste(self, line):
        self._code += 1
        self._say("paste", b"R\x01")
        self._say("window", self.window.to_bytes(2, "little"))
        self._say("credit", b"\x01")
        code = bytearray()
        credited = 0
        while True:
            while not line:
                line = self._read()
            end = line.find(b"\x04")
            code += line if end < 0 else line[:end]
            while len(code) - credited >= self.window:
                credited += self.window
                self._say("credit", b"\x01")
            if end >= 0:
                line = line[end + 1 :]
                break
            line = b""
        self._say("heard", b"\x04")
        output, error = self._run(bytes(code).decode())
        self._say("output", output + b"\x04")
        self._say("error", error + b"\x04")
        self._say("prompt", b">")
        return line

    def _run(self, code):
        out = io.StringIO()
        world = self._world
        world.setdefault("__builtins__", {**vars(__import__("builtins")), "open": self._open,
                                          "__import__": self._import})  # fmt: skip
        try:
            with contextlib.redirect_stdout(out):
                exec(code, world)
            error = b""
        except Exception as raised:
            error = f"Traceback\r\n{type(raised).__name__}: {raised}\r\n".encode()
        return out.getvalue().replace("\n", "\r\n").encode(), error

    # --- its modules and files ---------------------------------------------------------------

    def _import(self, name, *_):
        return {
            "os": SimpleNamespace(
                stat=self._stat, statvfs=lambda path: (4096, 4096, 1024, 1024, 1024),
                getcwd=lambda: "/", ilistdir=self._list, remove=self._remove, rmdir=self._rmdir,
                mkdir=lambda path: self.folders.add(path.strip("/")), rename=self._rename,
            ),
            "sys": SimpleNamespace(
                implementation=SimpleNamespace(
                    name="micropython", version=(1, 27, 0), _machine="A board that lies", _mpy=6
                ),
                platform="liar",
            ),
            "binascii": binascii,
            "hashlib": hashlib,
        }[name]  # fmt: skip

    def _stat(self, path):
        path = path.strip("/")
        if path in self.files:
            return (_FILE,)
        if path in self.folders:
            return (_FOLDER,)
        raise OSError(2, path)

    def _list(self, path):
        path = path.strip("/")
        for kind, names in ((_FILE, self.files), (_FOLDER, self.folders)):
            for name in sorted(names):
                folder, _, last = name.rpartition("/")
                if folder == path:
                    yield last, kind

    def _remove(self, path):
        if self.files.pop(path.strip("/"), None) is None:
            raise OSError(2, path)

    def _rmdir(self, path):
        if list(self._list(path)) or path.strip("/") not in self.folders:
            raise OSError(39, path)
        self.folders.discard(path.strip("/"))

    def _rename(self, old, new):
        self.files[new.strip("/")] = self.files.pop(old.strip("/"))

    def _open(self, path, mode="r"):
        path, board = path.strip("/"), self
        if "w" not in mode:
            if path not in self.files:
                raise OSError(2, path)
            data = self.files[path]
            return io.BytesIO(data) if "b" in mode else io.StringIO(data.decode())
        self.files[path] = b""

        class Written:
            def write(self, data):
                board.files[path] += data.encode() if isinstance(data, str) else data

            def close(self):
                pass

        return Written()
