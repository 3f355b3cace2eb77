"""Plays messages of a bag when they are due."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Final

from .play_clock import PlayClock
from .read_ahead import ReadAhead

if TYPE_CHECKING:
    from ...bag.storage import BagMessage
    from ...middleware.base import Writer

# Most messages that are published before the network gets its turn again.
_BATCH: Final = 64
# How long the first message that a writer has no room for waits; what is due meanwhile comes late,
# in its order. The next ones are dropped at once until the writer has room again, since a
# subscription that has stopped must not stop the others.
_PATIENCE_NS: Final = 100_000_000
_RETRY_NS: Final = 1_000_000
# When to look again while the bag is read more slowly than it is played.
_STARVED_NS: Final = 1_000_000
# The encapsulation header (RTPS 10.5).
_MIN_CDR: Final = 4


class Output:
    """A topic that is played.

    Attributes:
        published: The messages that were published.
        dropped: The messages that the writer had no room for, or that are malformed.
    """

    def __init__(self, writer: Writer) -> None:
        self._writer = writer
        self._waiting_since: int | None = None
        self._has_given_up = False
        self.published = 0
        self.dropped = 0

    def publish(self, cdr: bytes, now_ns: int) -> bool:
        """Publish or drop a message.

        Returns:
            False if it has to be tried again in a millisecond.
        """
        from ...middleware.base import MiddlewareError

        try:
            is_sent = len(cdr) >= _MIN_CDR and self._writer.write(cdr)
        except MiddlewareError:  # such as a big-endian message of an unknown type
            self.dropped += 1
            return True
        if is_sent:
            self.published += 1
            self._waiting_since = None
            self._has_given_up = False
            return True
        if len(cdr) >= _MIN_CDR and not self._has_given_up:
            if self._waiting_since is None:
                self._waiting_since = now_ns
            if now_ns - self._waiting_since < _PATIENCE_NS:
                return False
            self._has_given_up = True
        self.dropped += 1
        return True


class Player:
    """The messages of one pass through a bag.

    Args:
        source: The messages.
        clock: The time of the bag.
        outputs: The topics that are played; messages of others are passed over.
        before: Called with each message before it is published.
        now: Returns the monotonic time in ns.
    """

    def __init__(
        self,
        source: ReadAhead,
        clock: PlayClock,
        outputs: Mapping[str, Output],
        before: Callable[[BagMessage], None] = lambda _: None,
        now: Callable[[], int] = time.monotonic_ns,
    ) -> None:
        self._source = source
        self._clock = clock
        self._outputs = outputs
        self._before = before
        self._now = now

    @property
    def finished(self) -> bool:
        """Whether every message was played."""
        return self._source.finished

    def turn(self) -> int | None:
        """Publish what is due, in the order of the bag.

        Returns:
            The monotonic time of the next turn, in ns; None: not before the clock is changed.
        """
        for _ in range(_BATCH):
            message = self._source.first()
            if message is None:
                return self._now() + (0 if self._source.finished else _STARVED_NS)
            due = self._clock.due(message.received_ns)
            now = self._now()
            if due is None or due > now:
                return due
            if not self._publish(message, now):
                return now + _RETRY_NS
        return self._now()

    def step(self) -> bool:
        """Publish the next message while the clock is paused, and set the clock to its time.

        Returns:
            False if there is none, or the clock is not paused.
        """
        message = self._source.first()
        if not self._clock.paused or message is None:
            return False
        now = self._now()
        self._clock.jump(message.received_ns, now)
        return self._publish(message, now)

    def _publish(self, message: BagMessage, now: int) -> bool:
        output = self._outputs.get(message.topic)
        if output is not None:
            self._before(message)
            if not output.publish(message.cdr, now):
                return False
        self._source.take()
        return True


class ClockTicks:
    """Publishes the time of the bag at a rate of real time, while paused too.

    Args:
        hz: The rate.
        publish: Takes the time in ns.
        now_ns: The monotonic time.
    """

    def __init__(self, hz: float, publish: Callable[[int], None], now_ns: int) -> None:
        self._period_ns = 1e9 / hz
        self._publish = publish
        self._began_ns = now_ns
        self._count = 0

    def turn(self, clock: PlayClock, now_ns: int) -> int:
        """Publish if it is due; return when the next time is, in monotonic ns."""
        if now_ns >= self._due():
            self._publish(clock.time(now_ns))
            # Those that were missed are not caught up on.
            self._count = max(self._count, int((now_ns - self._began_ns) / self._period_ns)) + 1
        return self._due()

    def _due(self) -> int:
        return self._began_ns + round(self._count * self._period_ns)
