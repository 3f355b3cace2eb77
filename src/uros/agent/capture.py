"""``--capture FILE``: every message that passes the agent, both ways, in a file.

The text form has one JSON line a message, as the recordings of C++ agents in ``tests/captures``
have, and says more::

    {"t": 1763750000.123456, "from": "client", "client": 0, "transport": "UDPv4Agent",
     "address": "192.0.2.7:2018", "key": "0x4B0CBE99", "hex": "8180..."}

``t`` is in seconds since 1970, ``client`` counts the addresses. The other form is
:mod:`.pcapng`. A thread writes them, because boards must not wait for a disk; it writes whole
records, so that a file is readable whatever ends the agent.
"""

from __future__ import annotations

import errno
import json
import os
import queue
import stat
import threading
from typing import Final, Protocol

from ..transport.base import ServerTransport
from .log import Log, RateLimit
from .pcapng import MAGIC, Packets
from .taps import Passing, Taps

# What may wait for the disk; beyond it messages are not captured. A message has its overhead.
MAX_WAITING: Final = 16 * 1024 * 1024
_OVERHEAD: Final = 300
# Written at once where so much waits.
_CHUNK: Final = 64 * 1024
# Attack: messages from one address after the other; their numbers start anew then.
_MAX_CLIENTS: Final = 65536
# How long the end of the agent waits for the disk, in seconds.
_PATIENCE: Final = 5.0
# Windows would change line ends, and elsewhere a terminal would become ours.
_NEW: Final = (
    os.O_WRONLY | os.O_CREAT | os.O_TRUNC | getattr(os, "O_NOCTTY", 0) | getattr(os, "O_BINARY", 0)
)


class CaptureError(Exception):
    """A file cannot be captured into; the text says why and what to do."""


class _Form(Protocol):
    def reset(self) -> None: ...

    def encode(self, passing: Passing, lost: int) -> bytes: ...


class Lines:
    """Makes the lines of the text form."""

    def __init__(self) -> None:
        # What the lines of a place have in common.
        self._places: dict[tuple[ServerTransport, str], str] = {}

    def reset(self) -> None:
        """Clients keep their numbers in the file that follows."""

    def encode(self, passing: Passing, lost: int) -> bytes:
        """The line of a message; ``lost``: how many before it are not in the file."""
        transport, _, direction, message, now, key = passing
        address = transport.address(passing.peer)
        where = self._places.get((transport, address))
        if where is None:
            if len(self._places) >= _MAX_CLIENTS:
                self._places.clear()
            where = f'{len(self._places)}, "transport": {json.dumps(transport.name)}'
            where += f', "address": {json.dumps(address)}'
            self._places[transport, address] = where
        named = f', "key": "0x{key:08X}"' if key else ""
        missing = f', "lost": {lost}' if lost else ""
        return (
            f'{{"t": {now // 1_000_000}.{now % 1_000_000:06d}, "from": "{direction}", "client":'
            f' {where}{named}{missing}, "hex": "{message.hex()}"}}\n'
        ).encode()


class Capture:
    """A tap that writes to ``path``: pcapng where that ends with ``.pcapng``, else text.

    A file that reaches ``limit`` bytes becomes ``path`` with ``.1`` behind it, and a new one is
    begun: the last two are kept. Where the disk is full, the capture ends with a warning and the
    agent goes on. Raises CaptureError where nothing can be written, or something else would be
    overwritten.
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
        self._thread.join(_PATIENCE)
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
                "Capture", "write", "internal error",
                f"{type(error).__name__}: {error}; the capture ends"
                " (this is a fault of uros: please report it)",
            )  # fmt: skip
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
        self._file = os.open(self.path, _NEW, 0o666)
        self._size = 0
        self._form.reset()


def _open(path: str) -> tuple[int, bool]:
    """The descriptor of an empty file, and whether it is one that can be renamed."""
    try:
        for it in (path, f"{path}.1"):
            if os.path.isfile(it) and not is_capture(it):
                raise CaptureError(
                    f"--capture {path}: {it} is there already and no capture, so it is not"
                    " overwritten: name another file, or remove that one"
                )
        # A pipe that nobody reads yet must not keep the agent from starting.
        piped = os.path.exists(path) and stat.S_ISFIFO(os.stat(path).st_mode)
        file = os.open(path, os.O_RDWR if piped else _NEW, 0o666)
        regular = stat.S_ISREG(os.fstat(file).st_mode)
        if regular and os.path.isfile(f"{path}.1"):
            os.remove(f"{path}.1")
    except (OSError, ValueError) as error:
        raise CaptureError(
            f"--capture {path}: {getattr(error, 'strerror', None) or error}: name a file in a"
            " folder that exists and that you may write to"
        ) from error
    return file, regular


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
