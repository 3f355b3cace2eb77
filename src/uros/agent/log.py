"""Log lines in the columns of the C++ agent::

    [1763750000.123456] info     | ProxyClient        | create_topic             | topic created                  | client_key: 0x4B0CBE99, topic_id: 0x000(2), participant_id: 0x000(1)

Time, level, part, function, what happened, whom it concerns. The levels of
``-v``: 0 off, 1 critical, 2 error, 3 warning, 4 info, 5 debug (every message's
length), 6 trace (its bytes).
"""  # noqa: E501

from __future__ import annotations

import sys
import time
from typing import Final, TextIO

CRITICAL: Final = 1
ERROR: Final = 2
WARNING: Final = 3
INFO: Final = 4
DEBUG: Final = 5
TRACE: Final = 6

_NAMES = ("off", "critical", "error", "warning", "info", "debug", "trace")
_COLOURS = ("", "\033[1;41m", "\033[1;31m", "\033[1;33m", "\033[32m", "\033[36m", "\033[37m")


class Log:
    """Writes lines up to ``level`` to ``stream`` (standard output)."""

    def __init__(self, level: int = INFO, stream: TextIO | None = None) -> None:
        self.level = level
        self._stream = stream or sys.stdout
        self._colour = self._stream.isatty()

    def __call__(self, level: int, part: str, function: str, what: str, about: str = "") -> None:
        if level > self.level:
            return
        now = time.time_ns() // 1000
        name = f"{_NAMES[level]:<8}"
        if self._colour:
            name = f"{_COLOURS[level]}{name}\033[0m"
        line = (
            f"[{now // 1_000_000}.{now % 1_000_000:06d}] {name} | {part:<18} | {function:<24} |"
            f" {what:<30} | {about}".rstrip()
        )
        try:
            self._stream.write(line + "\n")
            self._stream.flush()
        except (OSError, ValueError):
            self.level = 0  # nobody reads us any more; boards still need us

    def info(self, part: str, function: str, what: str, about: str = "") -> None:
        self(INFO, part, function, what, about)

    def warning(self, part: str, function: str, what: str, about: str = "") -> None:
        self(WARNING, part, function, what, about)

    def error(self, part: str, function: str, what: str, about: str = "") -> None:
        self(ERROR, part, function, what, about)

    def debug(self, part: str, function: str, what: str, about: str = "") -> None:
        self(DEBUG, part, function, what, about)


class RateLimit:
    """Lets a kind of line through at most once in ``seconds``; a flood of bad
    packets must not become a flood of lines."""

    def __init__(self, seconds: float = 1.0) -> None:
        self._seconds = seconds
        self._next: dict[str, float] = {}
        self._held: dict[str, int] = {}

    def admit(self, kind: str) -> int:
        """0: keep silent. Else how many of the kind this line stands for."""
        now = time.monotonic()
        if now < self._next.get(kind, 0.0):
            self._held[kind] = self._held.get(kind, 0) + 1
            return 0
        if len(self._next) > 256:
            self._next.clear()
            self._held.clear()
        self._next[kind] = now + self._seconds
        return self._held.pop(kind, 0) + 1
