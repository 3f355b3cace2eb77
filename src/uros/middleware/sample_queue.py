"""Samples that wait in a reader, and which of their sizes were asked for."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from itertools import islice
from typing import Generic, TypeVar

Item = TypeVar("Item")


class SampleQueue(Generic[Item]):
    """Samples in the order of arrival; with a depth the oldest are dropped.

    Args:
        depth: The most samples; None has no limit.
        size: Returns the octets of a sample.

    Attributes:
        dropped: How many samples newer ones have replaced.
    """

    __slots__ = ("_samples", "_size", "_unreported", "dropped")

    def __init__(self, depth: int | None, size: Callable[[Item], int]) -> None:
        self._samples: deque[Item] = deque(maxlen=depth)
        self._size = size
        self._unreported = 0  # the newest of them, whose sizes were not asked for
        self.dropped = 0

    def __len__(self) -> int:
        return len(self._samples)

    def put(self, sample: Item) -> None:
        """Store a sample."""
        if len(self._samples) == self._samples.maxlen:
            self.dropped += 1
        self._samples.append(sample)
        self._unreported += 1

    def take(self, limit: int) -> list[Item]:
        """Return at most ``limit`` samples, oldest first, and forget them."""
        samples = self._samples
        if len(samples) > limit:
            return [samples.popleft() for _ in range(limit)]
        taken = list(samples)
        samples.clear()
        return taken

    def arrived(self, limit: int) -> list[int]:
        """Return the sizes of at most ``limit`` samples that were not asked for before."""
        count = len(self._samples)
        unreported = min(self._unreported, count)
        reported = min(unreported, limit)
        self._unreported = unreported - reported
        first = count - unreported
        return [self._size(sample) for sample in islice(self._samples, first, first + reported)]

    def clear(self) -> None:
        """Forget all samples."""
        self._samples.clear()
