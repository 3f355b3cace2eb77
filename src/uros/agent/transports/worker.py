"""Runs lines whose calls may block in threads, so that the server's thread never blocks.

Each line has two threads, and queues between them and the server's thread. A Worker runs a line
once: open, read and write, close. A line that fails gets another Worker when this one has ended, so
that ``open`` is never called while other calls are running.
"""

from __future__ import annotations

import socket
import threading
from collections import deque
from collections.abc import Callable
from typing import Any, Final, Protocol

from .base import MAX_BURST, WARNING, Host

# How long a read may block, in seconds: the delay at which the end of a line is noticed.
POLL: Final = 0.1
# Items that were read and wait to be handled; when there are so many, the line is not read.
MAX_WAITING: Final = 256
# How long one line is handled before the next, in seconds.
_TURN: Final = 0.001
# Bytes that wait to be written; further messages are lost, as on a network.
MAX_UNSENT: Final = 1024 * 1024
# Overhead of a message in bytes.
_ENTRY: Final = 64
# How long the end waits for the threads, in seconds.
LEAVE: Final = 2.0
# The pause after a read that returned nothing: without one, a read that returns at once would be
# repeated without end and use a whole processor. In seconds.
_QUIET: Final = 0.001


class Line(Protocol):
    """A line whose calls may block; any exception ends it."""

    def open(self) -> None:
        """Open the line; called first, once."""

    def read(self, timeout: float) -> Any:
        """Return received data, waiting at most so many seconds; None for nothing."""

    def write(self, data: bytes, peer: Any) -> None:
        """Send one message; called from another thread than the other methods."""

    def close(self) -> None:
        """Close the line; called last, once. A write that takes too long may still be running."""


class Worker:
    """Runs a line from open to close; the callbacks are called in the server's thread.

    Args:
        host: The server.
        name: Name for the log.
        line: The line.
        opened: Called when the line is open.
        received: Called with each item read.
        ended: Called once, last, with the exception of the line, or None.
    """

    def __init__(
        self,
        host: Host,
        name: str,
        line: Line,
        opened: Callable[[], None],
        received: Callable[[Any], None],
        ended: Callable[[BaseException | None], None],
    ) -> None:
        self._host = host
        self._name = name
        self._line = line
        self._opened = opened
        self._received = received
        self._ended = ended
        self._come: deque[Callable[[], None] | tuple[Any]] = deque()
        self._go: deque[tuple[bytes, Any]] = deque()
        self._unsent = 0
        self._change = threading.Condition()  # of _come, _go, _over
        self._over = False
        self._error: BaseException | None = None
        self._wake, self._waker = socket.socketpair()
        for end in (self._wake, self._waker):
            end.setblocking(False)
        self._reader = threading.Thread(target=self._read, name="uros-line", daemon=True)
        self._writer = threading.Thread(target=self._write, name="uros-line-out", daemon=True)
        host.watch(self._wake.fileno(), self._ready)
        self._reader.start()

    # --- the server's thread ---------------------------------------------------------------

    def send(self, data: bytes, peer: Any) -> bool:
        """Queue a message; return False if too much waits already and the message is lost."""
        with self._change:
            if self._over or self._unsent + len(data) > MAX_UNSENT:
                return False
            self._unsent += len(data) + _ENTRY
            self._go.append((data, peer))
            self._change.notify_all()
        return True

    def stop(self) -> bool:
        """Close the line, waiting up to LEAVE seconds; return whether it is closed.

        No callback is called afterwards.
        """
        if self._wake.fileno() < 0:
            return True
        self._finish(None)
        self._reader.join(LEAVE)
        self._drop_wake()
        return not self._reader.is_alive()

    def _ready(self) -> None:
        try:
            self._wake.recv(4096)
        except OSError:
            pass
        monotonic = self._host.clock.monotonic
        end = monotonic() + _TURN
        for _ in range(MAX_BURST):
            with self._change:
                if not self._come:
                    return
                item = self._come.popleft()
                if len(self._come) == MAX_WAITING - 1:
                    self._change.notify_all()
                if self._come:
                    self._poke()  # before the callback, which may raise
            if isinstance(item, tuple):
                self._received(item[0])
            else:
                item()
            if self._wake.fileno() < 0 or monotonic() >= end:
                return

    def _stuck(self) -> None:
        self._host.note(
            WARNING, self._name, "write", "write() does not return",
            "the line stays closed until it does: let close() make it return",
        )  # fmt: skip

    def _end(self) -> None:
        self._drop_wake()
        self._ended(self._error)

    def _drop_wake(self) -> None:
        self._host.unwatch(self._wake.fileno())
        self._wake.close()
        self._waker.close()

    # --- any thread ------------------------------------------------------------------------

    def _finish(self, error: BaseException | None) -> None:
        with self._change:
            self._over = True
            self._error = error if self._error is None else self._error
            self._change.notify_all()

    def _poke(self) -> None:
        try:
            self._waker.send(b"\0")
        except OSError:
            pass  # readable already, or closed

    # --- the line's threads ----------------------------------------------------------------

    def post(self, item: Callable[[], None] | tuple[Any]) -> None:
        """Call a function in the server's thread; thread-safe."""
        with self._change:
            self._come.append(item)
        self._poke()

    def _read(self) -> None:
        writing = False
        try:
            self._line.open()
            self.post(self._opened)
            self._writer.start()
            writing = True
            while not self._over:
                item = self._line.read(POLL)
                if item is None:
                    with self._change:
                        if not self._over:
                            self._change.wait(_QUIET)
                    continue
                with self._change:
                    self._change.wait_for(lambda: self._over or len(self._come) < MAX_WAITING)
                self.post((item,))
        except BaseException as error:  # a user's code: the agent continues whatever it raises
            self._finish(error)
        self._finish(None)
        if writing:
            self._writer.join(LEAVE / 2)
        try:
            self._line.close()
        except BaseException as error:  # likewise
            self._finish(error)
        if writing:
            self._writer.join(LEAVE / 2)
            if self._writer.is_alive():
                self.post(self._stuck)
                self._writer.join()
        self.post(self._end)

    def _write(self) -> None:
        while True:
            with self._change:
                self._change.wait_for(lambda: self._over or self._go)
                if self._over:
                    return
                data, peer = self._go.popleft()
            try:
                self._line.write(data, peer)
            except BaseException as error:  # likewise
                self._finish(error)
                return
            with self._change:
                self._unsent -= len(data) + _ENTRY
