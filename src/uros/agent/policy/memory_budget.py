"""Memory budget: the bytes that the agent holds for all clients together.

Bytes are charged when they are stored. Frees are not tracked; usage is recounted when the limit may
be hit, at the end of the server's turn. So a message costs no more than an addition, and the usage
passes the limit by no more than what one turn sends to clients.

If the limit is passed, clients that hold more than a fair share are evicted, those with the highest
product of bytes and silence first. An evicted client is unknown to the agent from then on, and its
board creates a new session. New clients and objects are refused while the limit is reached; when a
client was refused, others are evicted, so that it is admitted when it asks again.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Final, Protocol

from ...ticks import ticks_diff

# Overhead of a client, an object and a message in bytes; measured, and rounded up.
CLIENT_BYTES: Final = 4096
OBJECT_BYTES: Final = 4096
MESSAGE_BYTES: Final = 128
# Clients are evicted until the usage is down to this part of the limit.
_RELIEVED: Final = 0.75


class Holder(Protocol):
    """What the budget uses of a client."""

    key: int

    def held(self) -> int:
        """Return the bytes that the agent holds for it."""

    def heard(self) -> int:
        """Return when it was heard last, in milliseconds modulo 2^30."""


class MemoryBudget:
    """The memory budget of all clients.

    Attributes:
        limit: Bytes that all clients together may hold.
        total: Bytes at the last count.
        room: Bytes left at the last count.
        since: Bytes charged since; more than ``room`` requires a count.
        full: Whether new clients and objects are refused since the last count.
        freed: Much memory was freed at once: it can be returned to the system.

    Args:
        limit: See above.
        holders: Returns all clients.
        dismiss: Evicts a client; called with its key and the bytes that it holds.
    """

    __slots__ = ("_dismiss", "_holders", "freed", "full", "limit", "room", "since", "total")

    def __init__(
        self,
        limit: int,
        holders: Callable[[], Iterable[Holder]],
        dismiss: Callable[[int, int], None],
    ) -> None:
        self.limit = limit
        self._holders = holders
        self._dismiss = dismiss
        self.total = 0
        self.room = limit
        self.since = 0
        self.full = False
        self.freed = False

    def keep(self, size: int) -> bool:
        """Charge bytes; return whether they may be stored, False until the next count otherwise."""
        self.since += size + MESSAGE_BYTES
        return self.since <= self.room

    def admit(self, size: int, pressing: bool = False) -> bool:
        """Charge an object or a client; return whether it is admitted.

        Recounts the usage if necessary. If it is refused and ``pressing``, clients are evicted at
        the end of the turn, so that it is admitted next time.
        """
        if self.full:
            if pressing:
                self.since = self.room + self.limit // 8
            return False
        if self.since + size > self.room:
            self.count()
        self.since += size
        return self.since <= self.room and not self.full

    def count(self) -> list[tuple[int, Holder]]:
        """Recount the usage; return ``(bytes, client)`` of all clients."""
        sizes = [(holder.held(), holder) for holder in self._holders()]
        self.total = sum(size for size, _ in sizes)
        self.since = 0
        self.room = max(0, self.limit - self.total)
        self.full = self.total > self.limit * 15 // 16
        return sizes

    def settle(self, now: int) -> None:
        """Count and evict, if too much was charged. Called at the end of a turn of the server."""
        if self.since <= self.room:
            return
        excess = self.since - self.room
        sizes = self.count()
        if self.total + min(excess, self.limit // 16) <= self.limit:
            return
        fair = self.limit // max(1, len(sizes))
        worst = [pair for pair in sizes if pair[0] > fair] or sizes
        worst.sort(key=lambda pair: pair[0] * (1 + max(0, ticks_diff(now, pair[1].heard()))))
        while worst and self.total > self.limit * _RELIEVED:
            size, client = worst.pop()
            self.total -= size
            self._dismiss(client.key, size)
        self.room = max(0, self.limit - self.total)
        self.full = self.total > self.limit * 15 // 16


def unlimited() -> MemoryBudget:
    """Return a budget without a limit, for a session without an agent."""
    return MemoryBudget(1 << 62, lambda: (), lambda _key, _size: None)
