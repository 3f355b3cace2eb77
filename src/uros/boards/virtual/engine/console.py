"""Splits a core's output into lines."""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import Final

# A traceback is held back until its last line, but at most this many lines of it.
_TRACEBACK_LINES: Final = 200
# The most tracebacks that are counted; the counts of older ones are dropped.
_MOST_COUNTED: Final = 100


class Console:
    """Assembles lines from the output, and passes them to ``send``."""

    def __init__(self, send: Callable[[str], None]) -> None:
        self._send = send
        self._unfinished = ""
        self._tracebacks = Tracebacks()

    def print(self, text: str) -> None:
        """Take output; lines that it completes are sent."""
        *lines, self._unfinished = (self._unfinished + text).split("\n")
        for line in lines:
            for shown in self._tracebacks.pass_on(line.rstrip("\r")):
                self._send(shown)

    def flush(self) -> None:
        """End an unfinished line, and send lines that are held back."""
        if self._unfinished:
            self.print("\n")
        for line in self._tracebacks.flush():
            self._send(line)

    def forget(self) -> None:
        """Start anew with the program: errors that were shown are shown again."""
        self.flush()
        self._tracebacks = Tracebacks()


class Tracebacks:
    """Passes each traceback on once; a repeated one becomes a line with a count at 2, 4, 8 ....

    A program that continues raises the same error at each turn of its timer. That of an invalid
    field is not counted: the program works without that field.
    """

    _FAULT: Final = re.compile(r"\w+Error: \w+/(?:msg|srv|action)/\w+(?:[.\w]*:| has no field \w+)")

    def __init__(self) -> None:
        self._held: list[str] = []  # lines of an unfinished traceback
        self._faults: set[str] = set()  # of fields, whose traceback was passed on
        self._counts: dict[tuple[str, ...], int] = {}  # of other tracebacks, by their lines

    def pass_on(self, line: str) -> list[str]:
        """Return the lines to show after this one has arrived."""
        inside = line.startswith("  ") and self._held
        if line.startswith("Traceback (most") or inside:
            ended = [] if inside else self.flush()
            self._held.append(line)
            return ended if len(self._held) < _TRACEBACK_LINES else self.flush()
        if not self._held:
            return [line]
        if fault := self._FAULT.match(line):
            if fault[0] in self._faults:
                self._held.clear()
                return []
            self._faults.add(fault[0])
        elif count := self._count(line):
            self._held.clear()
            return [] if count & (count - 1) else [f"{line} (the same error, {count} times)"]
        return [*self.flush(), line]

    def _count(self, line: str) -> int:
        """Count the traceback that ends with this line; return 0 if it is the first."""
        traceback = (*self._held, line)
        count = self._counts.pop(traceback, 0) + 1
        self._counts[traceback] = count
        if len(self._counts) > _MOST_COUNTED:
            del self._counts[next(iter(self._counts))]
        return count if count > 1 else 0

    def flush(self) -> list[str]:
        """Return the lines that are held back, and release them."""
        held, self._held = self._held, []
        return held
