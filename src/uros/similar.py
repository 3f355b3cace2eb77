"""Names that come close to an unknown one, for errors that say what was meant."""

from __future__ import annotations

from collections.abc import Iterable
from difflib import SequenceMatcher
from os.path import commonprefix
from typing import Final

# The most names that are suggested: of those that are nearest, and of those that are only alike.
_MOST_NEAREST: Final = 5
_MOST_ALIKE: Final = 3
# The share of letters that names have in common to be alike, from 0 to 1.
_ALIKE: Final = 0.7
# How much less alike than the one most alike another one may be.
_BESIDE: Final = 0.15
# The least letters of a beginning that counts as close to every name with this beginning.
_BEGINNING: Final = 3
# Letters that may lack behind a beginning to come before names with a slip.
_LACKING: Final = 2
# The length from which a name may have two slips.
_LONG: Final = 8


def closest(name: str, known: Iterable[str], alike: float = _ALIKE) -> list[str]:
    """Return the few known names that come about as close to ``name``, the closest first.

    Case does not count. Nearest are names that begin with ``name`` and have few letters more, then
    names that differ by a letter, or two of a long name; only without those, the ones that are
    alike, have the same letters in another order, or of names with slashes the same last part.

    Args:
        name: The unknown name.
        known: The names that there are.
        alike: The share of letters that names have in common to count as alike, from 0 to 1.
    """
    lower = name.lower()
    others = {candidate: candidate.lower() for candidate in dict.fromkeys(known)}
    for candidate, other in others.items():
        if other == lower:
            return [candidate]
    longer = _longer(name, others) if len(name) >= _BEGINNING else []
    if longer and len(longer[0]) - len(name) <= _LACKING:
        return longer
    return _slipped(lower, others) or longer or _alike(lower, others, alike)


def _longer(name: str, others: dict[str, str]) -> list[str]:
    """Return the names that begin with this one and are not much longer than the shortest."""
    lower = name.lower()
    found = [candidate for candidate, other in others.items() if other.startswith(lower)]
    found = [each for each in found if each.startswith(name)] or found  # a class, not its module
    found.sort(key=len)
    return [each for each in found[:_MOST_NEAREST] if len(each) + len(name) <= 2 * len(found[0])]


def _slipped(lower: str, others: dict[str, str]) -> list[str]:
    """Return the names with the fewest letters wrong, if these are few enough."""
    if len(lower) < _BEGINNING:
        return []
    most = 2 if len(lower) >= _LONG else 1
    slips = {
        candidate: _distance(lower, other)
        for candidate, other in others.items()
        if abs(len(other) - len(lower)) <= most
    }
    least = min(slips.values(), default=most + 1)
    if least > most:
        return []
    return [candidate for candidate in slips if slips[candidate] == least][:_MOST_NEAREST]


def _distance(one: str, other: str) -> int:
    """Return how many letters are missing, too many, wrong, or swapped with the next one."""
    begin = len(commonprefix([one, other]))  # most names of a network begin and end alike
    one, other = one[begin:], other[begin:]
    end = len(commonprefix([one[::-1], other[::-1]]))
    one, other = one[: len(one) - end], other[: len(other) - end]
    before: list[int] = []
    row = list(range(len(other) + 1))
    for at, letter in enumerate(one):
        last, before, row = before, row, [at + 1]
        for to, wanted in enumerate(other):
            cost = min(before[to + 1] + 1, row[to] + 1, before[to] + (letter != wanted))
            if at and to and letter == other[to - 1] and one[at - 1] == wanted:
                cost = min(cost, last[to - 1] + 1)
            row.append(cost)
    return row[-1]


def _alike(lower: str, others: dict[str, str], alike: float) -> list[str]:
    last = lower.rpartition("/")[2] if "/" in lower else ""
    ranked = []
    for candidate, other in others.items():
        ratio = SequenceMatcher(None, lower, other).ratio()
        ends = bool(last) and other.rpartition("/")[2] == last
        if ratio >= alike or ends or sorted(lower) == sorted(other):
            ranked.append((ratio, candidate))
    ranked.sort(key=lambda pair: -pair[0])
    return [each for ratio, each in ranked[:_MOST_ALIKE] if ratio > ranked[0][0] - _BESIDE]
