"""Safe and immediate handling of Ctrl-C while a program waits for DDS."""

from __future__ import annotations

import select
import signal
import socket
import threading
from collections.abc import Iterator
from contextlib import contextmanager


class Interrupt:
    """Defers KeyboardInterrupt between :meth:`hold` and :meth:`release`.

    There Ctrl-C ends :meth:`wait`, and :meth:`release` raises it. An immediate KeyboardInterrupt is
    not safe: Cyclone's binding calls Python while it takes samples, and turns the exception into
    another one or crashes. And a signal just before ``select`` would not end that call.
    """

    def __init__(self) -> None:
        self._held = False
        self._pressed = False
        self._socket: socket.socket | None = None

    @contextmanager
    def watched(self) -> Iterator[None]:
        """Install the signal handler within the block.

        It changes nothing in threads other than the main one, and in programs with a handler of
        their own.
        """
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

    def wait(self, fileno: int, seconds: float | None) -> bool:
        """Wait until a file is readable, or for a signal.

        Args:
            fileno: The file.
            seconds: The longest wait; None has no limit.

        Returns:
            Whether the file is readable.
        """
        ours = self._socket
        signals = [] if ours is None else [ours.fileno()]
        ready = select.select([fileno, *signals], [], [], seconds)[0]
        if ours is not None and signals[0] in ready:
            ours.recv(64)
        return fileno in ready

    def hold(self) -> None:
        """Defer KeyboardInterrupt until `release`."""
        self._held = True

    def release(self) -> None:
        """Raise KeyboardInterrupt if Ctrl-C was pressed since `hold`."""
        self._held = False
        if self._pressed:
            self._pressed = False
            raise KeyboardInterrupt
