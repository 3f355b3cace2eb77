"""Errors that end a command with one line for the user instead of a traceback."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Final

# How close a name must be to one that is suggested, from 0 to 1, and the most that are suggested.
_CLOSE: Final = 0.7
_MOST: Final = 3
# How much less close than the closest name another one may be.
_BESIDE: Final = 0.15
# The least letters of a beginning that counts as close to every name with this beginning.
_BEGINNING: Final = 3


class ToolError(RuntimeError):
    """A command cannot do its work. The text says why, and what to do."""


class UsageError(ToolError):
    """A command line or an environment variable is wrong."""


def did_you_mean(name: str, known: Iterable[str]) -> str:
    """Return a suggestion such as ``; did you mean 'topic'?``, or nothing if no name is close.

    Case does not count. Of names that are as close, the first in ``known`` comes first.
    """
    close = closest(name, known)
    return f"; did you mean {' or '.join(map(repr, close))}?" if close else ""


def closest(name: str, known: Iterable[str]) -> list[str]:
    """Return at most three known names that come about as close to ``name``, the closest first.

    Close are: a similar name, one with the same letters in another order, one with this beginning,
    and for a name with slashes one with the same last part.
    """
    from difflib import SequenceMatcher

    lower = name.lower()
    last = lower.rpartition("/")[2] if "/" in lower else ""
    ranked = []
    for candidate in dict.fromkeys(known):
        other = candidate.lower()
        if other == lower:
            return [candidate]
        ratio = SequenceMatcher(None, lower, other).ratio()
        begins = len(lower) >= _BEGINNING and other.startswith(lower)
        ends = bool(last) and other.rpartition("/")[2] == last
        swapped = sorted(lower) == sorted(other)
        if ratio >= _CLOSE or begins or ends or swapped:
            ranked.append((ratio, candidate))
    ranked.sort(key=lambda pair: -pair[0])
    return [each for ratio, each in ranked[:_MOST] if ratio > ranked[0][0] - _BESIDE]
