"""The lines of a command that runs for long, and its state below them on a terminal."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from typing import Final

from ...printable import printable, unguarded

PERIOD: Final = 0.25
"""Seconds between two states on a terminal."""


class StatusLine:
    """Prints lines, and on a terminal the state behind them, without a line end.

    Args:
        period: Seconds between two states; 0 for each one, None for none.
        clock: Returns seconds.
    """

    def __init__(
        self, period: float | None = PERIOD, clock: Callable[[], float] = time.monotonic
    ) -> None:
        self._period = period or 0.0
        self._clock = clock
        self._is_live = period is not None and sys.stderr.isatty()
        self._next = clock()
        self._is_drawn = False

    def say(self, text: str) -> None:
        """Print a line on standard output."""
        self.clear()
        print(printable(text), flush=True)

    def warn(self, text: str) -> None:
        """Print a warning on standard error."""
        self.clear()
        print(f"WARNING: {printable(text)}", file=sys.stderr, flush=True)

    def show(self, text: Callable[[], str]) -> None:
        """Draw the state, unless that was just done or standard error is no terminal."""
        now = self._clock()
        if not self._is_live or now < self._next:
            return
        self._next = now + self._period
        self._is_drawn = True
        print(f"\r{printable(text())}\033[K", end="", file=unguarded(sys.stderr), flush=True)

    def clear(self) -> None:
        """Remove the state from the terminal."""
        if self._is_drawn:
            self._is_drawn = False
            print("\r\033[K", end="", file=unguarded(sys.stderr), flush=True)


def octets(count: int) -> str:
    """Return a number of octets with its unit, such as ``3.2 MiB``."""
    value, unit = float(count), "B"
    for unit in ("B", "KiB", "MiB", "GiB", "TiB"):
        if value < 1024 or unit == "TiB":
            break
        value /= 1024
    return f"{value:.0f} {unit}" if unit == "B" else f"{value:.1f} {unit}"
