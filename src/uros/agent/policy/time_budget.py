"""Time budget: how much of the one thread's time goes into creating and deleting entities.

An entity on DDS takes about a millisecond, on rclpy several. A client that creates and deletes as
fast as it can, or many that do, would make all others wait. So each client has a token bucket of
seconds, and all clients share one; a CREATE or DELETE is done while both hold tokens, and is
charged the time it took. Otherwise a reliable stream stalls until the buckets are refilled, which
the client sees as a slow agent; on a best-effort stream the request is lost.

Entities of a client that leaves are closed in slices, see :class:`DeferredCloseQueue`.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from typing import Final

from ...token_bucket import TokenBucket

# Burst in seconds and refill rate (share of the time): of one client, and of all together. The
# boards of a whole robot start within a second; others wait no longer than for a burst.
BURST_OF_ONE: Final = 0.5
SHARE_OF_ONE: Final = 0.25
BURST_OF_ALL: Final = 0.02
SHARE_OF_ALL: Final = 0.5
# How long one turn of the server closes entities of clients that left, and the pause before the
# next are closed, in seconds.
SLICE: Final = 0.01
PAUSE: Final = 0.005
# The most entities that wait to be closed, because clients may create entities and leave faster
# than the agent closes them. Beyond that, the oldest is closed for each that is added.
MAX_CLOSING: Final = 20_000


class TimeBudget:
    """The shared budget of all clients.

    Attributes:
        enabled: Set by a server, as only there somebody waits; otherwise nothing is limited.
        monotonic: The clock, in seconds.
    """

    def __init__(self, monotonic: Callable[[], float]) -> None:
        self.enabled = False
        self.monotonic = monotonic
        self.shared = TokenBucket(BURST_OF_ALL, SHARE_OF_ALL)

    def for_client(self) -> ClientTimeBudget:
        """Make the budget of one client."""
        return ClientTimeBudget(self)


class ClientTimeBudget:
    """The budget of one client; it also spends the shared one.

    ::

        if budget.start():
            try:
                create()
            finally:
                budget.charge()
    """

    __slots__ = ("_budget", "_own", "_started_at")

    def __init__(self, budget: TimeBudget) -> None:
        self._budget = budget
        self._own = TokenBucket(BURST_OF_ONE, SHARE_OF_ONE)
        self._started_at = 0.0

    def start(self) -> bool:
        """Return whether the client may create or delete now, and start to measure."""
        now = self._started_at = self._budget.monotonic()
        if not self._budget.enabled:
            return True
        return self._own.available(now) > 0 and self._budget.shared.available(now) > 0

    def charge(self) -> None:
        """Charge the time since :meth:`start`."""
        seconds = self._budget.monotonic() - self._started_at
        self._own.spend(seconds)
        self._budget.shared.spend(seconds)


class DeferredCloseQueue:
    """Entities that are still to be closed, a slice of time in each turn of the server.

    Without a server everything is closed at once.

    Attributes:
        schedule: Set by a server; asks it to call :meth:`work` soon.
        spent: The seconds that closing has taken in this turn of the server.

    Args:
        failed: Called with the error when closing raises one; the rest is closed all the same.
        monotonic: The clock, in seconds.
    """

    def __init__(
        self,
        failed: Callable[[Exception], None],
        monotonic: Callable[[], float],
    ) -> None:
        self._monotonic = monotonic
        self.schedule: Callable[[], None] | None = None
        self._failed = failed
        self._queue: deque[Callable[[], None]] = deque()
        self.spent = 0.0

    def __len__(self) -> int:
        return len(self._queue)

    def add(self, close: Callable[[], None]) -> None:
        """Close now or soon, after everything that was added before."""
        if self.schedule is None:
            self._close(close)
        elif self._queue:
            self._queue.append(close)
            if len(self._queue) > MAX_CLOSING:
                self._timed(self._queue.popleft())
        elif self.spent >= SLICE:
            self._queue.append(close)
            self.schedule()
        else:
            self._timed(close)

    def work(self) -> None:
        """Close entities for one slice of time. Called once in a turn of the server."""
        self.spent = 0.0
        while self._queue and self.spent < SLICE:
            self._timed(self._queue.popleft())
        if self._queue and self.schedule is not None:
            self.schedule()

    def begin_turn(self) -> None:
        """Note that a new turn of the server has begun."""
        if not self._queue:
            self.spent = 0.0

    def finish(self) -> None:
        """Close everything that waits, however long it takes."""
        while self._queue:
            self._close(self._queue.popleft())

    def _timed(self, close: Callable[[], None]) -> None:
        start = self._monotonic()
        self._close(close)
        self.spent += self._monotonic() - start

    def _close(self, close: Callable[[], None]) -> None:
        try:
            close()
        except Exception as error:  # of the middleware; the others must be closed all the same
            self._failed(error)
