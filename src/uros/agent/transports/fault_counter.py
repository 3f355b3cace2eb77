"""Counts faults of a transport and limits their log lines."""

from __future__ import annotations


class FaultCounter:
    """Counts faults; the log gets the first, the second, the fourth and so on.

    Attributes:
        count: Faults so far.
    """

    __slots__ = ("_next", "count")

    def __init__(self) -> None:
        self.count = 0
        self._next = 1

    def add(self) -> bool:
        """Count a fault; return whether to log this one."""
        self.count += 1
        if self.count < self._next:
            return False
        self._next = 2 * self.count
        return True
