"""What a check of ``uros doctor`` has found out."""

from __future__ import annotations

import shlex
from dataclasses import asdict, dataclass
from typing import Final

OK: Final = "ok"
# Nothing that is wrong by itself, but often what somebody looks for.
NOTE: Final = "note"
PROBLEM: Final = "problem"
UNKNOWN: Final = "unknown"


def word(text: str) -> str:
    """As one word of a command.

    Attack: a topic or a node whose name is a command, in a line that people copy into a shell.
    """
    return shlex.quote(text)


@dataclass(frozen=True)
class Finding:
    """``check``: which one, in a word; ``what``: one sentence; ``mend``: the command or the change
    that mends it, and empty where there is nothing to mend.
    """

    check: str
    state: str
    what: str
    mend: str = ""

    def plain(self) -> dict[str, str]:
        return asdict(self)


def ok(check: str, what: str, mend: str = "") -> Finding:
    return Finding(check, OK, what, mend)


def note(check: str, what: str, mend: str = "") -> Finding:
    return Finding(check, NOTE, what, mend)


def problem(check: str, what: str, mend: str) -> Finding:
    return Finding(check, PROBLEM, what, mend)


def unknown(check: str, what: str, mend: str = "") -> Finding:
    """The check could not be made; ``what`` says why."""
    return Finding(check, UNKNOWN, what, mend)
