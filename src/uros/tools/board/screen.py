"""Where a session with boards is shown: lines as they come, and on a terminal a table above them.

The table has the first rows of the terminal, the lines scroll below it, and so does what is typed.
"""

from __future__ import annotations

import shutil
import sys
import textwrap
from collections.abc import Sequence
from typing import Final, NamedTuple

from ...printable import printable, unguarded

_LEAST_LINES: Final = 5  # below the table, or it is not worth the trouble


class Row(NamedTuple):
    """Of a table: its cells, and what stands below them in as many lines as it takes."""

    cells: Sequence[str]
    below: str = ""


class Screen:
    """``live``: whether there is a table at all."""

    def __init__(self) -> None:
        self.live = sys.stdout.isatty()
        self._size = (0, 0)
        self._rows = 0

    def say(self, text: str) -> None:
        """A line below the table."""
        print(printable(text, "\n\t"), flush=True)

    def show(self, table: Sequence[Row]) -> None:
        """Draw the table anew."""
        if not self.live or not table:
            return
        size = shutil.get_terminal_size()
        lines = layout(table, size.columns)
        most = size.lines - _LEAST_LINES - 1
        if most < len(table):
            return
        lines = lines[:most]
        # It never becomes shorter: what scrolls below would jump up and down.
        rows = max(len(lines) + 1, self._rows)
        lines += [""] * (rows - 1 - len(lines))
        out = []
        if (size.columns, size.lines) != self._size or rows != self._rows:
            if not self._rows:
                out.append("\n" * size.lines)  # what was there goes up, and is not lost
            self._size = (size.columns, size.lines)
            self._rows = rows
            out.append(f"\033[{rows + 1};{size.lines}r\033[{size.lines};1H")
        out.append("\0337\033[H")
        for line in (*lines, "─" * size.columns):
            out.append(f"{line}\033[K\r\n")
        out.append("\0338")
        _draw("".join(out))

    def close(self) -> None:
        """The terminal is an ordinary one again; the table stays where it is."""
        if self._rows:
            self._rows = 0
            _draw(f"\033[r\033[{self._size[1]};1H\n")


def _draw(text: str) -> None:
    out = unguarded(sys.stdout)
    out.write(text)
    out.flush()


def layout(table: Sequence[Row], columns: int) -> list[str]:
    """The rows as lines, none longer than ``columns``; their text is made `printable`."""
    table = [Row([*map(printable, row.cells)], printable(row.below)) for row in table]
    widths = [max(len(row.cells[i]) for row in table) for i in range(len(table[0].cells))]
    lines = []
    for row in table:
        cells = [cell.ljust(width) for cell, width in zip(row.cells, widths, strict=True)]
        line = "  ".join(cells).rstrip()
        lines.append(line if len(line) <= columns else line[: columns - 1] + "…")
        lines += textwrap.wrap(
            row.below, max(columns, 20), initial_indent="  ", subsequent_indent="  "
        )
    return lines
