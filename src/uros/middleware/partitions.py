"""Which partitions of a writer and a reader meet (DDS 2.2.3.13): names, and patterns of names.

Lists of partitions come from the network, so that a comparison must cost little for any of them:
no regular expression is compiled or kept, and a pattern costs one step for each of its signs.
"""

from __future__ import annotations

from bisect import bisect_left, bisect_right
from collections.abc import Sequence
from typing import Final

# Attack: as many patterns as an announcement holds, compared with as many names. Octets of patterns
# that are compared for two lists; those beyond meet nothing. All take 10 ms.
_MAX_COMPARED: Final = 1 << 15


def meet(offered: Sequence[str], requested: Sequence[str]) -> bool:
    """Return whether two lists of partitions have one in common.

    A pattern (``*``, ``?``, ``[…]``) matches names, but no pattern, not even itself. An empty list
    is the partition ``''``.
    """
    offers, requests = _Partitions(offered), _Partitions(requested)
    if not set(offers.names).isdisjoint(requests.names):
        return True
    compared = 0
    for names, patterns in ((offers.names, requests.patterns), (requests.names, offers.patterns)):
        prepared = [_Name(name) for name in names] if patterns else []
        for pattern in patterns:
            for name in prepared:
                compared += len(pattern)
                if compared > _MAX_COMPARED:
                    return False
                if name.matches(pattern):
                    return True
    return False


class _Partitions:
    """A list of partitions: its names, and its patterns, the short ones first."""

    def __init__(self, listed: Sequence[str]) -> None:
        found = dict.fromkeys(listed or ("",))
        self.patterns = sorted((one for one in found if _is_pattern(one)), key=len)
        self.names = [one for one in found if not _is_pattern(one)]


def _is_pattern(partition: str) -> bool:
    return any(sign in partition for sign in "*?[")


class _Name:
    """A name that is compared with patterns.

    Sets of places in it are integers: bit n stands for the place before character n.
    """

    def __init__(self, name: str) -> None:
        self._at: dict[str, int] = {}
        for place, letter in enumerate(name):
            self._at[letter] = self._at.get(letter, 0) | 1 << place
        self._all = (1 << len(name)) - 1
        self._end = 1 << len(name)
        self._letters = sorted(self._at)
        # The places of the first letters, by their number.
        self._first = [0]
        for letter in self._letters:
            self._first.append(self._first[-1] | self._at[letter])

    def matches(self, pattern: str) -> bool:
        """Return whether the whole name matches a pattern."""
        reached, place = 1, 0  # the places that the pattern so far leads to
        while place < len(pattern) and reached:
            sign = pattern[place]
            place += 1
            if sign == "*":
                # All places from the first one on.
                reached = (self._all | self._end) & -(reached & -reached)
                continue
            if sign == "?":
                fits = self._all
            elif sign == "[" and (end := _end_of_set(pattern, place)) > 0:
                fits, place = self._fits(pattern[place:end]), end + 1
            else:
                fits = self._at.get(sign, 0)
            reached = (reached & fits) << 1
        return bool(reached & self._end)

    def _between(self, low: str, high: str) -> int:
        """The places of the letters of a range."""
        begin, end = bisect_left(self._letters, low), bisect_right(self._letters, high)
        return self._first[end] & ~self._first[begin] if begin < end else 0

    def _fits(self, letters: str) -> int:
        """The places of the letters of a set: single ones and ranges, or others after ``!``."""
        negates = letters.startswith("!")
        place, fits = int(negates), 0
        while place < len(letters):
            is_range = letters[place + 1 : place + 2] == "-" and place + 2 < len(letters)
            last = place + 2 if is_range else place
            fits |= self._between(letters[place], letters[last])
            place = last + 1
        return self._all & ~fits if negates else fits


def _end_of_set(pattern: str, begin: int) -> int:
    """Return the place of the bracket that ends a set, or -1. One at the begin belongs to it."""
    first = begin + pattern.startswith("!", begin)
    return pattern.find("]", first + 1)
