"""Errors that end a command with one line for the user instead of a traceback."""

from __future__ import annotations

from collections.abc import Iterable


class ToolError(RuntimeError):
    """What the user asked for cannot be done; the text says why and what to do."""


def did_you_mean(name: str, known: Iterable[str]) -> str:
    """``; did you mean 'topic'?``, or nothing where no known name is close."""
    import difflib

    close = difflib.get_close_matches(name, list(known), 3, 0.7)
    return f"; did you mean {' or '.join(map(repr, close))}?" if close else ""
