"""What waits in a reader of the middleware for its client: octets, bounded and charged.

Samples stay in the reader until the client's stream has room, under the depth that the client's QoS
has. A depth is a number of samples and says nothing of memory: 5000 samples may be gigabytes. So
where a client does not take everything, each sample's size is noted as it comes. Beyond
:data:`MAX_UNREAD_BYTES` the oldest go, and what waits is part of the account of all clients
(:mod:`.budget`).
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Sequence
from typing import Any, Final, Protocol

from .memory_budget import MESSAGE_BYTES, MemoryBudget

# Attack: a reader that keeps all, of a topic of pictures, and is never asked. One sample is kept
# whatever its size.
MAX_UNREAD_BYTES: Final = 16 * 1024 * 1024
# One reader may have no more than this part of what all clients together may have.
_SHARE: Final = 8
# More than this, given back at once, is worth asking the C library for.
_MUCH: Final = 1024 * 1024
# Attack: samples as fast as they can be looked at. So many at a time; others have their turn then.
MAX_LOOKED_AT: Final = 64


class Source(Protocol):
    """An end of the middleware that samples wait in."""

    def arrived(self, limit: int) -> list[int]:
        """See :meth:`uros.middleware.base.Reader.arrived`."""

    def take(self, limit: int) -> Sequence[Any]:
        """Samples, oldest first."""


class Backlog:
    """See the module.

    The count may be too high for a while, where the middleware has dropped samples by itself; it is
    right again when the reader has been emptied.

    Args:
        source: Where samples wait.
        depth: How many of them, at most.
        budget: The account of all clients.
        dropped: Called with a text when samples had to go.
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
        self.empty = False  # when it was last taken from

    def took(self, count: int) -> None:
        """So many samples were taken; none: there are no more."""
        self.empty = not count
        if not self._sizes:
            return
        if self.octets > _MUCH:
            self._budget.freed = True
        if not count:
            self._sizes.clear()
            self.octets = 0
        for _ in range(min(count, len(self._sizes))):
            self.octets -= self._sizes.popleft()

    def look(self) -> bool:
        """Count what has come, and drop what is too much. Whether there may be more to count."""
        sizes, known = self._sizes, self.octets
        arrived = self._source.arrived(MAX_LOOKED_AT)
        count = 0
        for size in arrived:
            if len(sizes) == sizes.maxlen:
                self.octets -= sizes.popleft()  # the reader has let it go as well
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
        self._budget.since += max(0, self.octets - known)
        return len(arrived) >= MAX_LOOKED_AT
