"""The result of a check of ``uros doctor``."""

from __future__ import annotations

import shlex
from dataclasses import asdict, dataclass
from typing import Final

OK: Final = "ok"
# Not a fault by itself, but often the cause that somebody looks for.
NOTE: Final = "note"
PROBLEM: Final = "problem"
UNKNOWN: Final = "unknown"


def word(text: str) -> str:
    """Quote a text as one word of a shell command.

    Attack: a topic or a node whose name is a command, in a line that people copy into a shell.
    """
    return shlex.quote(text)


@dataclass(frozen=True)
class Finding:
    """What a check found.

    Attributes:
        check: The check, in a word or two.
        state: OK, NOTE, PROBLEM or UNKNOWN.
        what: One sentence.
        fix: The command or the change that fixes it; empty if nothing is to be fixed.
    """

    check: str
    state: str
    what: str
    fix: str = ""

    def plain(self) -> dict[str, str]:
        """Return the fields for JSON."""
        return asdict(self)


def ok(check: str, what: str, fix: str = "") -> Finding:
    """Return the finding of a check that passed."""
    return Finding(check, OK, what, fix)


def note(check: str, what: str, fix: str = "") -> Finding:
    """Return a finding that is worth knowing, but no fault by itself."""
    return Finding(check, NOTE, what, fix)


def problem(check: str, what: str, fix: str) -> Finding:
    """Return the finding of a fault, with its fix."""
    return Finding(check, PROBLEM, what, fix)


def unknown(check: str, what: str, fix: str = "") -> Finding:
    """Return the finding of a check that could not be made; ``what`` says why."""
    return Finding(check, UNKNOWN, what, fix)
