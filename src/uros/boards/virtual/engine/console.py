"""What a core prints, line by line."""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import Final

_TRACEBACK_LINES: Final = 200  # held back until its last one comes


class Console:
    """Puts lines together and gives them to ``send``."""

    def __init__(self, send: Callable[[str], None]) -> None:
        self._send = send
        self._unfinished = ""
        self._once = Once()

    def print(self, text: str) -> None:
        *lines, self._unfinished = (self._unfinished + text).split("\n")
        for line in lines:
            for told in self._once.pass_on(line.rstrip("\r")):
                self._send(told)

    def flush(self) -> None:
        """End the line that is being printed."""
        if self._unfinished:
            self.print("\n")
        for line in self._once.flush():
            self._send(line)

    def forget(self) -> None:
        """The program starts anew: what was told is told again."""
        self.flush()
        self._once = Once()


class Once:
    """Lets the traceback of a fault of one field through once: a program that goes on meets it at
    each turn of its timer.
    """

    _FAULT: Final = re.compile(r"\w+Error: \w+/(?:msg|srv|action)/\w+(?:[.\w]*:| has no field \w+)")

    def __init__(self) -> None:
        self._held: list[str] = []  # of a traceback whose last line is to come
        self._seen: set[str] = set()

    def pass_on(self, line: str) -> list[str]:
        """The lines to show, now that this one is there."""
        inside = line.startswith("  ") and self._held
        if line.startswith("Traceback (most") or inside:
            return [] if self._hold(line) else self.flush()
        fault = self._FAULT.match(line)
        if fault and self._held:
            if fault[0] in self._seen:
                self._held.clear()
                return []
            self._seen.add(fault[0])
        return [*self.flush(), line]

    def _hold(self, line: str) -> bool:
        self._held.append(line)
        return len(self._held) < _TRACEBACK_LINES

    def flush(self) -> list[str]:
        """What is held back."""
        held, self._held = self._held, []
        return held
