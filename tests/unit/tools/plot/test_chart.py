"""The chart that ``uros plot`` draws."""

import math
import re

import pytest
from hypothesis import given
from hypothesis import strategies as st

from uros.tools.plot.chart import Series, draw


def plain(lines):
    return [re.sub(r"\033\[\d+m", "", line) for line in lines]


def series(*points, name="/x/y"):
    one = Series(name)
    for at, value in points:
        one.add(at, value)
    return one


def test_a_rising_line_goes_from_corner_to_corner():
    lines = plain(draw([series((0.0, 0.0), (10.0, 1.0))], 10.0, 10.0, 32, 12))
    assert len(lines) == 12 and all(len(line) <= 32 for line in lines[:-1])
    rows = [line.partition("┤")[2] for line in lines[:10]]
    assert rows[-1][0] != " " and rows[0][-1] != " " and rows[0][0] == " "
    assert lines[0].split("┤")[0].strip() == "1" and lines[9].split("┤")[0].strip() == "0"
    assert lines[10].split() == ["-10", "s", "now"]
    assert lines[11] == "/x/y: 1  (min 0, max 1, 2 points)"[:32]


def test_points_move_to_the_left_and_leave():
    one = series((0.0, 5.0), (9.0, 6.0))
    draw([one], 10.0, 10.0, 80, 24)
    assert len(one.points) == 2
    draw([one], 12.0, 10.0, 80, 24)
    assert list(one.points) == [(9.0, 6.0)]


def test_each_series_has_its_colour_and_its_line_of_the_legend():
    two = [series((1.0, 1.0), (9.0, 1.0), name="/a"), series((1.0, 2.0), (9.0, 2.0), name="/b")]
    lines = draw([*two, series(name="/c")], 10.0, 10.0, 80, 24)
    assert len(lines) == 24
    assert "\033[36m/a: 1 " in lines[-3] and "\033[33m/b: 2 " in lines[-2]
    assert "/c: nothing yet" in lines[-1]
    assert "\033[33m" in lines[0] and "\033[36m" in lines[19]


def test_values_that_are_not_finite_are_gaps():
    lines = plain(draw([series((1.0, math.nan), (2.0, math.inf), (3.0, 4.0))], 5.0, 5.0, 80, 24))
    assert "1 points" in lines[-1]


@pytest.mark.parametrize("columns, lines", [(80, 24), (10, 24), (80, 3), (1, 1), (200, 60)])
def test_it_fits_any_terminal(columns, lines):
    some = [series((1.0, 1.0), (2.0, 2.0), name="/long/name" * 30), series(name="/b")]
    drawn = plain(draw(some, 3.0, 3.0, columns, lines))
    assert len(drawn) <= lines and all(len(line) <= columns for line in drawn)


@given(
    st.lists(st.tuples(st.floats(0, 10), st.floats(allow_nan=True)), max_size=20),
    st.integers(1, 100), st.integers(1, 40),
)  # fmt: skip
def test_any_values_are_drawn(points, columns, lines):
    points.sort(key=lambda point: point[0])
    drawn = plain(draw([series(*points)], 10.0, 10.0, columns, lines))
    assert len(drawn) <= lines and all(len(line) <= columns for line in drawn)
