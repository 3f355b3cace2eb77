"""Errors that end a command with one line for the user instead of a traceback."""

from __future__ import annotations

from collections.abc import Iterable


class ToolError(RuntimeError):
    """A command cannot do its work. The text says why, and what to do."""


class UsageError(ToolError):
    """A command line or an environment variable is wrong."""


def did_you_mean(name: str, known: Iterable[str]) -> str:
    """Return a suggestion such as ``; did you mean 'topic'?``, or nothing if no name is close.

    Case does not count. Of names that are as close, the first in ``known`` comes first.
    """
    from ..similar import closest

    close = closest(name, known)
    return f"; did you mean {' or '.join(map(repr, close))}?" if close else ""
