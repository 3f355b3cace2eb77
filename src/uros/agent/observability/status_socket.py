"""Looking into a running agent: a Unix socket that its owner's tools ask.

It is in a folder that only the owner may enter, ``uros`` in ``$XDG_RUNTIME_DIR`` or, without
that, ``/tmp/uros-<uid>``, and is called ``agent-<pid>.sock``. Questions and answers are JSON, one
a line:

* ``{"ask":"status"}`` is answered by one line, the :mod:`~uros.agent.observability.snapshot`;
* ``{"ask":"trace"}`` by a line for each message that passes from then on, in the form of
  :mod:`~uros.agent.observability.jsonl`, until the asker goes or ends its side;
* anything else by ``{"error":...}``.

The server's thread does it, between what boards want: a part of a millisecond at a time, and no
more than an asker takes. Where there are no Unix sockets, or no folder can be had, the agent goes
on without.
"""

from __future__ import annotations

import json
import os
import re
import socket
import stat
import time
from collections import deque
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from ..transports.base import INFO, WARNING
from .jsonl import Lines
from .message_hooks import Passing
from .snapshot import RATE_SECONDS, SLICE, Rates, pieces

if TYPE_CHECKING:
    from ..server import Server

# Attack, or a slip of a script: askers without end.
MAX_ASKERS: Final = 16
# The same: a question that never ends. The longest there is has 16 octets.
MAX_LINE: Final = 1024
# Questions that may wait for the answer before.
MAX_WAITING: Final = 64
# A message that nobody takes is not kept for ever: so many of them, and bytes.
MAX_PASSING: Final = 2000
MAX_PASSING_BYTES: Final = 1024 * 1024
# Who takes nothing of an answer for so many seconds is cut off.
PATIENCE: Final = 10.0
# Handed to the socket at once.
_CHUNK: Final = 64 * 1024
# Messages that pass are sent on so much later, many at a time; the same where accepting failed.
_PAUSE: Final = 0.02
_NAME: Final = re.compile(r"agent-(\d+)\.sock(\.new)?")


def folders() -> list[Path]:
    """Where agents of this user may have their sockets, the one for a new agent first."""
    if not hasattr(os, "getuid"):
        return []
    found = []
    runtime = os.environ.get("XDG_RUNTIME_DIR")
    if runtime:
        try:
            if os.stat(runtime).st_uid == os.getuid():  # not after sudo -E
                found.append(Path(runtime) / "uros")
        except OSError:
            pass
    found.append(Path(f"/tmp/uros-{os.getuid()}"))
    return found


def check_folder(folder: Path) -> None:
    """Raises OSError where somebody else might have put something there."""
    found = os.lstat(folder)
    if not stat.S_ISDIR(found.st_mode):
        raise OSError(f"{folder} is no folder: remove it")
    if found.st_uid != os.getuid():
        raise OSError(f"{folder} belongs to somebody else: remove it, or set XDG_RUNTIME_DIR")
    if found.st_mode & 0o077:
        raise OSError(f"others may enter {folder}: chmod 700 {folder}")


def sockets(folder: Path) -> dict[int, Path]:
    """The sockets that are there, by the agent's pid; ended agents may have left theirs."""
    try:
        check_folder(folder)
        names = sorted(os.listdir(folder))
    except OSError:
        return {}
    return {int(it[1]): folder / it[0] for name in names if (it := _NAME.fullmatch(name))}


def _clean(folder: Path) -> None:
    """Remove the sockets of agents that have ended."""
    for path in sockets(folder).values():
        with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as sock:
            sock.setblocking(False)
            try:
                sock.connect(str(path))
            except ConnectionRefusedError:
                path.unlink(missing_ok=True)
            except OSError:
                pass  # busy, or gone already


class _Asker:
    __slots__ = (
        "answer", "ended", "form", "heard", "kept", "lost", "moved", "out", "passing",
        "questions", "scheduled", "sock", "tracing",
    )  # fmt: skip

    def __init__(self, sock: socket.socket) -> None:
        self.sock = sock
        self.heard = bytearray()  # of a question that is not whole
        self.questions: deque[bytes] = deque()
        self.answer: Iterator[str] | None = None
        self.out = bytearray()
        self.moved = 0.0  # when it took something the last time, while there was something
        self.ended = False  # it asks nothing more
        self.scheduled = False
        self.tracing = False
        self.passing: deque[tuple[Passing, int]] = deque()
        self.kept = 0  # bytes of these messages
        self.lost = 0  # messages since the last that was kept
        self.form = Lines()


class Inspection:
    """The agent's end, attached to a server. ``folder``: see :func:`folders`."""

    def __init__(self, folder: Path | None = None) -> None:
        self._folder = folder
        self._server: Server | None = None
        self._socket: socket.socket | None = None
        self._askers: dict[_Asker, None] = {}
        self.path: Path | None = None
        self.rates: Rates | None = None

    def open(self, server: Server) -> None:
        """See :class:`~uros.agent.server.Attachment`. It never keeps an agent from starting."""
        self._server = server
        self.rates = Rates(server.agent.clients)
        self._sweep()
        places = folders()
        folder = self._folder or (places[0] if places else None)
        if folder is None or not hasattr(socket, "AF_UNIX"):
            return
        try:
            path, self._socket = self._listen(folder)
        except OSError as error:
            server.note(
                WARNING, "Inspection", "init", "not to be looked into",
                f"{error.strerror or error} ({folder}; 'uros agent status' will not find this"
                " agent; set XDG_RUNTIME_DIR to a folder of your own with a short name)",
            )  # fmt: skip
            return
        self.path = path
        self._wait()
        server.note(INFO, "Inspection", "init", "may be looked into", f"socket: {path}")

    def _listen(self, folder: Path) -> tuple[Path, socket.socket]:
        folder.mkdir(mode=0o700, exist_ok=True)
        if os.lstat(folder).st_uid == os.getuid() and not folder.is_symlink():
            os.chmod(folder, 0o700)
        check_folder(folder)
        _clean(folder)
        path = folder / f"agent-{os.getpid()}.sock"
        new = path.with_name(path.name + ".new")
        new.unlink(missing_ok=True)
        sock = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        try:
            sock.setblocking(False)
            sock.bind(str(new))
            os.chmod(new, 0o600)
            sock.listen(MAX_ASKERS)
            new.rename(path)  # who finds it can connect
        except BaseException:
            sock.close()
            raise
        return path, sock

    def close(self) -> None:
        """See :class:`~uros.agent.server.Attachment`."""
        for asker in list(self._askers):
            self._drop(asker)
        sock, self._socket = self._socket, None
        if sock is not None and self._server is not None:
            self._server.unwatch(sock.fileno())
            sock.close()
        path, self.path = self.path, None
        if path is not None:
            try:
                path.unlink(missing_ok=True)
            except OSError:
                pass
        self._server = None

    def _sweep(self) -> None:
        """Remember the counters, cut off who takes nothing."""
        server = self._server
        if server is None or self.rates is None:
            return
        now = time.monotonic()
        server.wake_at(RATE_SECONDS, self._sweep)
        self.rates.mark(now)
        for asker in list(self._askers):
            if asker.out and not asker.tracing and now - asker.moved > PATIENCE:
                self._drop(asker)

    # --- askers -----------------------------------------------------------------------

    def _wait(self) -> None:
        if self._socket is not None and self._server is not None:
            self._server.watch(self._socket.fileno(), self._accept)

    def _accept(self) -> None:
        server, listener = self._server, self._socket
        if server is None or listener is None:
            return
        try:
            sock, _ = listener.accept()
        except (BlockingIOError, ConnectionError):
            return
        except OSError:  # out of descriptors; the connection stays ready
            server.unwatch(listener.fileno())
            server.wake_at(_PAUSE, self._wait)
            return
        sock.setblocking(False)
        if len(self._askers) >= MAX_ASKERS:
            try:
                sock.send(_error(f"over {MAX_ASKERS} ask already: end one of them"))
            except OSError:
                pass
            sock.close()
            return
        asker = _Asker(sock)
        self._askers[asker] = None
        server.watch(sock.fileno(), lambda: self._ready(asker))

    def _drop(self, asker: _Asker) -> None:
        if asker not in self._askers:
            return
        del self._askers[asker]
        if self._server is not None:
            self._server.unwatch(asker.sock.fileno())
            if asker.tracing and not any(it.tracing for it in self._askers):
                self._server.agent.taps.drop(self._tap)
        asker.sock.close()

    def _ready(self, asker: _Asker) -> None:
        if asker not in self._askers:
            return
        try:
            chunk = asker.sock.recv(4096)
        except BlockingIOError:
            chunk = None
        except OSError:
            self._drop(asker)
            return
        if chunk == b"":
            asker.ended = True  # it may still read
            assert self._server is not None
            self._server.unwatch(asker.sock.fileno())
        elif chunk:
            lines = (asker.heard + chunk).split(b"\n")
            asker.heard = bytearray(lines.pop())
            asker.questions.extend(map(bytes, lines))
            if len(asker.heard) > MAX_LINE or len(asker.questions) > MAX_WAITING:
                asker.questions.clear()
                asker.out += _error("a question too long, or too many at once")
                self._push(asker)
                self._drop(asker)
                return
        self._go(asker)

    def _question(self, line: bytes) -> str | None:
        """What is asked: ``status``, ``trace``, or None for anything else."""
        if len(line) > MAX_LINE:
            return None
        try:
            question: Any = json.loads(line)
        except (ValueError, RecursionError):
            return None
        asked = question.get("ask") if isinstance(question, dict) else None
        return asked if asked in ("status", "trace") else None

    def _next(self, asker: _Asker) -> bool:
        """Begin to answer the next question, where there is one."""
        if not asker.questions:
            return False
        line = asker.questions.popleft()
        asked = self._question(line)
        if not line.strip():
            return True
        if asked is None:
            asker.out += _error('not understood: ask {"ask":"status"} or {"ask":"trace"}')
        elif asked == "status":
            assert self._server is not None and self.rates is not None
            asker.answer = pieces(self._server, self.rates)
        elif not asker.tracing:
            assert self._server is not None
            asker.tracing = True
            if self._tap not in self._server.agent.taps:
                self._server.agent.taps.append(self._tap)
        return True

    def _go(self, asker: _Asker) -> None:
        """Answer, as far as it takes the answer, and for no longer than a slice."""
        asker.scheduled = False
        if asker in self._askers:
            try:
                self._work(asker)
            except Exception:
                self._drop(asker)  # else it waits for the rest of a line
                raise

    def _work(self, asker: _Asker) -> None:
        end = time.monotonic() + SLICE
        while True:
            if asker.answer is not None and len(asker.out) < _CHUNK:
                piece = next(asker.answer, None)
                if piece is None:
                    asker.answer = None
                else:
                    asker.out += piece.encode()
            elif asker.passing and len(asker.out) < _CHUNK:
                passing, lost = asker.passing.popleft()
                asker.kept -= len(passing.message)
                asker.out += asker.form.encode(passing, lost)
            elif len(asker.out) >= _CHUNK or not self._next(asker):
                break
            if time.monotonic() >= end:
                break
        if not self._push(asker):
            return
        more = bool(asker.answer is not None or asker.passing or asker.questions)
        if asker.out:
            if asker.ended:
                if asker.moved + PATIENCE < time.monotonic():
                    self._drop(asker)
                else:
                    self._later(asker, _PAUSE)
        elif more:
            self._later(asker, 0.0)
        elif asker.ended:
            self._drop(asker)

    def _later(self, asker: _Asker, seconds: float) -> None:
        if not asker.scheduled and self._server is not None:
            asker.scheduled = True
            self._server.wake_at(seconds, lambda: self._go(asker))

    def _push(self, asker: _Asker) -> bool:
        """Send what the socket takes. False: the asker is gone."""
        if asker.out:
            try:
                sent = asker.sock.send(memoryview(asker.out)[:_CHUNK])
            except BlockingIOError:
                sent = 0
            except OSError:
                self._drop(asker)
                return False
            del asker.out[:sent]
            if sent or not asker.moved:
                asker.moved = time.monotonic()
        if not asker.out:
            asker.moved = 0.0
        if not asker.ended and self._server is not None:
            self._server.watch(
                asker.sock.fileno(), lambda: self._ready(asker), bool(asker.out)
            )
        return True

    # --- messages that pass -------------------------------------------------------------

    def _tap(self, passing: Passing) -> None:
        for asker in self._askers:
            if not asker.tracing:
                continue
            kept = asker.kept + len(passing.message)
            if len(asker.passing) >= MAX_PASSING or kept > MAX_PASSING_BYTES:
                asker.lost += 1
                continue
            asker.passing.append((passing, asker.lost))
            asker.kept, asker.lost = kept, 0
            if not asker.out:
                self._later(asker, _PAUSE)


def _error(text: str) -> bytes:
    return json.dumps({"error": text}).encode() + b"\n"
