"""``--capture FILE``: every message that passes the agent, both ways, in a file.

It has the form of :mod:`.jsonlines` or of :mod:`.pcapng`. A thread writes it, because boards must
not wait for a disk; it writes whole records, so that a file is readable whatever ends the agent.
"""

from __future__ import annotations

import contextlib
import errno
import os
import queue
import stat
import threading
import time
from typing import Final, Protocol

from ..log import Log, RateLimit, unexpected
from .jsonl import Lines
from .message_hooks import Passing, Taps
from .pcapng import MAGIC, Packets

try:
    import fcntl
except ImportError:  # Windows
    fcntl = None  # type: ignore[assignment]

# What may wait for the disk; beyond it messages are not captured. A message has its overhead.
MAX_WAITING: Final = 16 * 1024 * 1024
_OVERHEAD: Final = 300
# Written at once where so much waits.
_CHUNK: Final = 64 * 1024
# How long the end of the agent waits for the disk, in seconds, and for one that takes nothing.
_PATIENCE: Final = 5.0
_STILL: Final = 1.0
# Windows would change line ends, and elsewhere a terminal would become ours.
_NEW: Final = (
    os.O_WRONLY | os.O_CREAT | os.O_TRUNC | getattr(os, "O_NOCTTY", 0) | getattr(os, "O_BINARY", 0)
)
# What boards and nodes say to each other is nobody else's, whatever the umask.
_MODE: Final = 0o600


class CaptureError(Exception):
    """A file cannot be captured into; the text says why and what to do."""


class _Form(Protocol):
    def reset(self) -> None: ...

    def encode(self, passing: Passing, lost: int) -> bytes: ...


class Capture:
    """A tap that writes to ``path``: pcapng where that ends with ``.pcapng``, else text.

    A file that reaches ``limit`` bytes becomes ``path`` with ``.1`` behind it, and a new one is
    begun: the last two are kept. So does a capture that is there already: what an agent wrote
    before it crashed is not lost by starting it again. Where the disk is full, the capture ends
    with a warning and the agent goes on. Raises CaptureError where nothing can be written, or
    something else would be overwritten.
    """

    def __init__(self, path: str, limit: int, log: Log, taps: Taps) -> None:
        self.path = path
        self.lost = 0
        self.written = 0  # messages
        self._limit = limit
        self._log = log
        self._taps = taps
        self._form: _Form = Packets() if path.endswith(".pcapng") else Lines()
        self._lost_said = RateLimit(10.0)
        self._waiting: queue.SimpleQueue[tuple[Passing, int] | None] = queue.SimpleQueue()
        self._put = 0  # bytes, by the agent's thread
        self._taken = 0  # and by the other
        self._untold = 0  # lost since the last that was put
        self._ended = False
        self._size = 0
        self._file, self._rotates = _open(path)
        self._thread = threading.Thread(target=self._run, name="uros-capture", daemon=True)
        self._thread.start()
        taps.append(self.tap)
        log.info("Capture", "open", "capturing", f"file: {path}")

    # --- the agent's thread -----------------------------------------------------------

    def tap(self, passing: Passing) -> None:
        """Take one message. Never waits."""
        if self._ended:
            self._taps.drop(self.tap)
            return
        if self._put - self._taken > MAX_WAITING:
            self.lost += 1
            self._untold += 1
            if self._lost_said.admit("lost"):
                self._log.warning(
                    "Capture", "write", "messages not captured",
                    f"file: {self.path}, lost: {self.lost} (the disk is slower than the boards:"
                    " capture to a faster one)",
                )  # fmt: skip
            return
        self._put += len(passing.message) + _OVERHEAD
        lost, self._untold = self._untold, 0
        self._waiting.put((passing, lost))

    def close(self) -> None:
        """Write what waits, as far as the disk takes it in a few seconds."""
        self._taps.drop(self.tap)
        self._waiting.put(None)
        end = time.monotonic() + _PATIENCE
        before = -1
        while self._thread.is_alive() and time.monotonic() < end and before != self._taken:
            before = self._taken
            self._thread.join(_STILL)
        if self._thread.is_alive():
            self._log.warning(
                "Capture", "close", "capture is cut off", f"file: {self.path}, it takes no more"
            )
        about = f"file: {self.path}, messages: {self.written}"
        if self.lost:
            about += f", lost: {self.lost}"
        self._log.info("Capture", "close", "capture closed", about)

    # --- the thread that writes ----------------------------------------------------------

    def _run(self) -> None:
        try:
            while not self._ended:
                self._write_what_waits()
        except OSError as error:
            self._ended = True
            # The log takes lines of any thread; this is the only one that comes from here.
            self._log.warning(
                "Capture", "write", "capture ends",
                f"file: {self.path}, {_trouble(error)}; the {self.written} messages in it are"
                " whole, the agent goes on",
            )  # fmt: skip
        except Exception as error:  # whatever it is, boards go on
            self._ended = True
            self._log.error(
                "Capture", "write", "internal error", unexpected(error, "; the capture ends")
            )
        finally:
            if self._file >= 0:
                os.close(self._file)

    def _write_what_waits(self) -> None:
        """Sleep until there is something, and write it."""
        item = self._waiting.get()
        records: list[bytes] = []
        size = 0
        while item is not None:
            passing, lost = item
            data = self._form.encode(passing, lost)
            full = self._size + size
            if self._rotates and full and full + len(data) > self._limit:
                self._write(records)
                records, size = [], 0
                self._rotate()
                data = self._form.encode(passing, lost)
            records.append(data)
            size += len(data)
            self._taken += len(passing.message) + _OVERHEAD
            if size >= _CHUNK:
                break
            try:
                item = self._waiting.get_nowait()
            except queue.Empty:
                break
        else:
            self._ended = True
        self._write(records)

    def _write(self, records: list[bytes]) -> None:
        """All of them, or as many whole ones as there is room for, and OSError."""
        data = memoryview(b"".join(records))
        done = 0
        try:
            while done < len(data):
                done += os.write(self._file, data[done:])
        except OSError:
            for it in records:
                if done < len(it):
                    break
                done -= len(it)
                self._size += len(it)
                self.written += 1
            if self._rotates:
                os.ftruncate(self._file, self._size)
            raise
        self._size += len(data)
        self.written += len(records)

    def _rotate(self) -> None:
        file, self._file = self._file, -1
        os.close(file)  # Windows renames none that is open
        os.replace(self.path, f"{self.path}.1")
        self._file = os.open(self.path, _NEW, _MODE)
        _lock(self._file)
        self._size = 0
        self._form.reset()


def _open(path: str) -> tuple[int, bool]:
    """The descriptor of an empty file, and whether it is one that can be renamed."""
    file = -1
    try:
        for it in (path, f"{path}.1"):
            if os.path.isfile(it) and not is_capture(it):
                raise CaptureError(
                    f"--capture {path}: {it} is there already and no capture, so it is not"
                    " overwritten: name another file, or remove that one"
                )
        # A pipe that nobody reads yet must not keep the agent from starting.
        piped = os.path.exists(path) and stat.S_ISFIFO(os.stat(path).st_mode)
        if os.path.isfile(path) and os.path.getsize(path):
            _check_free(path)
            # Not where the file alone is mounted in a container: that one cannot be renamed.
            with contextlib.suppress(OSError):
                os.replace(path, f"{path}.1")
        file = os.open(path, os.O_RDWR if piped else _NEW, _MODE)
        regular = stat.S_ISREG(os.fstat(file).st_mode)
        if regular:
            _lock(file)
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


def _lock(file: int) -> None:
    """The file is ours while it is open. Raises BlockingIOError where it is another agent's."""
    try:
        if fcntl is not None:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        raise
    except OSError:
        pass  # a file system without locks


def _check_free(path: str) -> None:
    """Raises BlockingIOError where another agent captures into the file.

    A second agent that is started by mistake must not spoil it before it finds its port in use.
    """
    file = os.open(path, os.O_RDONLY)
    try:
        _lock(file)
    finally:
        os.close(file)


def is_capture(path: str) -> bool:
    """Whether a file begins as a capture, or is empty. Raises OSError."""
    with open(path, "rb") as file:
        head = file.read(512)
    return not head or head.startswith(MAGIC) or (head.startswith(b'{"t": ') and b'"from"' in head)


def _trouble(error: OSError) -> str:
    remedies = {
        errno.ENOSPC: "make room, or capture to another disk or with a smaller --capture-size",
        errno.EDQUOT: "make room, or capture to another disk or with a smaller --capture-size",
        errno.EFBIG: "raise the limit on files (ulimit -f), or choose a smaller --capture-size",
    }
    said = error.strerror or str(error)
    remedy = remedies.get(error.errno or 0, "start the agent again with another file")
    return f"{said} ({remedy})"
