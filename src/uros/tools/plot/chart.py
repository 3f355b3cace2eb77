"""Draws series of numbers with braille dots, two a column and four a line of the terminal."""

from __future__ import annotations

import math
import sys
from collections import deque
from collections.abc import Sequence
from typing import Final

# The most points that a series keeps: a fast topic must not use up the memory.
_MOST: Final = 20_000
_COLOURS: Final = (36, 33, 35, 32, 34, 31)
_PLAIN: Final = "\033[0m"
_BRAILLE: Final = 0x2800
# The bit of each dot of a cell, by column and line.
_DOTS: Final = ((0x01, 0x02, 0x04, 0x40), (0x08, 0x10, 0x20, 0x80))
# The part of a value by which others differ from it so little that they count as equal.
_EQUAL: Final = 1e-12
_LABEL: Final = 11  # columns of a number beside the axis
_LEAST: Final = (_LABEL + 5, 3)


class Series:
    """The latest points of a number.

    Args:
        name: What the legend calls it.
    """

    def __init__(self, name: str) -> None:
        self.name = name
        self.points: deque[tuple[float, float]] = deque(maxlen=_MOST)

    def add(self, at: float, value: float) -> None:
        """Add a point at a time in seconds; a value that is not finite is a gap."""
        self.points.append((at, value))

    def since(self, start: float) -> list[tuple[float, float]]:
        """Return the points from a time on, and forget older ones."""
        while self.points and self.points[0][0] < start:
            self.points.popleft()
        return [point for point in self.points if math.isfinite(point[1])]


def draw(
    series: Sequence[Series], now: float, window: float, columns: int, lines: int
) -> list[str]:
    """Return the lines of a chart with its axes and a legend below.

    Args:
        series: What to draw.
        now: The time at the right end, in seconds.
        window: The seconds from left to right.
        columns: Columns of the terminal.
        lines: Lines of the terminal.
    """
    drawn = [one.since(now - window) for one in series]
    legend = [
        f"\033[{_COLOURS[at % len(_COLOURS)]}m{_legend(one, points)[:columns]}{_PLAIN}"
        for at, (one, points) in enumerate(zip(series, drawn, strict=True))
    ]
    height, width = lines - len(legend) - 1, columns - _LABEL - 1
    if height < _LEAST[1] or columns < _LEAST[0]:
        return legend[:lines]
    low, high = _range([value for points in drawn for _, value in points])
    cells = [[0] * width for _ in range(height)]
    colours = [[0] * width for _ in range(height)]
    for at, points in enumerate(drawn):
        dots = [
            (
                (2 * width - 1) * (1 - (now - time) / window),
                (4 * height - 1) * ((high / 2 - value / 2) / (high / 2 - low / 2)),
            )
            for time, value in points
        ]
        for x, y in _line(dots):
            cells[y // 4][x // 2] |= _DOTS[x % 2][y % 4]
            colours[y // 4][x // 2] = _COLOURS[at % len(_COLOURS)]
    labels = {0: high, height // 2: low / 2 + high / 2, height - 1: low}
    out = []
    for row in range(height):
        label = f"{labels[row]:>{_LABEL}.4g}" if row in labels else " " * _LABEL
        out.append(f"{label}┤{_row(cells[row], colours[row])}")
    left, right = f"-{window:g} s", "now"
    axis = " " * (_LABEL + 1) + left + right.rjust(max(1, width - len(left)))
    out.append(axis[:columns])
    return [*out, *legend]


def _legend(one: Series, points: Sequence[tuple[float, float]]) -> str:
    if not points:
        return f"{one.name}: nothing yet"
    values = [value for _, value in points]
    return (
        f"{one.name}: {values[-1]:.6g}  (min {min(values):.6g}, max {max(values):.6g},"
        f" {len(values)} points)"
    )


def _range(values: Sequence[float]) -> tuple[float, float]:
    """Return the ends of the axis, which are never equal."""
    if not values:
        return 0.0, 1.0
    low, high = min(values), max(values)
    # Halves, since the difference of two large numbers may be infinite.
    if high / 2 - low / 2 > _EQUAL * max(abs(low), abs(high)):
        return low, high
    beside = abs(low) * 0.1 or 1.0
    return max(low - beside, -sys.float_info.max), min(high + beside, sys.float_info.max)


def _line(dots: Sequence[tuple[float, float]]) -> set[tuple[int, int]]:
    """Return the dots on the lines between points."""
    found = {(round(x), round(y)) for x, y in dots}
    for (x, y), (to_x, to_y) in zip(dots, dots[1:], strict=False):
        steps = int(max(abs(to_x - x), abs(to_y - y)))
        for step in range(1, steps):
            part = step / steps
            found.add((round(x + (to_x - x) * part), round(y + (to_y - y) * part)))
    return found


def _row(cells: Sequence[int], colours: Sequence[int]) -> str:
    text, before = "", 0
    for bits, colour in zip(cells, colours, strict=True):
        if bits and colour != before:
            text += f"\033[{colour}m"
            before = colour
        text += chr(_BRAILLE + bits) if bits else " "
    return text + _PLAIN if before else text
