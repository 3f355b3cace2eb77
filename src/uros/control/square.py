"""Driving a square by odometry, for calibration and as a check of the whole drive."""

import math


def _difference(a: float, b: float) -> float:
    """Return the angle from b to a, within ±π."""
    turn = a - b
    while turn > math.pi:
        turn -= 2 * math.pi
    while turn < -math.pi:
        turn += 2 * math.pi
    return turn


class Square:
    """A square that begins and ends at the odometry's pose of the first `step`.

    `step` sets ``v`` (m/s) and ``w`` (rad/s), to be driven until the next one, some 20 to 100 ms
    later. ``corner`` counts the finished sides, turns included.

    Args:
        side: Length of a side in metres.
        speed: Largest speed in m/s.
        turning: Largest rate of turn in rad/s.
        clockwise: Turn right at the corners, not left.
    """

    def __init__(
        self, side: float = 1.0, speed: float = 0.25, turning: float = 1.0, clockwise: bool = False
    ) -> None:
        self.side = side
        self.v = 0.0
        self.w = 0.0
        self.corner = 0
        self.turning = False
        self._speed = speed
        self._turning = turning
        self._left = -1.0 if clockwise else 1.0
        self._begun = False
        # Start and heading of this side.
        self._x = 0.0
        self._y = 0.0
        self._theta = 0.0

    def step(self, x: float, y: float, theta: float) -> bool:
        """Set the rates for this pose; return whether the square is not finished yet."""
        if not self._begun:
            self._begun = True
            self._x = x
            self._y = y
            self._theta = theta
        if self.corner < 4:
            if self.turning:
                self._turn(theta)
            else:
                self._straight(x, y, theta)
        if self.corner == 4:
            self.v = 0.0
            self.w = 0.0
            return False
        return True

    def _straight(self, x: float, y: float, theta: float) -> None:
        cos = math.cos(self._theta)
        sin = math.sin(self._theta)
        along = (x - self._x) * cos + (y - self._y) * sin
        aside = (y - self._y) * cos - (x - self._x) * sin
        left = self.side - along
        # It rolls on by about 1 cm while it brakes.
        if left < 0.01:
            self.turning = True
            self.v = 0.0
            self.w = 0.0
            self._x += self.side * cos
            self._y += self.side * sin
            self._theta += self._left * math.pi / 2
            return
        self.v = min(self._speed, 0.06 + left)
        self.w = 2.0 * _difference(self._theta, theta) - 4.0 * aside * self.v
        self.w = max(-1.0, min(1.0, self.w))

    def _turn(self, theta: float) -> None:
        left = _difference(self._theta, theta)
        self.v = 0.0
        if abs(left) < 0.02 or left * self._left < 0:
            self.turning = False
            self.corner += 1
            self.w = 0.0
            return
        self.w = max(0.5, min(self._turning, 2.0 * abs(left))) * self._left
