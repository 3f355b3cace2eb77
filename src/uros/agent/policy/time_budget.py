"""How much of the one thread's time goes into creating and deleting.

An entity on DDS takes about a millisecond, on rclpy several. A client that makes and deletes as
fast as it can, or many that do, would make all others wait. So each client has an account of time,
and all have one together; a CREATE or DELETE is done while both are in credit, and costs what it
took. After that a reliable stream stalls until there is credit again, which the client sees as a
slow agent; on a best-effort stream the request is lost.

Entities of a client that leaves are closed a slice at a time.
"""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable
from typing import Final

# What may be spent at once, and the part of the time that comes in again: of one client, and of
# all. The boards of a whole robot start within the second; others wait no longer than for a burst.
BURST_OF_ONE: Final = 0.5
SHARE_OF_ONE: Final = 0.25
BURST_OF_ALL: Final = 0.02
SHARE_OF_ALL: Final = 0.5
# How long a turn closes what clients have left behind, and how soon it goes on, in seconds.
SLICE: Final = 0.01
PAUSE: Final = 0.005
# Attack: clients that come, create and leave faster than is closed: then each pays for one.
MAX_CLOSING: Final = 20_000


class Bucket:
    """Seconds to spend: ``burst`` at most, ``share`` of the time comes in."""

    __slots__ = ("_at", "_burst", "_level", "_share")

    def __init__(self, burst: float, share: float) -> None:
        self._burst = burst
        self._share = share
        self._level = burst
        self._at = 0.0

    def credit(self, now: float) -> bool:
        """Whether there is something to spend."""
        self._level = min(self._burst, self._level + max(0.0, now - self._at) * self._share)
        self._at = now
        return self._level > 0

    def spend(self, seconds: float) -> None:
        """It may be more than there was: the debt is waited for. But not for ever."""
        self._level = max(-self._burst, self._level - seconds)


class Pace:
    """The accounts of all; ``on`` is set by a server, as only there somebody waits."""

    def __init__(self) -> None:
        self.on = False
        self._all = Bucket(BURST_OF_ALL, SHARE_OF_ALL)

    def account(self) -> Account:
        """Of one client."""
        return Account(self, self._all)


class Account:
    """Of one client::

    if account.open():
        try: create()
        finally: account.close()
    """

    __slots__ = ("_all", "_one", "_pace", "_since")

    def __init__(self, pace: Pace, everybody: Bucket) -> None:
        self._pace = pace
        self._all = everybody
        self._one = Bucket(BURST_OF_ONE, SHARE_OF_ONE)
        self._since = 0.0

    def open(self) -> bool:
        """Whether the client may have something made now."""
        now = self._since = time.monotonic()
        if not self._pace.on:
            return True
        return self._one.credit(now) and self._all.credit(now)

    def close(self) -> None:
        """It is made; pay."""
        spent = time.monotonic() - self._since
        self._one.spend(spent)
        self._all.spend(spent)


class Closing:
    """What is left to close: ``failed`` is told what goes wrong, and the rest is closed.

    Without a server all is closed at once; a server sets ``later``, by which it is asked to
    :meth:`work` soon.
    """

    def __init__(self, failed: Callable[[Exception], None]) -> None:
        self.later: Callable[[], None] | None = None
        self._failed = failed
        self._waiting: deque[Callable[[], None]] = deque()
        self._spent = 0.0  # in this turn

    def __len__(self) -> int:
        return len(self._waiting)

    def add(self, close: Callable[[], None]) -> None:
        """Close it now, or soon; after all that was added before."""
        if self.later is None:
            self._close(close)
        elif self._waiting:
            self._waiting.append(close)
            if len(self._waiting) > MAX_CLOSING:
                self._timed(self._waiting.popleft())
        elif self._spent >= SLICE:
            self._waiting.append(close)
            self.later()
        else:
            self._timed(close)

    def work(self) -> None:
        """A slice of what waits. Once a turn."""
        self._spent = 0.0
        while self._waiting and self._spent < SLICE:
            self._timed(self._waiting.popleft())
        if self._waiting and self.later is not None:
            self.later()

    def turn(self) -> None:
        """A new turn has begun."""
        if not self._waiting:
            self._spent = 0.0

    def finish(self) -> None:
        """All that waits, however long it takes."""
        while self._waiting:
            self._close(self._waiting.popleft())

    def _timed(self, close: Callable[[], None]) -> None:
        start = time.monotonic()
        self._close(close)
        self._spent += time.monotonic() - start

    def _close(self, close: Callable[[], None]) -> None:
        try:
            close()
        except Exception as error:  # the middleware's; others' ends must be closed none the less
            self._failed(error)
