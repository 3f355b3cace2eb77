"""Where two wheels have brought a body."""

import math

try:
    from typing import Final
except ImportError:
    pass

# The variance of a wheel's way grows by so many m² a metre: 3° of heading after a square of 1 m.
_DOUBT: Final = 2e-5
# The doubt grows after both wheels have come so far together, in metres: on boards each operation
# with floats takes memory, and these are many.
_LONG: Final = 0.04
# Of the speeds: an encoder's edge is 5 mm, and they are measured over two.
_SPEED: Final = 0.0004
# What two wheels say nothing of.
_UNKNOWN: Final = 1e6


class Odometry:
    """``x``, ``y``, ``theta`` (within ±π) since the start; ``v`` and ``w`` are rates.

    ``d`` is half the track. ``qz`` and ``qw`` are the orientation's quaternion; ``distance`` is
    the length of the path.
    """

    def __init__(self, d: float = 0.134) -> None:
        self.d = d
        self.reset()

    def reset(self, x: float = 0.0, y: float = 0.0, theta: float = 0.0) -> None:
        """Be there, with no doubt about it."""
        self.x = x
        self.y = y
        self.theta = _wrapped(theta)
        self.v = 0.0
        self.w = 0.0
        self.distance = 0.0
        # What the wheels did since the doubt has grown.
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
        return math.sin(self.theta / 2)

    @property
    def qw(self) -> float:
        return math.cos(self.theta / 2)

    def update(
        self, right: float, left: float, right_speed: float = 0.0, left_speed: float = 0.0
    ) -> None:
        """The wheels came so far since the last update, in metres, and turn so fast, in m/s."""
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
        """P = F P Fᵀ + G Q Gᵀ, with F the motion's derivative by the pose, G that by the wheels'
        ways, and Q their variances.
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
        # As if all that is new came in the middle of the way.
        self._move(-way / 2 * sin, way / 2 * cos)
        # Of the way and of the turn.
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
        """What the doubt of the heading makes of a way of (b, -a)."""
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
