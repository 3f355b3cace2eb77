"""The connection of a rover whose wheels are tuned: it sends samples and receives gains.

It serves one rover, the last that connected: a rover that was reset leaves an open connection.
"""

from __future__ import annotations

import os
import select
import socket
import threading
import time
from collections import deque
from typing import Any, Final

from ..drivers.pid_line import format_gains, parse_gains
from .samples import Sample, Samples
from .serve import Newest

HISTORY: Final = 100
# The document's rover sends messages without line ends: a pause of so many seconds ends a message.
PAUSE: Final = 0.05
_NOTES: Final = 40
_SEND_SECONDS: Final = 2.0
_SIZE: Final = 4096
# The most notes that are stored in a second, because invalid lines may arrive as a flood. The rest
# is counted.
_NOTES_A_SECOND: Final = 5


class Tuning:
    """Listens for the rover at ``host`` and ``port``, in its own thread, until `close`.

    `snapshot` and `send` may be called in any thread.

    Raises:
        OSError: The port cannot be used.
    """

    def __init__(self, host: str, port: int) -> None:
        self.newest = Newest()
        self._samples: deque[Sample] = deque(maxlen=HISTORY)
        self._notes: deque[dict[str, Any]] = deque(maxlen=_NOTES)
        self._count = 0
        self._noted = 0
        self._left_out = 0
        self._second = 0
        self._in_second = 0
        self._sent = ""
        self._name = ""
        self._rover: socket.socket | None = None
        self._sending = threading.Lock()
        family = socket.AF_INET6 if ":" in host else socket.AF_INET
        self._listener = socket.socket(family, socket.SOCK_STREAM)
        try:
            if os.name == "posix":  # on Windows it lets other programs take the port
                self._listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            self._listener.bind((host, port))
            self._listener.listen(4)
        except BaseException:
            self._listener.close()
            raise
        self._listener.setblocking(False)
        self.port: int = self._listener.getsockname()[1]
        self._wake, self._woken = socket.socketpair()
        self._thread = threading.Thread(target=self._run, name="uros-tuning", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Close the connection and stop listening."""
        self._wake.send(b"x")
        self._thread.join()
        self._drop()
        for sock in (self._listener, self._wake, self._woken):
            sock.close()

    # --- for the page and the terminal -----------------------------------------------------

    def snapshot(self, version: int = -1, seconds: float = 0.0) -> dict[str, Any]:
        """Return the page's state, for JSON, when its version is not ``version`` any more."""
        with self.newest:
            self.newest.wait(version, seconds)
            return {
                "version": self.newest.version,
                "rover": self._name,
                "port": self.port,
                "count": self._count,
                "left_out": self._left_out,
                "samples": list(self._samples),
                "sent": self._sent,
                "notes": list(self._notes),
            }

    def notes_since(self, last: int, seconds: float) -> tuple[int, list[str]]:
        """Wait for notes after number ``last``; return the number of the newest note, and them."""
        with self.newest:
            if self._noted == last:
                self.newest.wait(self.newest.version, seconds)
            fresh = [note["text"] for note in self._notes if note["number"] > last]
            return self._noted, fresh

    def send(self, line: str) -> str:
        """Send gains to the rover; return the line sent. Raises ValueError with the reason."""
        text = format_gains(parse_gains(line))
        with self._sending:
            rover = self._rover
            if rover is None:
                raise ValueError(
                    f"no rover is connected: let it connect to port {self.port} of this machine,"
                    " or reset it"
                )
            try:
                rover.sendall(f"{text}\n".encode())
            except OSError as error:
                _shut(rover)  # part of a line may be sent, and the next must not continue it
                raise ValueError(
                    f"the rover takes nothing ({error.strerror or 'timed out'}): reset it"
                ) from error
        with self.newest:
            self._sent = text
            self._note(f"sent {text}")
        return text

    # --- the thread ---------------------------------------------------------------------------

    def _run(self) -> None:
        parser = Samples()
        pending = False
        while True:
            rover = self._rover
            watched = [self._listener, self._woken, *([rover] if rover else [])]
            ready = select.select(watched, [], [], PAUSE if pending else None)[0]
            if self._woken in ready:
                return
            if self._listener in ready:
                self._accept()
                if self._rover is not rover:
                    parser, pending = Samples(), False
                    continue
            if rover is None:
                continue
            if rover in ready:
                octets = self._receive(rover)
                if octets is None:
                    self._add(parser, parser.flush())
                    self._disconnect("the rover has closed the connection")
                    continue
                self._add(parser, parser.feed(octets))
                pending = True
            else:
                self._add(parser, parser.flush())
                pending = False

    def _receive(self, rover: socket.socket) -> bytes | None:
        """Read from the rover; return None if it has disconnected."""
        try:
            return rover.recv(_SIZE) or None
        except (TimeoutError, BlockingIOError):
            return b""
        except OSError:
            return None

    def _accept(self) -> None:
        try:
            rover, address = self._listener.accept()
        except OSError:  # disconnected again
            return
        rover.settimeout(_SEND_SECONDS)
        rover.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        rover.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
        replaced = self._rover is not None
        self._drop()
        with self.newest:
            self._rover, self._name = rover, str(address[0])
            self._samples.clear()
            self._note(
                f"connected: {address[0]}{' in place of the rover before' if replaced else ''}"
            )

    def _disconnect(self, why: str) -> None:
        self._drop()
        with self.newest:
            self._note(f"{why}; waiting for it to connect again")

    def _drop(self) -> None:
        with self.newest:
            rover, self._rover, self._name = self._rover, None, ""
        if rover is not None:
            _shut(rover)  # ends a blocked send
            with self._sending:
                rover.close()

    def _add(self, parser: Samples, samples: list[Sample]) -> None:
        notes, faults = parser.notes[:], parser.faults
        parser.notes.clear()
        parser.faults = 0
        if not samples and not notes and not faults:
            return
        with self.newest:
            self._samples.extend(samples)
            self._count += len(samples)
            self._left_out += faults
            for text in notes:
                self._note(text, limited=True)
            self.newest.change()

    def _note(self, text: str, limited: bool = False) -> None:
        """Add a note; called within ``with self.newest``."""
        second = int(time.monotonic())
        if second != self._second:
            self._second, self._in_second = second, 0
        if limited:
            self._in_second += 1
            if self._in_second > _NOTES_A_SECOND:
                return
        self._noted += 1
        self._notes.append({"number": self._noted, "at": time.time(), "text": text})
        self.newest.change()


def _shut(rover: socket.socket) -> None:
    try:
        rover.shutdown(socket.SHUT_RDWR)
    except OSError:
        pass
