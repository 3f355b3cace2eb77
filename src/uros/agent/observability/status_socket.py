"""The status socket: a Unix socket that the owner's tools query.

It is in a folder that only the owner may enter, ``uros`` in ``$XDG_RUNTIME_DIR`` or, without
that, ``/tmp/uros-<uid>``, and is called ``agent-<pid>.sock``. Queries and answers are JSON, one a
line:

* ``{"ask":"status"}`` is answered by one line, the :mod:`~uros.agent.observability.snapshot`;
* ``{"ask":"trace"}`` by a line for each message that passes from then on, in the format of
  :mod:`~uros.agent.observability.jsonl`, until the tool closes the connection;
* anything else by ``{"error":...}``.

The server's thread answers between messages of boards, a part of a millisecond at a time, and
writes no more than a connection takes. Without Unix sockets, or if the folder cannot be used,
the agent runs without a status socket.
"""

from __future__ import annotations

import json
import os
import re
import socket
import stat
from collections import deque
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from ..transports.base import INFO, WARNING
from .jsonl import JsonLinesEncoder
from .message_hooks import MessageEvent
from .snapshot import RATE_SECONDS, SLICE, Rates, pieces

if TYPE_CHECKING:
    from ..server import Server

# The most connections, because a faulty or malicious program may open endless ones.
MAX_CONNECTIONS: Final = 16
# The longest query in bytes, because a malicious one may never end. The longest valid one has 16
# bytes.
MAX_LINE: Final = 1024
# Queries of one connection that may wait.
MAX_WAITING: Final = 64
# The most messages that wait for a connection, and their bytes; others are counted as lost.
MAX_EVENTS: Final = 2000
MAX_EVENT_BYTES: Final = 1024 * 1024
# A connection that takes nothing of an answer for so many seconds is closed.
PATIENCE: Final = 10.0
# Bytes handed to the socket at once.
_CHUNK: Final = 64 * 1024
# Traced messages are sent in batches, after so many seconds; the same pause follows a failed
# accept().
_PAUSE: Final = 0.02
_NAME: Final = re.compile(r"agent-(\d+)\.sock(\.new)?")


def folders() -> list[Path]:
    """Return the folders where this user's agents have sockets, that of a new agent first."""
    if not hasattr(os, "getuid"):
        return []
    paths = []
    runtime = os.environ.get("XDG_RUNTIME_DIR")
    if runtime:
        try:
            if os.stat(runtime).st_uid == os.getuid():  # not after sudo -E
                paths.append(Path(runtime) / "uros")
        except OSError:
            pass
    paths.append(Path(f"/tmp/uros-{os.getuid()}"))
    return paths


def check_folder(folder: Path) -> None:
    """Raise OSError if another user could have created files in the folder."""
    status = os.lstat(folder)
    if not stat.S_ISDIR(status.st_mode):
        raise OSError(f"{folder} is not a directory: remove it")
    if status.st_uid != os.getuid():
        raise OSError(f"{folder} belongs to another user: remove it, or set XDG_RUNTIME_DIR")
    if status.st_mode & 0o077:
        raise OSError(f"other users may enter {folder}: chmod 700 {folder}")


def sockets(folder: Path) -> dict[int, Path]:
    """Return the sockets in a folder by the agent's pid; agents that crashed leave theirs."""
    try:
        check_folder(folder)
        names = sorted(os.listdir(folder))
    except OSError:
        return {}
    matches = filter(None, map(_NAME.fullmatch, names))
    return {int(match[1]): folder / match[0] for match in matches}


def _remove_stale(folder: Path) -> None:
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


class _Connection:
    """A tool that is connected."""

    __slots__ = (
        "answer", "encoder", "ended", "event_bytes", "events", "heard", "lost", "out",
        "progress_at", "queries", "scheduled", "sock", "tracing",
    )  # fmt: skip

    def __init__(self, sock: socket.socket) -> None:
        self.sock = sock
        self.heard = bytearray()  # the beginning of an incomplete query
        self.queries: deque[bytes] = deque()
        self.answer: Iterator[str] | None = None
        self.out = bytearray()
        self.progress_at = 0.0  # when it last took something of `out`
        self.ended = False  # the tool sends no more queries
        self.scheduled = False
        self.tracing = False
        self.events: deque[tuple[MessageEvent, int]] = deque()
        self.event_bytes = 0  # bytes of the messages in `events`
        self.lost = 0  # messages since the last one in `events`
        self.encoder = JsonLinesEncoder()


class StatusSocket:
    """The status socket of an agent, an attachment of its server.

    Args:
        folder: Where the socket is made; None for the first of :func:`folders`.
    """

    def __init__(self, folder: Path | None = None) -> None:
        self._folder = folder
        self._server: Server | None = None
        self._monotonic: Callable[[], float] = lambda: 0.0  # until it is opened
        self._socket: socket.socket | None = None
        self._connections: dict[_Connection, None] = {}
        self.path: Path | None = None
        self.rates: Rates | None = None

    def open(self, server: Server) -> None:
        """Open the socket; a failure is logged and the agent starts without it."""
        self._server = server
        self._monotonic = server.clock.monotonic
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
                WARNING, "StatusSocket", "init", "no status socket",
                f"{error.strerror or error} ({folder}; 'uros agent status' will not find this"
                " agent; set XDG_RUNTIME_DIR to a folder of your own with a short name)",
            )  # fmt: skip
            return
        self.path = path
        self._watch_listener()
        server.note(INFO, "StatusSocket", "init", "status socket open", f"socket: {path}")

    def _listen(self, folder: Path) -> tuple[Path, socket.socket]:
        folder.mkdir(mode=0o700, exist_ok=True)
        if os.lstat(folder).st_uid == os.getuid() and not folder.is_symlink():
            os.chmod(folder, 0o700)
        check_folder(folder)
        _remove_stale(folder)
        path = folder / f"agent-{os.getpid()}.sock"
        new = path.with_name(path.name + ".new")
        new.unlink(missing_ok=True)
        sock = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        try:
            sock.setblocking(False)
            sock.bind(str(new))
            os.chmod(new, 0o600)
            sock.listen(MAX_CONNECTIONS)
            new.rename(path)  # from now on a tool that finds it can connect
        except BaseException:
            sock.close()
            raise
        return path, sock

    def close(self) -> None:
        """Close all connections and remove the socket."""
        for connection in list(self._connections):
            self._drop(connection)
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
        """Record the counters and close connections that take nothing; each RATE_SECONDS."""
        server = self._server
        if server is None or self.rates is None:
            return
        now = self._monotonic()
        server.wake_at(RATE_SECONDS, self._sweep)
        self.rates.mark(now)
        for connection in list(self._connections):
            idle = now - connection.progress_at
            if connection.out and not connection.tracing and idle > PATIENCE:
                self._drop(connection)

    # --- connections --------------------------------------------------------------------

    def _watch_listener(self) -> None:
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
            server.wake_at(_PAUSE, self._watch_listener)
            return
        sock.setblocking(False)
        if len(self._connections) >= MAX_CONNECTIONS:
            try:
                sock.send(_error(f"over {MAX_CONNECTIONS} connections: close one of them"))
            except OSError:
                pass
            sock.close()
            return
        connection = _Connection(sock)
        self._connections[connection] = None
        server.watch(sock.fileno(), lambda: self._ready(connection))

    def _drop(self, connection: _Connection) -> None:
        if connection not in self._connections:
            return
        del self._connections[connection]
        if self._server is not None:
            self._server.unwatch(connection.sock.fileno())
            if connection.tracing and not any(remaining.tracing for remaining in self._connections):
                self._server.agent.message_hooks.discard(self._on_message)
        connection.sock.close()

    def _ready(self, connection: _Connection) -> None:
        if connection not in self._connections:
            return
        try:
            chunk = connection.sock.recv(4096)
        except BlockingIOError:
            chunk = None
        except OSError:
            self._drop(connection)
            return
        if chunk == b"":
            connection.ended = True  # the tool may still read
            assert self._server is not None
            self._server.unwatch(connection.sock.fileno())
        elif chunk:
            lines = (connection.heard + chunk).split(b"\n")
            connection.heard = bytearray(lines.pop())
            connection.queries.extend(map(bytes, lines))
            if len(connection.heard) > MAX_LINE or len(connection.queries) > MAX_WAITING:
                connection.queries.clear()
                connection.out += _error("query too long, or too many at once")
                self._push(connection)
                self._drop(connection)
                return
        self._answer(connection)

    def _parse_query(self, line: bytes) -> str | None:
        """Return ``status`` or ``trace``; None for anything else."""
        if len(line) > MAX_LINE:
            return None
        try:
            query: Any = json.loads(line)
        except (ValueError, RecursionError):
            return None
        question = query.get("ask") if isinstance(query, dict) else None
        return question if question in ("status", "trace") else None

    def _next(self, connection: _Connection) -> bool:
        """Begin to answer the next query; return whether there was one."""
        if not connection.queries:
            return False
        line = connection.queries.popleft()
        question = self._parse_query(line)
        if not line.strip():
            return True
        if question is None:
            connection.out += _error('not understood: ask {"ask":"status"} or {"ask":"trace"}')
        elif question == "status":
            assert self._server is not None and self.rates is not None
            connection.answer = pieces(self._server, self.rates)
        elif not connection.tracing:
            assert self._server is not None
            connection.tracing = True
            if self._on_message not in self._server.agent.message_hooks:
                self._server.agent.message_hooks.append(self._on_message)
        return True

    def _answer(self, connection: _Connection) -> None:
        """Write as much of the answers as the connection takes, for at most a slice of time."""
        connection.scheduled = False
        if connection in self._connections:
            try:
                self._work(connection)
            except Exception:
                self._drop(connection)  # otherwise the tool would wait for the rest of a line
                raise

    def _work(self, connection: _Connection) -> None:
        end = self._monotonic() + SLICE
        while True:
            if connection.answer is not None and len(connection.out) < _CHUNK:
                piece = next(connection.answer, None)
                if piece is None:
                    connection.answer = None
                else:
                    connection.out += piece.encode()
            elif connection.events and len(connection.out) < _CHUNK:
                event, lost = connection.events.popleft()
                connection.event_bytes -= len(event.message)
                connection.out += connection.encoder.encode(event, lost)
            elif len(connection.out) >= _CHUNK or not self._next(connection):
                break
            if self._monotonic() >= end:
                break
        if not self._push(connection):
            return
        more = bool(connection.answer is not None or connection.events or connection.queries)
        if connection.out:
            if connection.ended:
                if connection.progress_at + PATIENCE < self._monotonic():
                    self._drop(connection)
                else:
                    self._later(connection, _PAUSE)
        elif more:
            self._later(connection, 0.0)
        elif connection.ended:
            self._drop(connection)

    def _later(self, connection: _Connection, seconds: float) -> None:
        if not connection.scheduled and self._server is not None:
            connection.scheduled = True
            self._server.wake_at(seconds, lambda: self._answer(connection))

    def _push(self, connection: _Connection) -> bool:
        """Send what the socket takes; return whether the connection is still open."""
        if connection.out:
            try:
                sent = connection.sock.send(memoryview(connection.out)[:_CHUNK])
            except BlockingIOError:
                sent = 0
            except OSError:
                self._drop(connection)
                return False
            del connection.out[:sent]
            if sent or not connection.progress_at:
                connection.progress_at = self._monotonic()
        if not connection.out:
            connection.progress_at = 0.0
        if not connection.ended and self._server is not None:
            self._server.watch(
                connection.sock.fileno(), lambda: self._ready(connection), bool(connection.out)
            )
        return True

    # --- traced messages ----------------------------------------------------------------

    def _on_message(self, event: MessageEvent) -> None:
        for connection in self._connections:
            if not connection.tracing:
                continue
            size = connection.event_bytes + len(event.message)
            if len(connection.events) >= MAX_EVENTS or size > MAX_EVENT_BYTES:
                connection.lost += 1
                continue
            connection.events.append((event, connection.lost))
            connection.event_bytes, connection.lost = size, 0
            if not connection.out:
                self._later(connection, _PAUSE)


def _error(text: str) -> bytes:
    return json.dumps({"error": text}).encode() + b"\n"
