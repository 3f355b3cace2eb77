"""Prints lines, and on a terminal a table of boards above them.

The table has the first rows of the terminal. Lines and what is typed scroll below it.
"""

from __future__ import annotations

import shutil
import sys
import textwrap
from collections.abc import Sequence
from typing import Final, NamedTuple

from ...printable import printable, unguarded

_LEAST_LINES: Final = 5  # below the table, or no table is drawn


class Row(NamedTuple):
    """A row of a table: its cells, and texts below them, each of which may take several lines."""

    cells: Sequence[str]
    below: Sequence[str] = ()


class Screen:
    """The terminal, or a pipe. ``live`` is whether there is a table."""

    def __init__(self) -> None:
        self.live = sys.stdout.isatty()
        self._size = (0, 0)
        self._rows = 0

    def say(self, text: str) -> None:
        """Print a line below the table."""
        print(printable(text, "\n\t"), flush=True)

    def show(self, table: Sequence[Row]) -> None:
        """Draw the table again."""
        if not self.live or not table:
            return
        size = shutil.get_terminal_size()
        lines = layout(table, size.columns)
        most = size.lines - _LEAST_LINES - 1
        if most < len(table):
            return
        lines = lines[:most]
        # It never shrinks: the lines below would jump up and down.
        rows = max(len(lines) + 1, self._rows)
        lines += [""] * (rows - 1 - len(lines))
        out = []
        if (size.columns, size.lines) != self._size or rows != self._rows:
            if not self._rows:
                out.append("\n" * size.lines)  # earlier output scrolls up and is not lost
            self._size = (size.columns, size.lines)
            self._rows = rows
            out.append(f"\033[{rows + 1};{size.lines}r\033[{size.lines};1H")
        out.append("\0337\033[H")
        for line in (*lines, "─" * size.columns):
            out.append(f"{line}\033[K\r\n")
        out.append("\0338")
        _draw("".join(out))

    def close(self) -> None:
        """Restore the terminal. The table stays where it is."""
        if self._rows:
            self._rows = 0
            _draw(f"\033[r\033[{self._size[1]};1H\n")


def _draw(text: str) -> None:
    out = unguarded(sys.stdout)
    out.write(text)
    out.flush()


def layout(table: Sequence[Row], columns: int) -> list[str]:
    """Return the rows as lines, none longer than ``columns``. Their text is made `printable`."""
    table = [Row([*map(printable, row.cells)], [*map(printable, row.below)]) for row in table]
    widths = [max(len(row.cells[i]) for row in table) for i in range(len(table[0].cells))]
    lines = []
    for row in table:
        cells = [cell.ljust(width) for cell, width in zip(row.cells, widths, strict=True)]
        line = "  ".join(cells).rstrip()
        lines.append(line if len(line) <= columns else line[: columns - 1] + "…")
        for text in row.below:
            lines += textwrap.wrap(
                text, max(columns, 20), initial_indent="  ", subsequent_indent="  "
            )
    return lines
