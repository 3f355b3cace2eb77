"""Errors that end a command with one line for the user instead of a traceback."""

from __future__ import annotations

from collections.abc import Iterable


class ToolError(RuntimeError):
    """A command cannot do its work. The text says why, and what to do."""


def did_you_mean(name: str, known: Iterable[str]) -> str:
    """Return a suggestion such as ``; did you mean 'topic'?``, or nothing if no name is close.

    Case does not count.
    """
    import difflib

    by_lower = {candidate.lower(): candidate for candidate in known}
    matches = [name.lower()]
    if name.lower() not in by_lower:
        matches = difflib.get_close_matches(name.lower(), list(by_lower), 3, 0.7)
    close = [by_lower[match] for match in matches]
    return f"; did you mean {' or '.join(map(repr, close))}?" if close else ""
