"""The account of the memory that clients make the agent hold, all of them together.

What is kept is charged as it comes; what is given back is not told. When the charges since the
last count might pass the limit, all is counted anew, at the end of the server's turn. So nothing
on the way of a message costs more than an addition, and what is held passes the limit by no more
than what one turn sends to clients.

Where the limit is passed, the worst go: clients that hold more than a fair share, most bytes times
silence first. A client that goes is unknown to the agent from then on, and one that was honest
starts anew. New clients and objects are refused while there is no room; when a client was refused,
the worst go, so that it finds room when it asks again.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Final, Protocol

from ...ticks import ticks_diff

# What a client, an object and a message take besides their bytes; measured, and rounded up.
CLIENT_BYTES: Final = 4096
OBJECT_BYTES: Final = 4096
MESSAGE_BYTES: Final = 128
# Where clients have had to go, or nothing was admitted, down to this part of the limit.
_RELIEVED: Final = 0.75


class Holder(Protocol):
    """What an account knows of a client."""

    key: int

    def held(self) -> int:
        """Bytes that the agent holds for it."""

    def heard(self) -> int:
        """When it was heard last, in milliseconds modulo 2^30."""


class MemoryBudget:
    """See the module. ``holders`` gives all clients, ``dismiss`` sends one away, and is told how
    much it held.
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
        self.total = 0  # at the last count
        self.room = limit  # what was left then
        self.since = 0  # charged since; more than `room` asks for a count
        self.full = False  # at the last count: nobody new
        self.freed = False  # much was given back at once: the system may have it

    def keep(self, size: int) -> bool:
        """Whether so much more may be kept; it is charged. False: not before the next count."""
        self.since += size + MESSAGE_BYTES
        return self.since <= self.room

    def admit(self, size: int, pressing: bool = False) -> bool:
        """The same for what is not asked again, an object or a client: counts where it must.
        Where it is ``pressing``, the worst go at the turn's end: next time there is room.
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
        """Count what everybody holds; (bytes, client)."""
        held = [(it.held(), it) for it in self._holders()]
        self.total = sum(it[0] for it in held)
        self.since = 0
        self.room = max(0, self.limit - self.total)
        self.full = self.total > self.limit * 15 // 16
        return held

    def settle(self, now: int) -> None:
        """Where too much was charged: count, and send the worst away. Once a turn."""
        if self.since <= self.room:
            return
        wanted = self.since - self.room
        held = self.count()
        if self.total + min(wanted, self.limit // 16) <= self.limit:
            return
        fair = self.limit // max(1, len(held))
        worst = [it for it in held if it[0] > fair] or held
        worst.sort(key=lambda it: it[0] * (1 + max(0, ticks_diff(now, it[1].heard()))))
        while worst and self.total > self.limit * _RELIEVED:
            size, client = worst.pop()
            self.total -= size
            self._dismiss(client.key, size)
        self.room = max(0, self.limit - self.total)
        self.full = self.total > self.limit * 15 // 16


def unlimited() -> MemoryBudget:
    """For a session without an agent."""
    return MemoryBudget(1 << 62, lambda: (), lambda _key, _size: None)
