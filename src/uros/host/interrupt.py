"""Ctrl-C that neither goes astray nor comes late while a program waits for DDS."""

from __future__ import annotations

import signal
import socket
import threading
from collections.abc import Iterator
from contextlib import contextmanager


class Interrupt:
    """Ctrl-C is a KeyboardInterrupt as ever, but not between :meth:`hold` and :meth:`release`.

    There it wakes who waits for :meth:`filenos`, and is raised by :meth:`release`. Python's own
    way would be too early, for Cyclone's binding calls Python while it takes samples and makes
    another error of it, or too late: what comes just before ``select`` does not end that.
    """

    def __init__(self) -> None:
        self._held = False
        self._pressed = False
        self._socket: socket.socket | None = None

    @contextmanager
    def watched(self) -> Iterator[None]:
        """So it is within the block. It changes nothing in threads other than the main one, and
        in programs with a handler of their own."""
        if (
            threading.current_thread() is not threading.main_thread()
            or signal.getsignal(signal.SIGINT) is not signal.default_int_handler
        ):
            yield
            return
        self._socket, theirs = socket.socketpair()
        self._socket.setblocking(False)
        theirs.setblocking(False)
        before = signal.set_wakeup_fd(theirs.fileno(), warn_on_full_buffer=False)
        signal.signal(signal.SIGINT, self._on_signal)
        try:
            yield
        finally:
            signal.signal(signal.SIGINT, signal.default_int_handler)
            signal.set_wakeup_fd(before)
            self._socket.close()
            self._socket = None
            theirs.close()

    def _on_signal(self, number: int, frame: object) -> None:
        if not self._held:
            raise KeyboardInterrupt
        self._pressed = True

    def filenos(self) -> list[int]:
        """What becomes readable by a signal."""
        return [self._socket.fileno()] if self._socket is not None else []

    def clear(self) -> None:
        """Make it unreadable."""
        if self._socket is not None:
            self._socket.recv(64)

    def hold(self) -> None:
        self._held = True

    def release(self) -> None:
        """Raises KeyboardInterrupt if Ctrl-C was pressed meanwhile."""
        self._held = False
        if self._pressed:
            self._pressed = False
            raise KeyboardInterrupt
