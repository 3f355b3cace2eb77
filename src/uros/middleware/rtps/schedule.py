"""Which of many items is due first, at a cost of those that have changed."""

from __future__ import annotations

import heapq
from typing import Final, Generic, Protocol, TypeVar

# The heap is made anew when it has so many entries, besides twice those that count.
_SLACK: Final = 64


class Timed(Protocol):
    """What has a deadline."""

    def next_deadline(self) -> float | None:
        """Return when it is due, or None."""


ItemT = TypeVar("ItemT", bound=Timed)


class Schedule(Generic[ItemT]):
    """Knows the deadlines of items.

    An item is asked for its deadline when somebody wants to know what is due, after one or many
    calls of :meth:`touch`. Deadlines that no longer hold stay in the heap until they come up.

    Attributes:
        touched: The items that were touched since; while there are none, :meth:`next_deadline` does
            not change. It stays the same object.
    """

    def __init__(self) -> None:
        self.touched: dict[ItemT, None] = {}
        self._due: dict[ItemT, float] = {}
        self._heap: list[tuple[float, int, ItemT]] = []
        self._serial = 0  # items are not compared

    def touch(self, item: ItemT) -> None:
        """Note that an item is new, or that its deadline may have changed."""
        self.touched[item] = None

    def remove(self, item: ItemT) -> None:
        """Forget an item; idempotent."""
        self.touched.pop(item, None)
        self._due.pop(item, None)
        self._drop_outdated()

    def next_deadline(self) -> float | None:
        """Return the earliest deadline, or None."""
        if self.touched:
            self._update()
        return self._heap[0][0] if self._heap else None

    def take_due(self, now: float) -> list[ItemT]:
        """Return the items whose deadline has come, the earliest first.

        The caller does what is due; the items are asked for their deadlines again after that.
        """
        found = []
        if self.touched:
            self._update()
        while self._heap and self._heap[0][0] <= now:
            _, _, item = heapq.heappop(self._heap)
            del self._due[item]
            self.touched[item] = None
            found.append(item)
            self._drop_outdated()
        return found

    def _update(self) -> None:
        touched = list(self.touched)
        self.touched.clear()
        for item in touched:
            at = item.next_deadline()
            if at is None:
                self._due.pop(item, None)
            elif at != self._due.get(item):
                self._due[item] = at
                self._serial += 1
                heapq.heappush(self._heap, (at, self._serial, item))
        if len(self._heap) > 2 * len(self._due) + _SLACK:
            self._heap = [(at, number, item) for number, (item, at) in enumerate(self._due.items())]
            self._serial = len(self._heap)
            heapq.heapify(self._heap)
        self._drop_outdated()

    def _drop_outdated(self) -> None:
        """Have the heap begin with a deadline that holds."""
        while self._heap and self._due.get(self._heap[0][2]) != self._heap[0][0]:
            heapq.heappop(self._heap)
