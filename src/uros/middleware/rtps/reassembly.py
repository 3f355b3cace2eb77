"""Samples that arrive in fragments (RTPS 8.4.14).

A writer announces a sample's size in each fragment, before the sample is there: memory is taken as
fragments arrive, up to a limit that all readers of a participant share.
"""

from __future__ import annotations

from collections.abc import Hashable
from typing import Final

from .kinds import DataFrag

# The largest sample that is put together. A 4K picture of 3 octets a pixel has 25 MB.
MAX_SAMPLE: Final = 28 * 1024 * 1024
# Attack: fragments of one octet; each takes an entry of a table.
MIN_FRAGMENT: Final = 64
# Samples of one writer that are incomplete at the same time; the oldest is given up.
MAX_INCOMPLETE: Final = 8
# What a fragment costs besides its octets: an entry of a table, and an object.
_OVERHEAD: Final = 100


class OctetBudget:
    """Octets that may be held, shared by holders that are not trusted.

    Attack: a participant that takes all of it. Each holder may have as much as then remains free:
    one alone gets half of the limit, and n that grow together get one part of n + 1 each.

    Attributes:
        limit: The most.
        used: Octets in use.

    Args:
        limit: The most.
    """

    __slots__ = ("_used_by", "limit", "used")

    def __init__(self, limit: int) -> None:
        self.limit = limit
        self.used = 0
        self._used_by: dict[Hashable, int] = {}

    def take(self, octets: int, holder: Hashable) -> bool:
        """Take octets; False where that would exceed the holder's share, and nothing is taken."""
        held = self._used_by.get(holder, 0) + octets
        if held > self.limit - self.used:
            return False
        self.used += octets
        self._used_by[holder] = held
        return True

    def give_back(self, octets: int, holder: Hashable) -> None:
        """Return octets that the holder has taken."""
        if not octets:
            return
        self.used -= octets
        held = self._used_by[holder] - octets
        if held:
            self._used_by[holder] = held
        else:
            del self._used_by[holder]


class IncompleteSample:
    """A sample of which some fragments are there.

    Attributes:
        number: Its sequence number.
        sample_size: Its octets.
        fragment_size: Octets of each fragment but the last.
        highest: The highest fragment that is known to exist: received, or announced.
        has_progressed: Whether a fragment was added since the reader last asked for some.
        inline_qos: The inline QoS of the first fragment that had one, and its byte order.

    Args:
        first: The fragment that came first.
        budget: Where its octets are taken from; :meth:`close` gives them back.
        holder: For whom they are taken.
    """

    __slots__ = (
        "_budget", "_first_missing", "_fragments", "_held", "_holder", "fragment_size", "highest",
        "has_progressed", "inline_qos", "is_key", "number", "sample_size",
    )  # fmt: skip

    def __init__(self, first: DataFrag, budget: OctetBudget, holder: Hashable) -> None:
        self.number = first.number
        self.sample_size = first.sample_size
        self.fragment_size = first.fragment_size
        self.is_key = first.is_key
        self.highest = 0
        self.has_progressed = False
        self.inline_qos: tuple[bytes, bool] | None = None
        self._budget = budget
        self._holder = holder
        self._fragments: dict[int, bytes] = {}
        self._held = 0
        self._first_missing = 1

    @staticmethod
    def is_acceptable(fragment: DataFrag, budget: OctetBudget) -> bool:
        """Return whether a sample of this size in such fragments is put together at all."""
        size = fragment.sample_size
        if size > MAX_SAMPLE or fragment.fragment_size < min(MIN_FRAGMENT, size):
            return False
        # It must fit into the share that one participant has of an empty budget.
        return size + -(-size // fragment.fragment_size) * _OVERHEAD <= budget.limit // 2

    @property
    def last(self) -> int:
        """The number of its last fragment."""
        return -(-self.sample_size // self.fragment_size)

    def add(self, fragment: DataFrag) -> bytes | None:
        """Add fragments; return the sample when all are there.

        Fragments that contradict the first one in size, and those beyond the budget, are dropped.
        """
        if (fragment.sample_size, fragment.fragment_size) != (
            self.sample_size,
            self.fragment_size,
        ):
            return None
        if self.inline_qos is None and fragment.inline_qos is not None:
            self.inline_qos = fragment.inline_qos, fragment.little
        self.highest = max(self.highest, fragment.first + fragment.fragments - 1)
        for index in range(fragment.fragments):
            number = fragment.first + index
            if number in self._fragments:
                continue
            start = index * self.fragment_size
            octets = bytes(fragment.payload[start : start + self.fragment_size])
            if not self._budget.take(len(octets) + _OVERHEAD, self._holder):
                return None
            self._held += len(octets) + _OVERHEAD
            self._fragments[number] = octets
            self.has_progressed = True
        if len(self._fragments) < self.last:
            return None
        return b"".join(self._fragments[number] for number in range(1, self.last + 1))

    def missing(self, up_to: int) -> list[int]:
        """Return the missing fragments up to ``up_to``, within 256 of the first."""
        first = self._first_missing
        while first in self._fragments:
            first += 1
        self._first_missing = first
        stop = min(up_to, self.last, first + 255)
        return [number for number in range(first, stop + 1) if number not in self._fragments]

    def close(self) -> None:
        """Drop the fragments and give their octets back; idempotent."""
        self._fragments.clear()
        self._budget.give_back(self._held, self._holder)
        self._held = 0
