"""Waits for descriptors, and says what to call for those that are ready.

On Linux it is ``select.epoll`` itself: the agent waits once or twice for each message, and
:mod:`selectors` would add a third to what a turn of its loop takes. Elsewhere it is
:mod:`selectors`.
"""

from __future__ import annotations

import array
import select
import selectors
from collections.abc import Callable
from typing import Protocol

try:
    import fcntl
    import termios
except ImportError:  # Windows
    _FIONREAD = 0
else:
    _FIONREAD = termios.FIONREAD

_octets = array.array("i", [0])


def has_input(fileno: int) -> bool:
    """Return whether a socket has something to receive, for less than a receive that finds none.

    An empty datagram does not count: a poll reports it. True where the system does not tell. With
    several threads it may be wrong, as if it had been asked a moment earlier or later.
    """
    if not _FIONREAD:
        return True
    fcntl.ioctl(fileno, _FIONREAD, _octets)
    return _octets[0] > 0


class Poller(Protocol):
    """Descriptors, each with what to call when it is ready."""

    def watch(self, fileno: int, ready: Callable[[], None], writing: bool = False) -> None:
        """Have ``ready`` returned when a descriptor can be read, or written if ``writing``.

        Both arguments replace those of an earlier call for the same descriptor.
        """

    def unwatch(self, fileno: int) -> None:
        """Forget a descriptor that is still open. Idempotent."""

    def poll(self, timeout: float | None) -> list[Callable[[], None]]:
        """Wait until a descriptor is ready, and return what to call.

        Args:
            timeout: Seconds, rounded up to milliseconds; 0 does not wait, None waits for ever.
        """

    def fileno(self) -> int | None:
        """Return a descriptor that is readable while one of these is ready; None: there is none."""

    def close(self) -> None:
        """Forget all descriptors."""


class SelectorPoller:
    """A :class:`Poller` of :mod:`selectors`."""

    def __init__(self) -> None:
        self._selector = selectors.DefaultSelector()

    def watch(self, fileno: int, ready: Callable[[], None], writing: bool = False) -> None:
        """See :class:`Poller`."""
        events = selectors.EVENT_READ | (selectors.EVENT_WRITE if writing else 0)
        known = self._selector.get_map().get(fileno)
        if known is None:
            self._selector.register(fileno, events, ready)
        elif (known.events, known.data) != (events, ready):
            self._selector.modify(fileno, events, ready)

    def unwatch(self, fileno: int) -> None:
        """See :class:`Poller`."""
        if fileno in self._selector.get_map():
            self._selector.unregister(fileno)

    def poll(self, timeout: float | None) -> list[Callable[[], None]]:
        """See :class:`Poller`."""
        return [key.data for key, _ in self._selector.select(timeout)]

    def fileno(self) -> int | None:
        """See :class:`Poller`."""
        return int(self._selector.fileno()) if hasattr(self._selector, "fileno") else None

    def close(self) -> None:
        """See :class:`Poller`."""
        self._selector.close()


class EpollPoller:
    """A :class:`Poller` of epoll."""

    def __init__(self) -> None:
        self._epoll = select.epoll()
        self._ready: dict[int, Callable[[], None]] = {}
        self._writing: set[int] = set()

    def watch(self, fileno: int, ready: Callable[[], None], writing: bool = False) -> None:
        """See :class:`Poller`."""
        events = select.EPOLLIN | (select.EPOLLOUT if writing else 0)
        if fileno not in self._ready:
            self._epoll.register(fileno, events)
        elif (fileno in self._writing) != writing:
            self._epoll.modify(fileno, events)
        self._ready[fileno] = ready
        (self._writing.add if writing else self._writing.discard)(fileno)

    def unwatch(self, fileno: int) -> None:
        """See :class:`Poller`."""
        if self._ready.pop(fileno, None) is not None:
            self._writing.discard(fileno)
            try:
                self._epoll.unregister(fileno)
            except OSError:
                pass  # it was closed before, which has unregistered it

    def poll(self, timeout: float | None) -> list[Callable[[], None]]:
        """See :class:`Poller`."""
        found, ready = self._epoll.poll(timeout), self._ready
        if len(found) == 1:  # mostly: without the call of a comprehension
            return [ready[found[0][0]]]
        return [ready[fileno] for fileno, _ in found]

    def fileno(self) -> int | None:
        """See :class:`Poller`."""
        return self._epoll.fileno()

    def close(self) -> None:
        """See :class:`Poller`."""
        self._epoll.close()
        self._ready.clear()


def create() -> Poller:
    """Return the fastest one of this system."""
    return EpollPoller() if hasattr(select, "epoll") else SelectorPoller()
