"""A file descriptor that wakes a selector from another thread."""

from __future__ import annotations

import os
import socket


class WakeupFd:
    """A descriptor that :meth:`set` makes readable and :meth:`clear` unreadable.

    It is an eventfd if the platform has one, else a socket pair. :meth:`set` may be called
    from any thread, everything else from the thread that selects.
    """

    __slots__ = ("_fd", "_pair")

    def __init__(self) -> None:
        self._pair: tuple[socket.socket, socket.socket] | None = None
        if hasattr(os, "eventfd"):
            self._fd = os.eventfd(0, os.EFD_NONBLOCK | os.EFD_CLOEXEC)
        else:
            self._pair = socket.socketpair()
            for end in self._pair:
                end.setblocking(False)
            self._fd = self._pair[0].fileno()

    def fileno(self) -> int:
        """Return the descriptor; -1 once it is closed."""
        return self._fd

    def set(self) -> None:
        """Make the descriptor readable; thread-safe."""
        try:
            if self._pair is None:
                os.eventfd_write(self._fd, 1)
            else:
                self._pair[1].send(b"\0")
        except (OSError, ValueError):
            pass  # readable already, or closed

    def clear(self) -> None:
        """Make the descriptor unreadable until the next :meth:`set`."""
        try:
            if self._pair is None:
                os.eventfd_read(self._fd)
            else:
                self._pair[0].recv(4096)
        except BlockingIOError:
            pass

    def close(self) -> None:
        """Close the descriptor; idempotent."""
        if self._pair is None:
            if self._fd >= 0:
                os.close(self._fd)
        else:
            for end in self._pair:
                end.close()
        self._fd = -1
