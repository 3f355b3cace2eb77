"""Safe and immediate handling of the signals that stop a program while it waits for DDS."""

from __future__ import annotations

import select
import signal
import socket
from collections.abc import Iterator
from contextlib import contextmanager

from .stop_signals import stop, stop_signals


class Interrupt:
    """Defers the end of a program between :meth:`hold` and :meth:`release`.

    Between them Ctrl-C ends :meth:`wait`, and :meth:`release` raises KeyboardInterrupt; SIGTERM and
    SIGHUP do the same with :class:`Terminated`. An immediate exception is not safe: Cyclone's
    binding calls Python while it takes samples, and replaces the exception by a different one or
    crashes. And a signal just before ``select`` would not end that call.
    """

    def __init__(self) -> None:
        self._held = False
        self._came = 0  # the first signal since `hold`
        self._socket: socket.socket | None = None

    @contextmanager
    def watched(self) -> Iterator[None]:
        """Handle the signals within the block, as :func:`stop_signals` does."""
        with stop_signals(self._on_signal) as handled:
            if not handled:
                yield
                return
            self._socket, wakeup = socket.socketpair()
            self._socket.setblocking(False)
            wakeup.setblocking(False)
            before = signal.set_wakeup_fd(wakeup.fileno(), warn_on_full_buffer=False)
            try:
                yield
            finally:
                signal.set_wakeup_fd(before)
                self._socket.close()
                self._socket = None
                wakeup.close()

    def _on_signal(self, number: int, frame: object) -> None:
        if not self._held:
            stop(number, frame)
        self._came = self._came or number

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
        """Defer the end of the program until `release`."""
        self._held = True

    def release(self) -> None:
        """Raise KeyboardInterrupt or :class:`Terminated` if a signal came since `hold`."""
        self._held = False
        if self._came:
            number, self._came = self._came, 0
            stop(number, None)
