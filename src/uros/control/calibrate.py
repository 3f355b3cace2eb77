"""Calibration of wheel radii and track from a drive whose poses were measured.

A square that closes does not determine the size of the wheels: with larger wheels it closes too.
Therefore measure the first corner, or another point far from the start, besides the end. Drive a
square in each direction: a difference of the radii looks like a shorter track in one of them and
like a longer one in the other.
"""

import math
from array import array

try:
    from typing import Final
except ImportError:
    pass

# Standard deviations of a pose that a person measures.
_METRES: Final = 0.005
_RADIANS: Final = 0.01
# Larger deviations from the nominal sizes are no manufacturing tolerances.
_RADIUS_OFF: Final = 0.1
_TRACK_OFF: Final = 0.2
# The largest RMS residual of the measured poses, in units of the above.
_MISFIT: Final = 6.0
# The largest relative standard deviation of a size.
_VAGUE: Final = 0.02
# Steps are merged up to this length, in metres.
_LONG: Final = 0.01


class CalibrationError(ValueError):
    """The data do not determine the sizes; the text says why and what to do."""


class Calibration:
    """Least-squares estimate of both radii and half the track.

    Call `add` for each step of the drive, and `measured` where the true pose was measured. Each
    drive begins at the pose 0, 0, 0; `restart` begins another one. `solve` sets ``right_radius``,
    ``left_radius``, ``d`` and ``misfit``, the RMS error of the measured poses in metres.

    Args:
        radius: Radius with which the Wheels computed the drive, in metres.
        d: Half the track with which it was computed, in metres.
    """

    def __init__(self, radius: float = 0.0325, d: float = 0.134) -> None:
        self.radius = radius
        self.d = d
        self.right_radius = radius
        self.left_radius = radius
        self.misfit = 0.0
        self._nominal_d = d
        self._rights = array("f")
        self._lefts = array("f")
        self._right = 0.0
        self._left = 0.0
        # (steps before it, x, y, theta or None), and (steps before it,) for a new drive.
        self._marks = []  # type: list[tuple[int, float, float, float | None] | tuple[int]]

    def add(self, right: float, left: float) -> None:
        """Add the distances of both wheels in one step, as of ``Wheel.moved``."""
        self._right += right
        self._left += left
        if abs(self._right) > _LONG or abs(self._left) > _LONG:
            self._close()

    def _close(self) -> None:
        self._rights.append(self._right)
        self._lefts.append(self._left)
        self._right = 0.0
        self._left = 0.0

    def measured(self, x: float, y: float, theta: "float | None" = None) -> None:
        """Add the measured pose at this step, relative to the start of the drive.

        Args:
            x: Metres ahead.
            y: Metres to the left.
            theta: Radians, counter-clockwise; None if it was not measured.

        Raises:
            CalibrationError: One of them is NaN or infinite.
        """
        if x - x != 0 or y - y != 0 or (theta is not None and theta - theta != 0):
            raise CalibrationError("a measured pose has to be numbers: metres and radians")
        self._close()
        self._marks.append((len(self._rights), x, y, theta))

    def restart(self) -> None:
        """Begin another drive: the rover was put back to the start."""
        self._close()
        self._marks.append((len(self._rights),))

    def solve(self, keep_radius: bool = False) -> None:
        """Set the sizes to their estimates.

        Args:
            keep_radius: Hold the mean of both radii, and estimate only their difference.

        Raises:
            CalibrationError: The data do not determine the sizes, which stay as they were.
        """
        way = 0.0
        for right, left in zip(self._rights, self._lefts):
            way += abs(right) + abs(left)
        poses = [mark for mark in self._marks if len(mark) == 4]
        if way < 1.0:
            raise CalibrationError("the drive is too short: drive half a metre or more")
        if not poses:
            raise CalibrationError("no pose was measured: measure the end, and the first corner")
        # Relative changes of the mean radius, of the difference of the radii and of the track.
        sizes = [0.0, 0.0, 0.0]
        held = (True, False, False) if keep_radius else (False, False, False)
        for _ in range(8):
            step, vague = self._improve(sizes, held)
            for i in range(3):
                sizes[i] = max(-0.5, min(0.5, sizes[i] + step[i]))
        names = (
            "the wheels' size: measure a point that is far from the beginning too, as the first"
            " corner is, or keep the radius",
            "the difference of the wheels: drive further",
            "the track: drive a path with turns, and measure the heading at its end",
        )
        for i in range(3):
            if not held[i] and vague[i] > _VAGUE:
                raise CalibrationError("the measured poses do not tell " + names[i])
        right = self.radius * (1 + sizes[0] + sizes[1])
        left = self.radius * (1 + sizes[0] - sizes[1])
        d = self._nominal_d * (1 + sizes[2])
        for value, nominal, most, subject in (
            (right, self.radius, _RADIUS_OFF, "the right wheel would have a radius"),
            (left, self.radius, _RADIUS_OFF, "the left wheel would have a radius"),
            (d, self._nominal_d, _TRACK_OFF, "half the track would be"),
        ):
            if abs(value - nominal) > most * nominal:
                raise CalibrationError(
                    "%s of %.4f m instead of %.4f m, which cannot be: check the measured poses"
                    " (metres; x ahead, y to the left) and that no wheel slipped"
                    % (subject, value, nominal)
                )
        rest = self._residuals(sizes)
        off = math.sqrt(sum(error * error for error in rest) / len(rest))
        if off > _MISFIT:
            raise CalibrationError(
                "no sizes fit the measured poses, they are off by %.3f m on average: measure again,"
                " and look whether a wheel slipped" % (off * _METRES)
            )
        self.right_radius = right
        self.left_radius = left
        self.d = d
        self.misfit = off * _METRES

    def _residuals(self, sizes: "list[float]") -> "list[float]":
        """Return measured minus computed poses, in standard deviations of a measurement."""
        right = 1 + sizes[0] + sizes[1]
        left = 1 + sizes[0] - sizes[1]
        track = 2 * self._nominal_d * (1 + sizes[2])
        out = []
        x = y = theta = 0.0
        at = 0
        for mark in self._marks:
            while at < mark[0]:
                right_way = self._rights[at] * right
                left_way = self._lefts[at] * left
                turn = (right_way - left_way) / track
                x += (right_way + left_way) / 2 * math.cos(theta + turn / 2)
                y += (right_way + left_way) / 2 * math.sin(theta + turn / 2)
                theta += turn
                at += 1
            if len(mark) == 4:
                out.append((mark[1] - x) / _METRES)
                out.append((mark[2] - y) / _METRES)
                if mark[3] is not None:
                    turn = (mark[3] - theta) % (2 * math.pi)
                    out.append((turn if turn <= math.pi else turn - 2 * math.pi) / _RADIANS)
            else:
                x = y = theta = 0.0
        return out

    def _improve(
        self, sizes: "list[float]", held: "tuple[bool, ...]"
    ) -> "tuple[list[float], list[float]]":
        """Return a Gauss-Newton step, and the standard deviation of each size."""
        rest = self._residuals(sizes)
        columns = []
        for i in range(3):
            moved = list(sizes)
            moved[i] += 1e-3
            slope = 0.0 if held[i] else 1e3
            columns.append([(a - b) * slope for a, b in zip(rest, self._residuals(moved))])
        # A weak prior for the nominal sizes keeps the matrix regular.
        matrix = [
            [sum(a * b for a, b in zip(columns[i], columns[j])) for j in range(3)] for i in range(3)
        ]
        right = [sum(a * b for a, b in zip(columns[i], rest)) for i in range(3)]
        for i in range(3):
            matrix[i][i] += 1.0
            right[i] -= sizes[i]
        inverse = _inverse(matrix)
        step = [sum(inverse[i][j] * right[j] for j in range(3)) for i in range(3)]
        return step, [math.sqrt(abs(inverse[i][i])) for i in range(3)]


def _inverse(m: "list[list[float]]") -> "list[list[float]]":
    """Return the inverse of a symmetric 3 by 3 matrix, by its cofactors."""
    a = m[1][1] * m[2][2] - m[1][2] * m[2][1]
    b = m[1][2] * m[2][0] - m[1][0] * m[2][2]
    c = m[1][0] * m[2][1] - m[1][1] * m[2][0]
    whole = m[0][0] * a + m[0][1] * b + m[0][2] * c
    return [
        [
            a / whole,
            (m[0][2] * m[2][1] - m[0][1] * m[2][2]) / whole,
            (m[0][1] * m[1][2] - m[0][2] * m[1][1]) / whole,
        ],
        [
            b / whole,
            (m[0][0] * m[2][2] - m[0][2] * m[2][0]) / whole,
            (m[0][2] * m[1][0] - m[0][0] * m[1][2]) / whole,
        ],
        [
            c / whole,
            (m[0][1] * m[2][0] - m[0][0] * m[2][1]) / whole,
            (m[0][0] * m[1][1] - m[0][1] * m[1][0]) / whole,
        ],
    ]
