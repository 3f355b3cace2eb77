"""The result of a check of ``uros doctor``."""

from __future__ import annotations

import shlex
from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Final

OK: Final = "ok"
# Not a fault by itself, but often the cause that somebody looks for.
NOTE: Final = "note"
PROBLEM: Final = "problem"
UNKNOWN: Final = "unknown"
# As many findings that are alike are printed as one, and so many of the others are named in it.
_ALIKE: Final = 4
_NAMED: Final = 3


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
        about: What the sentence is about, if a check may find the same of many: a board, a topic.
        kind: Findings of one check, state and kind about several are alike.
    """

    check: str
    state: str
    what: str
    fix: str = ""
    about: str = ""
    kind: str = ""

    def plain(self) -> dict[str, str]:
        """Return the fields for JSON."""
        return {"check": self.check, "state": self.state, "what": self.what, "fix": self.fix}


def ok(check: str, what: str, fix: str = "", about: str = "") -> Finding:
    """Return the finding of a check that passed."""
    return Finding(check, OK, what, fix, about)


def note(check: str, what: str, fix: str = "", about: str = "", kind: str = "") -> Finding:
    """Return a finding that is worth knowing, but no fault by itself."""
    return Finding(check, NOTE, what, fix, about, kind)


def problem(check: str, what: str, fix: str, about: str = "", kind: str = "") -> Finding:
    """Return the finding of a fault, with its fix."""
    return Finding(check, PROBLEM, what, fix, about, kind)


def unknown(check: str, what: str, fix: str = "") -> Finding:
    """Return the finding of a check that could not be made; ``what`` says why."""
    return Finding(check, UNKNOWN, what, fix)


def merge_alike(findings: Iterable[Finding]) -> list[Finding]:
    """Return findings as they are printed: many that are alike as one, which names some of them.

    Args:
        findings: The findings of one check.
    """
    groups: dict[tuple[str, ...], list[Finding]] = {}
    for finding in findings:
        alike = (finding.check, finding.state, finding.kind)
        key = alike if finding.about else (*alike, finding.what, finding.fix)
        groups.setdefault(key, []).append(finding)
    merged = []
    for group in groups.values():
        merged += [_merge(group)] if len(group) >= _ALIKE else group
    return merged


def _merge(group: list[Finding]) -> Finding:
    first, *others = group
    named = ", ".join(finding.about for finding in others[:_NAMED])
    more = f" and {len(others) - _NAMED} more" if len(others) > _NAMED else ""
    what = f"{len(group)} alike: {first.what}; also {named}{more} (--json has each)"
    fix = first.fix
    if any(finding.fix != fix for finding in others):
        fix += ", and the others likewise"
    return replace(first, what=what, fix=fix)
