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

    Between them Ctrl-C ends :meth:`wait`, and :meth:`release` raises KeyboardInterrupt. An
    immediate KeyboardInterrupt is not safe: Cyclone's binding calls Python while it takes samples,
    and replaces the exception by a different one or crashes. And a signal just before ``select``
    would not end that call.
    """

    def __init__(self) -> None:
        self._held = False
        self._pressed = False
        self._socket: socket.socket | None = None

    @contextmanager
    def watched(self) -> Iterator[None]:
        """Install the signal handler within the block.

        It has no effect outside the main thread, and in programs with their own handler.
        """
        if (
            threading.current_thread() is not threading.main_thread()
            or signal.getsignal(signal.SIGINT) is not signal.default_int_handler
        ):
            yield
            return
        self._socket, wakeup = socket.socketpair()
        self._socket.setblocking(False)
        wakeup.setblocking(False)
        before = signal.set_wakeup_fd(wakeup.fileno(), warn_on_full_buffer=False)
        signal.signal(signal.SIGINT, self._on_signal)
        try:
            yield
        finally:
            signal.signal(signal.SIGINT, signal.default_int_handler)
            signal.set_wakeup_fd(before)
            self._socket.close()
            self._socket = None
            wakeup.close()

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
        receiver = self._socket
        signals = [] if receiver is None else [receiver.fileno()]
        ready = select.select([fileno, *signals], [], [], seconds)[0]
        if receiver is not None and signals[0] in ready:
            receiver.recv(64)
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
