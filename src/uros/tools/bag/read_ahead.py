"""Reads messages of a bag in a thread, before they are due."""

from __future__ import annotations

import heapq
import threading
from collections import deque
from collections.abc import Generator
from contextlib import closing
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from ...bag.storage import BagMessage

# The most octets of messages that wait, so that a bag of pictures does not fill the memory.
_MAX_OCTETS: Final = 256 << 20


def by_time_sent(
    messages: Generator[BagMessage, None, None], limit: int, max_octets: int = _MAX_OCTETS
) -> Generator[BagMessage, None, None]:
    """Yield messages in the order in which they were sent, which replaces the time of reception.

    Args:
        messages: The messages in the order in which they were received.
        limit: The most messages that are compared. One that was overtaken by more of them comes
            late.
        max_octets: The most octets of these.
    """
    waiting: list[tuple[int, int, BagMessage]] = []
    octets = 0
    with closing(messages):
        for number, message in enumerate(messages):
            sent = message.sent_ns or message.received_ns
            heapq.heappush(waiting, (sent, number, message._replace(received_ns=sent)))
            octets += len(message.cdr)
            while len(waiting) > limit or octets > max_octets:
                first = heapq.heappop(waiting)[2]
                octets -= len(first.cdr)
                yield first
    while waiting:
        yield heapq.heappop(waiting)[2]


class ReadAhead:
    """A bounded queue of messages that a thread fills.

    Args:
        messages: The messages, oldest first. The thread alone uses the iterator.
        limit: The most messages that wait.
        max_octets: The most octets of messages that wait; one larger message is taken too.

    Attributes:
        error: What ended the thread early, or None.
    """

    def __init__(
        self, messages: Generator[BagMessage, None, None], limit: int, max_octets: int = _MAX_OCTETS
    ) -> None:
        self._messages = messages
        self._limit = limit
        self._max_octets = max_octets
        self._queue: deque[BagMessage] = deque()
        self._octets = 0
        self._changed = threading.Condition()
        self._ended = False
        self._closed = False
        self._is_blocked = False  # whether the thread waits for room
        self.error: Exception | None = None
        self._thread = threading.Thread(target=self._run, name="uros bag reader", daemon=True)
        self._thread.start()

    def _run(self) -> None:
        try:
            for message in self._messages:
                with self._changed:
                    if not self._has_room():
                        self._is_blocked = True
                        self._changed.wait_for(self._is_half_empty)
                        self._is_blocked = False
                    if self._closed:
                        return
                    self._queue.append(message)
                    self._octets += len(message.cdr)
        except Exception as error:  # for whoever plays the messages before it
            self.error = error
        finally:
            self._messages.close()
            self._ended = True

    def _has_room(self) -> bool:
        if self._closed or not self._queue:
            return True
        return len(self._queue) < self._limit and self._octets < self._max_octets

    def _is_half_empty(self) -> bool:
        # Not as soon as there is room: each message would cost two changes of threads.
        return self._closed or (
            len(self._queue) <= self._limit // 2 and self._octets <= self._max_octets // 2
        )

    @property
    def finished(self) -> bool:
        """Whether all messages were taken, or those before :attr:`error`."""
        return self._ended and not self._queue

    def first(self) -> BagMessage | None:
        """Return the next message; None if it was not read yet, or there is none."""
        return self._queue[0] if self._queue else None

    def take(self) -> BagMessage:
        """Take the next message, which :meth:`first` has returned."""
        with self._changed:
            message = self._queue.popleft()
            self._octets -= len(message.cdr)
            if self._is_blocked and self._is_half_empty():
                self._changed.notify_all()
        return message

    @property
    def is_filled(self) -> bool:
        """Whether the thread waits for room, or has read all messages."""
        return self._ended or self._is_blocked

    def close(self) -> None:
        """End the thread and drop what waits; idempotent."""
        with self._changed:
            self._closed = True
            self._queue.clear()
            self._changed.notify_all()
        self._thread.join()
