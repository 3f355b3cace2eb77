"""Faults that come again and again: all are counted, some are told."""

from __future__ import annotations

from typing import Final

# Attack: faults of ever new kinds.
MAX_KINDS: Final = 64
# A kind is told at once, then more and more seldom, in seconds.
FIRST: Final = 1.0
LAST: Final = 60.0


class Tally:
    """Counts faults, of which the log gets the first, the second, the fourth and so on."""

    __slots__ = ("_next", "count")

    def __init__(self) -> None:
        self.count = 0
        self._next = 1

    def add(self) -> bool:
        """One more; whether it is for the log."""
        self.count += 1
        if self.count < self._next:
            return False
        self._next = 2 * self.count
        return True


class Seldom:
    """Counts faults of several kinds by time: one that comes often is told each minute, and one
    that comes after a pause at once.
    """

    __slots__ = ("_kinds",)

    def __init__(self) -> None:
        self._kinds: dict[str, _Kind] = {}

    def add(self, kind: str, now: float) -> int:
        """One more; of how many to tell, or 0."""
        known = self._kinds.get(kind)
        if known is None:
            if len(self._kinds) >= MAX_KINDS:
                self._kinds.clear()
            known = self._kinds[kind] = _Kind()
        return known.add(now)


class _Kind:
    """When one kind of fault may be told again, and how many there were since it was."""

    __slots__ = ("_again", "_count", "_pause")

    def __init__(self) -> None:
        self._again = float("-inf")
        self._count = 0
        self._pause = FIRST

    def add(self, now: float) -> int:
        self._count += 1
        if now < self._again:
            return 0
        quiet = now >= self._again + self._pause
        self._pause = FIRST if quiet else min(2 * self._pause, LAST)
        self._again = now + self._pause
        count, self._count = self._count, 0
        return count
