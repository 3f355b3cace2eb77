"""Odometry of two wheels: pose, rates and covariance."""

import math

try:
    from typing import Final
except ImportError:
    pass

# Growth of the variance of a wheel's distance, in m² per metre: 3° of heading after a square of
# 1 m.
_DOUBT: Final = 2e-5
# The covariance is updated when both wheels together have moved so far, in metres: on boards each
# operation with floats allocates memory, and these are many.
_LONG: Final = 0.04
# Variance of the speeds: edges are 5 mm apart, and a speed is measured over two of them.
_SPEED: Final = 0.0004
# Variance of axes that two wheels do not measure.
_UNKNOWN: Final = 1e6


class Odometry:
    """Pose and rates of a rover with two wheels.

    ``x``, ``y`` (metres) and ``theta`` (radians, within ±π) are the pose relative to the start,
    ``v`` (m/s) and ``w`` (rad/s) the rates, ``distance`` the length of the path in metres.

    Args:
        d: Half the track, in metres.
    """

    def __init__(self, d: float = 0.134) -> None:
        self.d = d
        self.reset()

    def reset(self, x: float = 0.0, y: float = 0.0, theta: float = 0.0) -> None:
        """Set the pose, with zero covariance."""
        self.x = x
        self.y = y
        self.theta = _wrapped(theta)
        self.v = 0.0
        self.w = 0.0
        self.distance = 0.0
        # Motion of the wheels since the last update of the covariance.
        self._way = 0.0
        self._turn = 0.0
        self._right = 0.0
        self._left = 0.0
        # Variances and covariances.
        self._xx = 0.0
        self._xy = 0.0
        self._yy = 0.0
        self._xt = 0.0
        self._yt = 0.0
        self._tt = 0.0

    @property
    def qz(self) -> float:
        """The z component of the orientation's quaternion."""
        return math.sin(self.theta / 2)

    @property
    def qw(self) -> float:
        """The w component of the orientation's quaternion."""
        return math.cos(self.theta / 2)

    def update(
        self, right: float, left: float, right_speed: float = 0.0, left_speed: float = 0.0
    ) -> None:
        """Add the wheels' distances since the last update (metres), and set their speeds (m/s)."""
        self.v = (right_speed + left_speed) / 2
        self.w = (right_speed - left_speed) / (2 * self.d)
        if right == 0 and left == 0:
            return
        way = (right + left) / 2
        turn = (right - left) / (2 * self.d)
        middle = self.theta + turn / 2
        self.x += way * math.cos(middle)
        self.y += way * math.sin(middle)
        self.theta = _wrapped(self.theta + turn)
        self.distance += abs(way)
        self._way += way
        self._turn += turn
        self._right += abs(right)
        self._left += abs(left)
        if self._right + self._left > _LONG:
            self._grow()

    def _grow(self) -> None:
        """Update the covariance: P = F P Fᵀ + G Q Gᵀ.

        F is the derivative of the motion by the pose, G that by the wheels' distances, and Q holds
        the variances of these distances.
        """
        way = self._way
        right = _DOUBT * self._right
        left = _DOUBT * self._left
        middle = self.theta - self._turn / 2
        cos = math.cos(middle)
        sin = math.sin(middle)
        self._way = 0.0
        self._turn = 0.0
        self._right = 0.0
        self._left = 0.0
        # The new variance is added in the middle of the motion.
        self._move(-way / 2 * sin, way / 2 * cos)
        # Variances of the distance and of the turn.
        ahead = (right + left) / 4
        turn = ahead / (self.d * self.d)
        both = (right - left) / (4 * self.d)
        self._xx += cos * cos * ahead
        self._yy += sin * sin * ahead
        self._xy += sin * cos * ahead
        self._xt += cos * both
        self._yt += sin * both
        self._tt += turn
        self._move(-way / 2 * sin, way / 2 * cos)

    def _move(self, a: float, b: float) -> None:
        """Propagate the variance of the heading over a displacement of (b, -a)."""
        tt = self._tt
        self._xx += a * (2 * self._xt + a * tt)
        self._xy += a * self._yt + b * self._xt + a * b * tt
        self._yy += b * (2 * self._yt + b * tt)
        self._xt += a * tt
        self._yt += b * tt

    def pose_covariance(self, into: "list[float]") -> None:
        """Fill the 36 numbers of a PoseWithCovariance. Height, roll and pitch are unknown."""
        self._grow()
        for i in range(36):
            into[i] = 0.0
        into[0] = self._xx
        into[1] = into[6] = self._xy
        into[7] = self._yy
        into[5] = into[30] = self._xt
        into[11] = into[31] = self._yt
        into[35] = self._tt
        into[14] = into[21] = into[28] = _UNKNOWN

    def twist_covariance(self, into: "list[float]") -> None:
        """Fill the 36 numbers of a TwistWithCovariance. Wheels do not slide to a side."""
        for i in range(36):
            into[i] = 0.0
        into[0] = into[7] = _SPEED
        into[35] = _SPEED / (self.d * self.d)
        into[14] = into[21] = into[28] = _UNKNOWN


def _wrapped(theta: float) -> float:
    while theta > math.pi:
        theta -= 2 * math.pi
    while theta < -math.pi:
        theta += 2 * math.pi
    return theta
