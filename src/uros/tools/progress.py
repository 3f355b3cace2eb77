"""The progress of a command that takes seconds, on standard error."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from types import TracebackType
from typing import Final

from ..printable import unguarded

# Seconds between two lines where standard error is no terminal; on a terminal the line is replaced.
_SELDOM: Final = 5.0
_OFTEN: Final = 0.1


class Progress:
    """A line such as ``42 of 240 packages``; a context manager, which removes it from a terminal.

    Args:
        what: What is counted.
        clock: Returns seconds.
    """

    def __init__(self, what: str, clock: Callable[[], float] = time.monotonic) -> None:
        self._what = what
        self._clock = clock
        self._live = sys.stderr.isatty()
        self._next = clock()

    def show(self, done: int, total: int) -> None:
        """Print the progress, unless that was just done.

        Args:
            done: How many are done.
            total: How many there are.
        """
        now = self._clock()
        if now < self._next:
            return
        self._next = now + (_OFTEN if self._live else _SELDOM)
        text = f"{done} of {total} {self._what}"
        if self._live:
            print(f"\r{text}\033[K", end="", file=unguarded(sys.stderr), flush=True)
        else:
            print(text, file=sys.stderr, flush=True)

    def __enter__(self) -> Progress:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        if self._live:
            print("\r\033[K", end="", file=unguarded(sys.stderr), flush=True)
