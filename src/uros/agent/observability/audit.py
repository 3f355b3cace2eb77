"""``--audit FILE``: who was refused, by which rule, and how often, as JSON lines.

A line is an object::

    {"time": "2025-11-21T18:33:20.123456Z", "kind": "board", "rule": "allow_key", "client_key": "0x4B0CBE99", "address": "192.168.1.8:2018", "why": "client key not allowed", "times": 1}

``times`` counts the refusals since the line before of the same kind, rule and host. Nobody can fill
the disk: a kind, rule and host have a line each :data:`LINE_SECONDS` after the first few, all
together :data:`~uros.agent.log.MAX_LINES` in that time, and two files of limited size are kept. A
thread writes, because boards must not wait for a disk.
"""  # noqa: E501

from __future__ import annotations

import errno
import json
import os
import queue
import stat
import threading
from datetime import datetime, timezone
from typing import TYPE_CHECKING, Final

from ...file_lock import lock
from ...printable import printable
from ..log import RateLimit, unexpected
from ..objects.kinds import key_label
from ..policy.admission import RefusalEvent
from ..transports.base import ERROR, INFO, WARNING

if TYPE_CHECKING:
    from ..server import Server

# The seconds from one line of a kind, rule and host to the next, and how many may come at once.
LINE_SECONDS: Final = 10.0
LINE_BURST: Final = 3
# Lines that may wait for the disk; further ones are lost and counted.
MAX_WAITING: Final = 1000
_MAX_TEXT: Final = 300
_JOIN_SECONDS: Final = 1.0
_FLAGS: Final = (
    os.O_WRONLY | os.O_CREAT | os.O_APPEND | getattr(os, "O_NOCTTY", 0)
    | getattr(os, "O_BINARY", 0) | getattr(os, "O_NONBLOCK", 0)
)  # fmt: skip
_MODE: Final = 0o600
_BEGINNING: Final = b'{"time": '


class AuditError(Exception):
    """The audit file cannot be used; the text says why and what to do."""


class AuditTrail:
    """Writes refusals to a file; an attachment of the server.

    A file that reaches its limit is renamed to ``path`` with ``.1`` appended. An existing file is
    continued. While the disk is full, lines are lost; the log says so once, and when it goes on.

    Args:
        path: The file.
        limit: Its size in bytes at which the next file is begun.

    Raises:
        AuditError: The file cannot be written, or it exists and is no audit file.
    """

    def __init__(self, path: str, limit: int) -> None:
        self.path = path
        self._limit = limit
        self._file, self._size = _open(path)
        self._waiting: queue.Queue[bytes | None] = queue.Queue(MAX_WAITING)
        self._lines = RateLimit(LINE_SECONDS, LINE_BURST)
        self._lost = 0
        self._failing = ""
        self._server: Server | None = None
        self._thread = threading.Thread(target=self._run, name="uros-audit", daemon=True)

    def open(self, server: Server) -> None:
        """Begin to record."""
        self._server = server
        self._lines = RateLimit(LINE_SECONDS, LINE_BURST, server.clock.monotonic)
        server.agent.refusals.listeners.append(self._record)
        server.troubles.append(self.trouble)
        self._thread.start()

    def close(self) -> None:
        """Write what waits, for at most a second; idempotent."""
        server, self._server = self._server, None
        if server is not None:
            server.agent.refusals.listeners.remove(self._record)
            try:
                self._waiting.put_nowait(None)
            except queue.Full:
                return
            self._thread.join(_JOIN_SECONDS)

    def trouble(self) -> str:
        """Return why nothing is recorded now; "" if refusals are."""
        return f"refusals are not recorded in {self.path}: {self._failing}" * bool(self._failing)

    def _record(self, event: RefusalEvent) -> None:
        """Queue a line, unless there were many; never blocks."""
        assert self._server is not None
        host = event.address.rpartition(":")[0] or event.address
        times = self._lines.admit(f"{event.kind} {event.rule} {host}")
        if not times:
            return
        seconds, nanos = divmod(self._server.clock.time_ns(), 1_000_000_000)
        moment = datetime.fromtimestamp(seconds, timezone.utc)
        line = {
            "time": f"{moment:%Y-%m-%dT%H:%M:%S}.{nanos // 1000:06d}Z",
            "kind": event.kind,
            "rule": event.rule,
            **({"client_key": key_label(event.key)} if event.key else {}),
            "address": printable(event.address[:_MAX_TEXT]),
            "why": printable(event.why[:_MAX_TEXT]),
            "times": times + event.times - 1,
        }
        try:
            self._waiting.put_nowait(json.dumps(line).encode() + b"\n")
        except queue.Full:
            self._lost += 1

    # --- the thread that writes ----------------------------------------------------------

    def _run(self) -> None:
        try:
            while (line := self._waiting.get()) is not None:
                try:
                    self._write(line)
                except OSError as error:
                    self._fail(error.strerror or str(error))
        except Exception as error:  # whatever it is, boards are served
            self._failing = type(error).__name__
            self._note(ERROR, "internal error", unexpected(error, "; the audit ends"))
        finally:
            if self._file >= 0:
                os.close(self._file)

    def _write(self, line: bytes) -> None:
        if self._file >= 0 and self._size and self._size + len(line) > self._limit:
            file, self._file = self._file, -1
            os.close(file)
            os.replace(self.path, f"{self.path}.1")
        if self._file < 0:
            self._file, self._size = _open_locked(self.path), 0
        done = os.write(self._file, line)
        if done < len(line):
            os.ftruncate(self._file, self._size)
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        self._size += done
        if self._failing:
            self._failing = ""
            lost, self._lost = self._lost, 0
            self._note(INFO, "audit goes on", f"file: {self.path}, lines lost: {lost}")

    def _fail(self, why: str) -> None:
        self._lost += 1
        if not self._failing:
            self._note(
                WARNING, "refusals not recorded",
                f"file: {self.path}, {why}: make room, or choose another disk (each line is tried,"
                " the agent goes on)",
            )  # fmt: skip
        self._failing = why

    def _note(self, level: int, event: str, about: str) -> None:
        server = self._server
        if server is not None:
            server.soon(lambda: server.note(level, "Audit", "write", event, about))


def _open_locked(path: str) -> int:
    """Open the file to append to it, and lock it: two agents would rename each other's file.

    Raises:
        BlockingIOError: Another agent has it.
        OSError: It cannot be opened.
    """
    file = os.open(path, _FLAGS, _MODE)
    try:
        if stat.S_ISREG(os.fstat(file).st_mode):
            lock(file)
    except BlockingIOError as error:
        os.close(file)
        raise BlockingIOError(error.errno, "another agent writes it now") from None
    return file


def check_audit_file(path: str) -> None:
    """Check what an audit file has now; it is only read.

    Raises:
        AuditError: It exists and is no audit file.
        OSError: It cannot be read.
    """
    if os.path.isfile(path):
        with open(path, "rb") as existing:
            beginning = existing.read(len(_BEGINNING))
        if beginning and beginning != _BEGINNING:
            raise AuditError(
                f"--audit {path}: it is there already and no audit file, so it is not changed:"
                " name another file, or remove that one"
            )


def _open(path: str) -> tuple[int, int]:
    """Open the file to append to it; return its descriptor and its size."""
    try:
        check_audit_file(path)
        file = _open_locked(path)
    except BlockingIOError:
        raise AuditError(
            f"--audit {path}: another agent writes it: end that one, or name another file"
        ) from None
    except (OSError, ValueError) as error:
        why = getattr(error, "strerror", None) or error
        raise AuditError(
            f"--audit {path}: {why}: name a file in a folder that exists and that you may write to"
        ) from error
    status = os.fstat(file)
    return file, status.st_size if stat.S_ISREG(status.st_mode) else 0
