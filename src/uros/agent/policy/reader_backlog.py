"""Reader backlog: the bytes that wait in a middleware reader for its client, limited and charged.

Samples stay in the reader until the client's stream has room, limited by the depth of the client's
QoS. A depth is a number of samples and no limit of memory: 5000 samples may be gigabytes. So while
a client does not take everything, the size of each sample is noted as it arrives. Beyond
:data:`MAX_UNREAD_BYTES` the oldest are dropped, and the backlog is part of the memory budget of all
clients (:mod:`.memory_budget`).
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Sequence
from typing import Any, Final, Protocol

from .memory_budget import MESSAGE_BYTES, MemoryBudget

# The most bytes that wait in one reader: a KEEP_ALL reader of images may never be read. One sample
# is kept whatever its size.
MAX_UNREAD_BYTES: Final = 16 * 1024 * 1024
# One reader may have no more than this part of the memory budget.
_SHARE: Final = 8
# Bytes that, freed at once, are worth returning to the system.
_MUCH: Final = 1024 * 1024
# The most samples that are counted at a time: they may arrive as fast as they can be counted, and
# other clients must be served.
MAX_LOOKED_AT: Final = 64


class Source(Protocol):
    """A middleware reader in which samples wait; see :class:`uros.middleware.base.Reader`."""

    def arrived(self, limit: int) -> list[int]:
        """Return sizes of new samples; see :meth:`uros.middleware.base.Reader.arrived`."""

    def take(self, limit: int) -> Sequence[Any]:
        """Take samples, oldest first."""


class Backlog:
    """The samples that wait in one reader.

    The count is too high for a while if the middleware has dropped samples by itself; it is correct
    again when the reader was emptied.

    Attributes:
        octets: Bytes that wait, with the overhead of each sample.
        empty: Whether the last take left no sample.

    Args:
        source: Where samples wait.
        depth: The depth of its QoS.
        budget: The memory budget of all clients.
        dropped: Called with a text for the log when samples were dropped.
    """

    __slots__ = ("_budget", "_dropped", "_most", "_sizes", "_source", "empty", "octets")

    def __init__(
        self, source: Source, depth: int, budget: MemoryBudget, dropped: Callable[[str], None]
    ) -> None:
        self._source = source
        self._budget = budget
        self._dropped = dropped
        self._most = min(MAX_UNREAD_BYTES, budget.limit // _SHARE)
        self._sizes: deque[int] = deque(maxlen=depth)
        self.octets = 0
        self.empty = False

    def took(self, count: int, limit: int) -> None:
        """Note that samples were taken; fewer than ``limit`` leave none."""
        self.empty = count < limit
        if not self._sizes:
            return
        if self.octets > _MUCH:
            self._budget.freed = True
        if self.empty:
            self._sizes.clear()
            self.octets = 0
            return
        for _ in range(min(count, len(self._sizes))):
            self.octets -= self._sizes.popleft()

    def check(self) -> bool:
        """Count new samples, drop the oldest over the limit; return whether there may be more."""
        sizes, octets_before = self._sizes, self.octets
        arrived = self._source.arrived(MAX_LOOKED_AT)
        count = 0
        for size in arrived:
            if len(sizes) == sizes.maxlen:
                self.octets -= sizes.popleft()  # the reader has dropped it as well
            sizes.append(size + MESSAGE_BYTES)
            self.octets += size + MESSAGE_BYTES
            while self.octets > self._most and len(sizes) > 1:
                self.octets -= sizes.popleft()
                count += 1
        if count:
            self._budget.freed = True
            self._source.take(count)
            self._dropped(
                f"{count} samples that wait for the client are dropped, the oldest first: over"
                f" {self._most} bytes wait (does it read? give the reader a smaller depth)"
            )
        self._budget.since += max(0, self.octets - octets_before)
        return len(arrived) >= MAX_LOOKED_AT
