"""Transforms between coordinate frames: pure mathematics of rotations and translations.

A rotation is a unit quaternion (x, y, z, w), as in geometry_msgs. A :class:`Transform` maps points
of a child frame to its parent frame: ``p_parent = rotation * p_child + translation``.
"""

from __future__ import annotations

import math
from typing import Final, NamedTuple

Vector = tuple[float, float, float]
Quaternion = tuple[float, float, float, float]
Matrix = tuple[Vector, Vector, Vector]

# How far the length of a quaternion of the network may be from 1, as in tf2.
_TOLERANCE: Final = 1e-3
# Closeness of a pitch to a right angle, where roll and yaw turn about the same axis.
_STEEP: Final = 1.0 - 1e-12


class Transform(NamedTuple):
    """The pose of a child frame in its parent frame, in meters and as a unit quaternion."""

    translation: Vector
    rotation: Quaternion


_AXES: Final = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
IDENTITY: Final = Transform((0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0))


def fault(transform: Transform) -> str:
    """Return why the numbers are no transform, or "" if they are one."""
    if not all(map(math.isfinite, (*transform.translation, *transform.rotation))):
        return "it has a number that is not finite"
    length = math.sqrt(sum(part * part for part in transform.rotation))
    if abs(length - 1.0) > _TOLERANCE:
        return f"its quaternion has the length {length:.3g} in place of 1"
    return ""


def normalized(rotation: Quaternion) -> Quaternion:
    """Return a quaternion of length 1 with the direction of one that is not zero."""
    x, y, z, w = rotation
    length = math.sqrt(x * x + y * y + z * z + w * w)
    return x / length, y / length, z / length, w / length


def multiply(a: Quaternion, b: Quaternion) -> Quaternion:
    """Return the rotation by ``b`` and then by ``a`` (Hamilton product)."""
    ax, ay, az, aw = a
    bx, by, bz, bw = b
    return (
        aw * bx + ax * bw + ay * bz - az * by,
        aw * by - ax * bz + ay * bw + az * bx,
        aw * bz + ax * by - ay * bx + az * bw,
        aw * bw - ax * bx - ay * by - az * bz,
    )


def conjugate(rotation: Quaternion) -> Quaternion:
    """Return the opposite of a rotation."""
    x, y, z, w = rotation
    return -x, -y, -z, w


def rotate(rotation: Quaternion, vector: Vector) -> Vector:
    """Return a vector turned by a rotation."""
    x, y, z, _ = multiply(multiply(rotation, (*vector, 0.0)), conjugate(rotation))
    return x, y, z


def compose(outer: Transform, inner: Transform) -> Transform:
    """Return the pose in the frame of ``outer`` of what has the pose ``inner`` in its child."""
    x, y, z = rotate(outer.rotation, inner.translation)
    dx, dy, dz = outer.translation
    return Transform((x + dx, y + dy, z + dz), normalized(multiply(outer.rotation, inner.rotation)))


def inverse(transform: Transform) -> Transform:
    """Return the pose of the parent in the child."""
    back = conjugate(transform.rotation)
    x, y, z = rotate(back, transform.translation)
    return Transform((-x, -y, -z), back)


def matrix(rotation: Quaternion) -> Matrix:
    """Return the rotation matrix, row by row."""
    a, b, c = (rotate(rotation, axis) for axis in _AXES)
    return (a[0], b[0], c[0]), (a[1], b[1], c[1]), (a[2], b[2], c[2])


def roll_pitch_yaw(rotation: Quaternion) -> Vector:
    """Return the angles about the fixed axes x, y, z, in radians.

    Where the pitch is a right angle, roll and yaw are not unique; yaw is then 0.
    """
    (xx, _, _), (yx, yy, yz), (zx, zy, zz) = matrix(rotation)
    if abs(zx) >= _STEEP:
        return math.atan2(-yz, yy), math.copysign(math.pi / 2, -zx), 0.0
    return math.atan2(zy, zz), math.asin(-zx), math.atan2(yx, xx)
