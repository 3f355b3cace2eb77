"""One READ_DATA: sends samples from a source to the client, at the number and rate it asked for.

Samples are taken only when the client's stream has room. Until then they wait in the
middleware's reader, under the QoS that the client chose.
"""

from __future__ import annotations

from typing import Final, Protocol

from ...ticks import ticks_add, ticks_diff
from ...wire import ids
from .session import Session

# The most samples that are taken at a time, and sent at a time on a best-effort stream, so that one
# client does not keep the others waiting.
_BATCH: Final = 16
_BURST: Final = 64


class Source(Protocol):
    """An endpoint that samples are taken from."""

    def take(self, limit: int) -> list[tuple[int, bytes]]:
        """Return at most ``limit`` samples: (flags of DATA, payload after the request).

        Fewer mean that no more wait, or that the client's ``on_ready`` is called for them.
        """


class Delivery:
    """One READ_DATA of one object, until its limits are reached or it is replaced.

    Args:
        session: The client's session.
        source: Where its samples are taken from.
        request_id: The request's.
        object_id: The object that is read.
        stream_id: The stream for the samples.
        control: (most samples, seconds, bytes a second, milliseconds between samples); None: one
            sample.
        now: The time, in milliseconds modulo 2^30.
    """

    __slots__ = ("_bytes_per_second", "_end", "_head", "_is_limited", "_large", "_next", "_pace",
                 "_remaining", "_session", "_source", "stream_id")  # fmt: skip

    def __init__(
        self,
        session: Session,
        source: Source,
        request_id: int,
        object_id: int,
        stream_id: int,
        control: tuple[int, int, int, int] | None,
        now: int,
    ) -> None:
        samples, seconds, self._bytes_per_second, self._pace = control or (1, 0, 0, 0)
        self._session = session
        self._source = source
        self._head = request_id.to_bytes(2, "big") + object_id.to_bytes(2, "big")
        self._remaining: int | None = None if samples == ids.MAX_SAMPLES_UNLIMITED else samples
        self._end: int | None = ticks_add(now, seconds * 1000) if seconds else None
        self._is_limited = self._remaining is not None or self._end is not None
        self._next: int | None = None  # not before, by pace or rate
        # Samples that need fragments are taken one by one, so that the others wait in the reader.
        self._large = False
        self.stream_id = stream_id

    def finished(self, now: int) -> bool:
        """Return whether a limit is reached."""
        if self._remaining is not None and self._remaining <= 0:
            return True
        return self._end is not None and ticks_diff(now, self._end) >= 0

    @property
    def remaining(self) -> int | None:
        """Samples that are still to be sent; None: no limit."""
        return self._remaining

    def hold(self, until: int) -> None:
        """Send nothing before a time; samples wait in the reader."""
        self._next = until

    def next_deadline(self) -> int | None:
        """Return when :meth:`pump` can continue by time alone, or None."""
        return self._next

    def pump(self, now: int) -> bool:
        """Send samples, as many as there are, the limits allow and the stream has room for.

        Returns:
            Whether a limit is reached, so that nothing more will be sent.
        """
        session, stream_id, head = self._session, self.stream_id, self._head
        is_paced = bool(self._bytes_per_second or self._pace)
        is_reliable = stream_id >= ids.STREAM_RELIABLE
        sent = 0
        while True:
            if self._is_limited and self.finished(now):
                return True
            if self._next is not None:
                if ticks_diff(now, self._next) < 0:
                    return False
                self._next = None
            limit = _BATCH
            if is_reliable:
                limit = min(limit, session.room(stream_id))
                if limit <= 0:
                    return False
            elif sent >= _BURST:
                self._next = now  # the rest follows after the other clients were served
                return False
            if self._remaining is not None:
                limit = min(limit, self._remaining)
            if is_paced or self._large:
                limit = 1
            samples = self._source.take(limit)
            for flags, payload in samples:
                session.send(ids.DATA, flags, stream_id, head + payload, now)
            if self._remaining is not None:
                self._remaining -= len(samples)
            if is_paced and samples:
                wait = self._pace
                if self._bytes_per_second:
                    wait = max(wait, len(samples[0][1]) * 1000 // self._bytes_per_second)
                self._next = ticks_add(now, wait)
            if samples:
                session.delivered = True
                self._large = is_reliable and len(samples[-1][1]) > session.mtu - 16
            if len(samples) < limit:
                return self._is_limited and self.finished(now)
            sent += limit
