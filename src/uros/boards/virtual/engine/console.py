"""Splits a core's output into lines."""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import Final

# A traceback is held back until its last line, but at most this many lines of it.
_TRACEBACK_LINES: Final = 200


class Console:
    """Assembles lines from the output, and passes them to ``send``."""

    def __init__(self, send: Callable[[str], None]) -> None:
        self._send = send
        self._unfinished = ""
        self._once = Once()

    def print(self, text: str) -> None:
        """Take output; lines that it completes are sent."""
        *lines, self._unfinished = (self._unfinished + text).split("\n")
        for line in lines:
            for shown in self._once.pass_on(line.rstrip("\r")):
                self._send(shown)

    def flush(self) -> None:
        """End an unfinished line, and send lines that are held back."""
        if self._unfinished:
            self.print("\n")
        for line in self._once.flush():
            self._send(line)

    def forget(self) -> None:
        """Start anew with the program: faults that were shown are shown again."""
        self.flush()
        self._once = Once()


class Once:
    """Passes the traceback of an invalid field on once only.

    A program that continues raises the same error at each turn of its timer.
    """

    _FAULT: Final = re.compile(r"\w+Error: \w+/(?:msg|srv|action)/\w+(?:[.\w]*:| has no field \w+)")

    def __init__(self) -> None:
        self._held: list[str] = []  # lines of an unfinished traceback
        self._faults: set[str] = set()  # whose traceback was passed on

    def pass_on(self, line: str) -> list[str]:
        """Return the lines to show after this one has arrived."""
        inside = line.startswith("  ") and self._held
        if line.startswith("Traceback (most") or inside:
            return [] if self._hold(line) else self.flush()
        fault = self._FAULT.match(line)
        if fault and self._held:
            if fault[0] in self._faults:
                self._held.clear()
                return []
            self._faults.add(fault[0])
        return [*self.flush(), line]

    def _hold(self, line: str) -> bool:
        self._held.append(line)
        return len(self._held) < _TRACEBACK_LINES

    def flush(self) -> list[str]:
        """Return the lines that are held back, and release them."""
        held, self._held = self._held, []
        return held
