"""``--capture FILE``: every message that passes the agent, both ways, in a file.

The file has the format of :mod:`.jsonl` or of :mod:`.pcapng`. A thread writes it, because boards
must not wait for a disk; it writes whole records, so that a file is readable however the agent
ends.
"""

from __future__ import annotations

import contextlib
import errno
import os
import queue
import stat
import threading
from typing import Final, NamedTuple, Protocol

from ...file_lock import lock
from ..log import Log, RateLimit, unexpected
from .jsonl import JsonLinesEncoder
from .message_hooks import MessageEvent, MessageHooks
from .pcapng import MAGIC, PcapngEncoder

# Bytes that may wait for the disk, with the overhead of each message; further messages are not
# captured.
MAX_WAITING: Final = 16 * 1024 * 1024
_OVERHEAD: Final = 300
# The messages that wait are written at once when they have so many bytes.
_CHUNK: Final = 64 * 1024
# How long nothing is written after the disk was full, by the times of messages, in seconds.
RETRY_SECONDS: Final = 5.0
# Errors that end by themselves.
_TEMPORARY: Final = (errno.ENOSPC, errno.EDQUOT)
# Closing waits so many seconds at a time, until the disk has taken nothing meanwhile, and at most
# so many times.
_STILL: Final = 1.0
_JOINS: Final = 5
# Windows would change line ends; elsewhere a terminal would become our controlling terminal.
_NEW: Final = (
    os.O_WRONLY | os.O_CREAT | os.O_TRUNC | getattr(os, "O_NOCTTY", 0) | getattr(os, "O_BINARY", 0)
)
# Messages of boards and nodes are private, whatever the umask.
_MODE: Final = 0o600


class CaptureError(Exception):
    """The capture file cannot be used; the text says why and what to do."""


class _Encoder(Protocol):
    def reset(self) -> None: ...

    def encode(self, event: MessageEvent, lost: int) -> bytes: ...


class _Record(NamedTuple):
    """A message as it will be in the file, and how many messages it accounts for."""

    data: bytes
    messages: int


class Capture:
    """A message hook that writes a capture file.

    A file that reaches its limit is renamed to ``path`` with ``.1`` appended, and a new one is
    begun: the last two are kept. A capture that exists already is renamed in the same way, so that
    what an agent wrote before it crashed is not lost by starting it again.

    While the disk is full, messages are not captured. A warning says so once; it is tried again
    every :data:`RETRY_SECONDS`, and the next message in the file has the number of those that are
    missing before it. Other errors end the capture with a warning. The agent continues.

    Args:
        path: The file; pcapng if its name ends with ``.pcapng``, else JSON lines.
        limit: Its size in bytes at which the next file is begun.
        log: The agent's log.
        message_hooks: The agent's hooks, to which this one is added.

    Raises:
        CaptureError: The file cannot be written, or it exists and is no capture.
    """

    def __init__(self, path: str, limit: int, log: Log, message_hooks: MessageHooks) -> None:
        self.path = path
        self.lost = 0
        self.written = 0  # messages
        self._limit = limit
        self._log = log
        self._message_hooks = message_hooks
        pcapng = path.endswith(".pcapng")
        self._encoder: _Encoder = PcapngEncoder() if pcapng else JsonLinesEncoder()
        self._lost_lines = RateLimit(10.0)
        self._waiting: queue.SimpleQueue[tuple[MessageEvent, int] | None] = queue.SimpleQueue()
        self._put = 0  # bytes queued, counted by the agent's thread
        self._taken = 0  # bytes written, counted by the writing thread
        self._unreported = 0  # lost since the last one that was queued
        self._ended = False
        self._paused = ""  # why nothing is written now
        # Times of messages: of the last one, and of the one that the disk did not take.
        self._handled = self._failed_at = 0
        self._missed = 0  # messages not written since the last one that was
        self._size = 0
        self._file, self._rotates = _open(path)
        self._thread = threading.Thread(target=self._run, name="uros-capture", daemon=True)
        self._thread.start()
        message_hooks.append(self.record)
        log.info("Capture", "open", "capturing", f"file: {path}")

    def trouble(self) -> str:
        """Return why messages are not captured now; "" if they are."""
        return f"nothing is captured into {self.path}: {self._paused}" if self._paused else ""

    # --- the agent's thread -----------------------------------------------------------

    def record(self, event: MessageEvent) -> None:
        """Queue one message for the thread; never blocks."""
        if self._ended:
            self._message_hooks.discard(self.record)
            return
        if self._put - self._taken > MAX_WAITING:
            self.lost += 1
            self._unreported += 1
            if self._lost_lines.admit("lost"):
                self._log.warning(
                    "Capture", "write", "messages not captured",
                    f"file: {self.path}, lost: {self.lost} (the disk is slower than the boards:"
                    " capture to a faster one)",
                )  # fmt: skip
            return
        self._put += len(event.message) + _OVERHEAD
        lost, self._unreported = self._unreported, 0
        self._waiting.put((event, lost))

    def close(self) -> None:
        """Write the queued messages, as far as the disk takes them within a few seconds."""
        self._message_hooks.discard(self.record)
        self._waiting.put(None)
        before = -1
        for _ in range(_JOINS):
            if not self._thread.is_alive() or before == self._taken:
                break
            before = self._taken
            self._thread.join(_STILL)
        if self._thread.is_alive():
            self._log.warning(
                "Capture", "close", "capture is cut off", f"file: {self.path}, it takes no more"
            )
        about = f"file: {self.path}, messages: {self.written}"
        if lost := self.lost + self._missed:
            about += f", lost: {lost}"
        self._log.info("Capture", "close", "capture closed", about)

    # --- the thread that writes ----------------------------------------------------------

    def _run(self) -> None:
        try:
            while not self._ended:
                try:
                    self._write_what_waits()
                except OSError as error:
                    if error.errno not in _TEMPORARY:
                        raise
                    self._pause(error)
        except OSError as error:
            self._ended = True
            self._paused = error.strerror or str(error)
            # The log is thread-safe.
            self._log.warning(
                "Capture", "write", "capture ends",
                f"file: {self.path}, {_trouble(error)}; the {self.written} messages in it are"
                " whole, the agent goes on",
            )  # fmt: skip
        except Exception as error:  # whatever it is, boards are served
            self._ended = True
            self._paused = type(error).__name__
            self._log.error(
                "Capture", "write", "internal error", unexpected(error, "; the capture ends")
            )
        finally:
            if self._file >= 0:
                os.close(self._file)

    def _pause(self, error: OSError) -> None:
        """Write nothing for some seconds; say so unless the last attempt failed too."""
        self._encoder.reset()  # what it has told of transports may not be in the file
        self._failed_at = self._handled
        if not self._paused:
            self._log.warning(
                "Capture", "write", "capture pauses",
                f"file: {self.path}, {_trouble(error)}; it is tried again every"
                f" {RETRY_SECONDS:.0f} s, the agent goes on",
            )  # fmt: skip
        self._paused = error.strerror or str(error)

    def _write_what_waits(self) -> None:
        """Wait for messages and write them."""
        item = self._waiting.get()
        records: list[_Record] = []
        size = 0
        while item is not None:
            event, lost = item
            self._taken += len(event.message) + _OVERHEAD
            self._handled = event.now
            self._missed += lost + 1  # until the record is written
            if not self._paused or abs(event.now - self._failed_at) >= RETRY_SECONDS * 1_000_000:
                count = self._missed
                data = self._encoder.encode(event, count - 1)
                full = self._size + size
                if self._rotates and full and full + len(data) > self._limit:
                    self._write(records)
                    records, size = [], 0
                    self._rotate()
                    data = self._encoder.encode(event, count - 1)
                records.append(_Record(data, count))
                self._missed = 0
                size += len(data)
            if size >= _CHUNK:
                break
            try:
                item = self._waiting.get_nowait()
            except queue.Empty:
                break
        else:
            self._ended = True
        self._write(records)

    def _write(self, records: list[_Record]) -> None:
        """Write all records, or as many whole ones as there is room for, and raise OSError."""
        if not records:
            return
        data = memoryview(b"".join(record.data for record in records))
        done = 0
        try:
            if self._file < 0:
                self._begin()
            while done < len(data):
                done += os.write(self._file, data[done:])
        except OSError:
            remaining = list(records)
            while remaining and done >= len(remaining[0].data):
                record = remaining.pop(0)
                done -= len(record.data)
                self._size += len(record.data)
                self.written += 1
            self._missed += sum(record.messages for record in remaining)
            if self._rotates and self._file >= 0:
                os.ftruncate(self._file, self._size)
                os.lseek(self._file, self._size, os.SEEK_SET)
            raise
        self._size += len(data)
        self.written += len(records)
        if self._paused:
            self._paused = ""
            self._log.info(
                "Capture", "write", "capture goes on",
                f"file: {self.path}, messages not captured: {records[0].messages - 1}",
            )  # fmt: skip

    def _rotate(self) -> None:
        file, self._file = self._file, -1
        if file >= 0:
            os.close(file)  # Windows renames none that is open
            os.replace(self.path, f"{self.path}.1")
        self._begin()
        self._encoder.reset()

    def _begin(self) -> None:
        """Begin a file; raises OSError."""
        self._file = os.open(self.path, _NEW, _MODE)
        lock(self._file)
        self._size = 0


def _open(path: str) -> tuple[int, bool]:
    """Open an empty file; return its descriptor, and whether it can be renamed."""
    file = -1
    try:
        check_capture_file(path)
        # A pipe that nobody reads yet must not keep the agent from starting.
        piped = os.path.exists(path) and stat.S_ISFIFO(os.stat(path).st_mode)
        if os.path.isfile(path) and os.path.getsize(path):
            _check_free(path)
            # Fails if only the file is mounted in a container: such a file cannot be renamed.
            with contextlib.suppress(OSError):
                os.replace(path, f"{path}.1")
        file = os.open(path, os.O_RDWR if piped else _NEW, _MODE)
        regular = stat.S_ISREG(os.fstat(file).st_mode)
        if regular:
            lock(file)
    except BlockingIOError:
        if file >= 0:
            os.close(file)
        raise CaptureError(
            f"--capture {path}: another agent captures into it: end that one, or name another file"
        ) from None
    except (OSError, ValueError) as error:
        raise CaptureError(
            f"--capture {path}: {getattr(error, 'strerror', None) or error}: name a file in a"
            " folder that exists and that you may write to"
        ) from error
    return file, regular


def check_capture_file(path: str) -> None:
    """Check that a capture overwrites nothing else; the files are only read.

    Raises:
        CaptureError: The file, or the one that it is renamed to, exists and is no capture.
        OSError: It cannot be read.
    """
    for name in (path, f"{path}.1"):
        if os.path.isfile(name) and not is_capture(name):
            raise CaptureError(
                f"--capture {path}: {name} is there already and no capture, so it is not"
                " overwritten: name another file, or remove that one"
            )


def _check_free(path: str) -> None:
    """Raise BlockingIOError if another agent captures into the file.

    A second agent that is started by mistake must not spoil it before it finds its port in use.
    """
    file = os.open(path, os.O_RDONLY)
    try:
        lock(file)
    finally:
        os.close(file)


def is_capture(path: str) -> bool:
    """Return whether a file begins like a capture, or is empty; raises OSError."""
    with open(path, "rb") as file:
        head = file.read(512)
    return not head or head.startswith(MAGIC) or (head.startswith(b'{"t": ') and b'"from"' in head)


def _trouble(error: OSError) -> str:
    remedies = {
        errno.ENOSPC: "make room, or capture to another disk or with a smaller --capture-size",
        errno.EDQUOT: "make room, or capture to another disk or with a smaller --capture-size",
        errno.EFBIG: "raise the limit on files (ulimit -f), or choose a smaller --capture-size",
    }
    reason = error.strerror or str(error)
    remedy = remedies.get(error.errno or 0, "start the agent again with another file")
    return f"{reason} ({remedy})"
