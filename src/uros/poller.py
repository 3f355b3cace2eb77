"""Waits for descriptors, and says what to call for those that are ready.

On Linux it is ``select.epoll`` itself: the agent waits once or twice for each message, and
:mod:`selectors` would add a third to what a turn of its loop takes. Elsewhere it is
:mod:`selectors`.
"""

from __future__ import annotations

import array
import math
import os
import select
import selectors
import socket
import threading
from collections.abc import Callable
from typing import Any, Final, Protocol

try:
    import fcntl
    import termios
except ImportError:  # Windows
    _FIONREAD = 0
else:
    _FIONREAD = termios.FIONREAD

_octets = array.array("i", [0])

# Seconds to poll for. A board on the same host answers within half of it.
BUSY_WINDOW: Final = 50e-6
# The credit that answers in time earn, and what a late one costs: polling goes on if at least four
# of five answers come in time.
_MOST_CREDIT: Final = 8
_LATE: Final = 4
# How many samples are not polled for after the credit is used up.
BUSY_PAUSE: Final = 256
_CLOCK_MONOTONIC: Final = 1
# The most seconds that a DeadlineTimer is set to: it looks at a farther deadline again then.
_FARTHEST: Final = 86_400.0


def has_input(fileno: int) -> bool:
    """Return whether a socket has something to receive, for less than a receive that finds none.

    An empty datagram does not count: a poll reports it. True where the system does not tell. If
    several threads ask at once, one may get the answer for another's socket.
    """
    if not _FIONREAD:
        return True
    try:
        fcntl.ioctl(fileno, _FIONREAD, _octets)
    except (OSError, ValueError):  # it was closed: the receive says so
        return True
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

    def fileno(self) -> int:
        """Return a descriptor that is readable while one of these is ready.

        It may stay readable until a :meth:`poll` finds nothing.
        """

    def rearm(self) -> None:
        """Clear the descriptor of :meth:`fileno`, and wait again.

        Call it after handling events without :meth:`poll`.
        """

    def close(self) -> None:
        """Forget all descriptors."""


class SelectThread:
    """A descriptor that is readable while others are ready, where the system makes none of them.

    A thread waits by ``select``. Once something is ready it does not select again until
    :meth:`rearm`, so that it does not report the same event twice.

    Attributes:
        watched: The descriptors to be read and to be written; :meth:`changed` has it use them.
    """

    def __init__(self) -> None:
        self.watched: tuple[list[int], list[int]] = [], []
        # Readable when the thread is to look at `watched` again.
        self._change_received, self._change_sent = _pair()
        self._ready_received, self._ready_sent = _pair()  # readable: something is ready
        self._waits = threading.Event()
        self._closed = False
        self._thread = threading.Thread(target=self._run, name="uros select", daemon=True)
        self._thread.start()

    def fileno(self) -> int:
        """Return the descriptor."""
        return self._ready_received.fileno()

    def changed(self) -> None:
        """Wait for other descriptors."""
        _set(self._change_sent)
        self._waits.set()

    def rearm(self) -> None:
        """Make the descriptor unreadable until something is ready."""
        _clear(self._ready_received)
        self._waits.set()

    def _run(self) -> None:
        change = self._change_received.fileno()
        while True:
            self._waits.wait()
            self._waits.clear()
            while not self._closed:
                reading, writing = self.watched
                try:
                    found, _, _ = select.select([change, *reading], writing, [])
                except (OSError, ValueError):  # one was closed: the next poll says so
                    break
                if change not in found:
                    break
                _clear(self._change_received)
            if self._closed:
                return
            _set(self._ready_sent)

    def close(self) -> None:
        """End the thread."""
        self._closed = True
        self.changed()
        self._thread.join()
        for ends in (
            (self._change_received, self._change_sent),
            (self._ready_received, self._ready_sent),
        ):
            for end in ends:
                end.close()


def _pair() -> tuple[socket.socket, socket.socket]:
    """Two sockets: what is sent by the second makes the first one readable."""
    ends = socket.socketpair()
    for end in ends:
        end.setblocking(False)
    return ends


def _set(end: socket.socket) -> None:
    try:
        end.send(b"\0")
    except BlockingIOError:
        pass  # it is set


def _clear(end: socket.socket) -> None:
    try:
        while end.recv(4096):
            pass
    except BlockingIOError:
        pass


class SelectorPoller:
    """A :class:`Poller` of :mod:`selectors`.

    Args:
        selector: By default the best one of this system.
    """

    def __init__(self, selector: selectors.BaseSelector | None = None) -> None:
        self._selector = selectors.DefaultSelector() if selector is None else selector
        self._thread: SelectThread | None = None

    def watch(self, fileno: int, ready: Callable[[], None], writing: bool = False) -> None:
        """See :class:`Poller`."""
        events = selectors.EVENT_READ | (selectors.EVENT_WRITE if writing else 0)
        known = self._selector.get_map().get(fileno)
        if known is None:
            self._selector.register(fileno, events, ready)
        elif (known.events, known.data) != (events, ready):
            self._selector.modify(fileno, events, ready)
        else:
            return
        self._changed()

    def unwatch(self, fileno: int) -> None:
        """See :class:`Poller`."""
        if fileno in self._selector.get_map():
            self._selector.unregister(fileno)
            self._changed()

    def _changed(self) -> None:
        if self._thread is not None:
            keys = list(self._selector.get_map().values())
            self._thread.watched = (
                [key.fd for key in keys if key.events & selectors.EVENT_READ],
                [key.fd for key in keys if key.events & selectors.EVENT_WRITE],
            )
            self._thread.changed()

    def poll(self, timeout: float | None) -> list[Callable[[], None]]:
        """See :class:`Poller`."""
        ready = [key.data for key, _ in self._selector.select(timeout)]
        if not ready:
            self.rearm()
        return ready

    def fileno(self) -> int:
        """See :class:`Poller`; with ``select``, as on Windows, there is a thread from then on."""
        if hasattr(self._selector, "fileno"):
            return int(self._selector.fileno())
        if self._thread is None:
            self._thread = SelectThread()
            self._changed()
        return self._thread.fileno()

    def rearm(self) -> None:
        """See :class:`Poller`."""
        if self._thread is not None:
            self._thread.rearm()

    def close(self) -> None:
        """See :class:`Poller`."""
        if self._thread is not None:
            self._thread.close()
            self._thread = None
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

    def fileno(self) -> int:
        """See :class:`Poller`."""
        return self._epoll.fileno()

    def rearm(self) -> None:
        """See :class:`Poller`."""

    def close(self) -> None:
        """See :class:`Poller`."""
        self._epoll.close()
        self._ready.clear()


class BusyPoll:
    """Waits, and polls without sleeping for a moment after a board got a sample.

    To wake a sleeping core takes about as long as to handle a message. In a closed loop on one
    host, such as a virtual board and its controller, that would be paid in each round. It polls
    only while boards answer at once, so publishers and an idle agent cost nothing more.

    Attributes:
        expects: Whether an answer is expected. If not, :meth:`poll` does nothing but call the
            argument ``poll``.

    Args:
        poll: Waits like :meth:`Poller.poll`.
        monotonic: The clock, in seconds.
    """

    def __init__(
        self,
        poll: Callable[[float | None], list[Callable[[], None]]],
        monotonic: Callable[[], float],
    ) -> None:
        self._poll = poll
        self._monotonic = monotonic
        self.expects = False
        self._credit = 0
        self._pause = 0

    def expect_answer(self) -> None:
        """Note that a board got a sample, which it may answer."""
        if self._pause:
            self._pause -= 1
        else:
            self.expects = True

    def poll(self, timeout: float | None) -> list[Callable[[], None]]:
        """Wait until a descriptor is ready, and return what to call.

        Args:
            timeout: In seconds, as for :meth:`Poller.poll`.
        """
        if self.expects:
            self.expects = False
            if timeout is None or timeout > BUSY_WINDOW:
                until = self._monotonic() + BUSY_WINDOW
                while not (ready := self._poll(0)):
                    if self._monotonic() >= until:
                        return self._late(timeout)
                self._credit = min(self._credit + 1, _MOST_CREDIT)
                return ready
        return self._poll(timeout)

    def _late(self, timeout: float | None) -> list[Callable[[], None]]:
        self._credit -= _LATE
        if self._credit < 0:
            self._credit = 0
            self._pause = BUSY_PAUSE
        return self._poll(timeout if timeout is None else timeout - BUSY_WINDOW)


class DeadlineTimer:
    """A descriptor that is readable from a deadline on, where the system has timerfds.

    A poll with a timeout has the kernel set a timer and take it back, a twentieth of what a turn
    with one message takes. A deadline stays the same for many turns: a timerfd is set to it once.

    Attributes:
        fd: The descriptor; -1 without one.
        at: The deadline that it is set to, in seconds of the clock; infinity: none.

    Args:
        monotonic: The clock.
    """

    def __init__(self, monotonic: Callable[[], float]) -> None:
        self.at = math.inf
        self._monotonic = monotonic
        self.fd, self._set = _timerfd()

    def wait_until(self, deadline: float) -> float | None:
        """Set the timer; return the timeout for the next poll, None where the timer ends it."""
        left = deadline - self._monotonic()
        if left <= 0:
            return 0.0
        if self.fd < 0 or not self._set(min(left, _FARTHEST)):
            return left
        self.at = deadline
        return None

    def clear(self) -> None:
        """Make the descriptor unreadable until the next deadline."""
        try:
            os.read(self.fd, 8)
        except BlockingIOError:
            pass
        self.at = math.inf

    def close(self) -> None:
        """Close the descriptor; idempotent."""
        if self.fd >= 0:
            os.close(self.fd)
            self.fd = -1


def _timerfd() -> tuple[int, Callable[[float], bool]]:
    """Return a timerfd, -1 where there is none, and what sets it to so many seconds from now."""
    try:
        import ctypes

        library: Any = ctypes.CDLL(None)
        create, settime = library.timerfd_create, library.timerfd_settime
    except (ImportError, OSError, AttributeError, TypeError):  # macOS, Windows
        return -1, lambda seconds: False
    fd = create(_CLOCK_MONOTONIC, os.O_NONBLOCK | os.O_CLOEXEC)
    when = (ctypes.c_long * 4)()  # period and first time, each in seconds and nanoseconds

    def set_to(seconds: float) -> bool:
        whole = int(seconds)
        when[2] = whole
        when[3] = max(1, int((seconds - whole) * 1e9))  # 0 and 0 would stop it
        return bool(settime(fd, 0, when, None) == 0)

    return fd, set_to


def create() -> Poller:
    """Return the fastest one of this system."""
    return EpollPoller() if hasattr(select, "epoll") else SelectorPoller()
