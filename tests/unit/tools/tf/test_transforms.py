import math

import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from uros.tools.tf.transforms import (
    IDENTITY,
    Transform,
    compose,
    fault,
    inverse,
    matrix,
    normalized,
    roll_pitch_yaw,
    rotate,
)

HALF = math.sqrt(0.5)
PARTS = st.floats(-1.0, 1.0)
ANGLES = st.floats(-math.pi, math.pi)
VECTORS = st.tuples(*[st.floats(-1e3, 1e3)] * 3)
QUATERNIONS = (
    st.tuples(PARTS, PARTS, PARTS, PARTS)
    .filter(lambda parts: sum(part * part for part in parts) > 1e-3)
    .map(normalized)
)
TRANSFORMS = st.builds(Transform, VECTORS, QUATERNIONS)


def close(a, b):
    return a == pytest.approx(b, abs=1e-6)


def times(a, b):
    """The product of two matrices, written out: an independent way to compose rotations."""
    return tuple(
        tuple(sum(a[i][k] * b[k][j] for k in range(3)) for j in range(3)) for i in range(3)
    )


def about(axis, angle):
    """The matrix of a turn about an axis, from the textbook."""
    c, s = math.cos(angle), math.sin(angle)
    return {
        "x": ((1, 0, 0), (0, c, -s), (0, s, c)),
        "y": ((c, 0, s), (0, 1, 0), (-s, 0, c)),
        "z": ((c, -s, 0), (s, c, 0), (0, 0, 1)),
    }[axis]


def quaternion(axis, angle):
    x, y, z = (math.sin(angle / 2) * (axis == name) for name in "xyz")
    return x, y, z, math.cos(angle / 2)


# Made independently of this code: quarter turns by the right-hand rule, worked out by hand.
@pytest.mark.parametrize(
    "rotation, vector, turned",
    [
        ((0, 0, HALF, HALF), (1, 0, 0), (0, 1, 0)),
        ((0, 0, HALF, HALF), (0, 1, 0), (-1, 0, 0)),
        ((HALF, 0, 0, HALF), (0, 1, 0), (0, 0, 1)),
        ((0, HALF, 0, HALF), (0, 0, 1), (1, 0, 0)),
        ((0, 0, 1, 0), (2, 3, 4), (-2, -3, 4)),
        ((0.5, 0.5, 0.5, 0.5), (1, 2, 3), (3, 1, 2)),  # x to y to z to x
    ],
)
def test_quarter_turns(rotation, vector, turned):
    assert close(rotate(rotation, vector), turned)


# Made independently: an arm that is turned by a quarter, with a hand that is turned back.
def test_a_chain_worked_out_by_hand():
    base_arm = Transform((1.0, 2.0, 0.0), (0.0, 0.0, HALF, HALF))
    arm_hand = Transform((3.0, 0.0, 1.0), (0.0, 0.0, -HALF, HALF))
    moved, turned = compose(base_arm, arm_hand)
    assert close(moved, (1.0, 5.0, 1.0)) and close(turned, (0.0, 0.0, 0.0, 1.0))
    moved, turned = inverse(base_arm)
    assert close(moved, (-2.0, 1.0, 0.0)) and close(turned, (0.0, 0.0, -HALF, HALF))


@given(ANGLES, st.floats(-1.5, 1.5), ANGLES)
def test_roll_pitch_and_yaw_are_turns_about_fixed_axes(roll, pitch, yaw):
    wanted = times(times(about("z", yaw), about("y", pitch)), about("x", roll))
    turn = IDENTITY
    for axis, angle in (("x", roll), ("y", pitch), ("z", yaw)):
        turn = compose(Transform((0.0, 0.0, 0.0), quaternion(axis, angle)), turn)
    for ours, theirs in zip(matrix(turn.rotation), wanted, strict=True):
        assert close(ours, theirs)
    r, p, y = roll_pitch_yaw(turn.rotation)
    again = times(times(about("z", y), about("y", p)), about("x", r))
    for ours, theirs in zip(again, wanted, strict=True):
        assert close(ours, theirs)


@pytest.mark.parametrize("sign", [1, -1])
@pytest.mark.parametrize("roll", [0.0, 0.7, -2.0])
def test_a_right_angle_of_pitch_has_no_yaw(sign, roll):
    turn = compose(
        Transform((0.0, 0.0, 0.0), quaternion("y", sign * math.pi / 2)),
        Transform((0.0, 0.0, 0.0), quaternion("x", roll)),
    )
    assert close(roll_pitch_yaw(turn.rotation), (roll, sign * math.pi / 2, 0.0))


@given(TRANSFORMS, TRANSFORMS, TRANSFORMS, VECTORS)
def test_laws_of_transforms(a, b, c, point):
    def placed(transform, vector):
        turned = rotate(transform.rotation, vector)
        return tuple(map(sum, zip(turned, transform.translation, strict=True)))

    assert close(placed(compose(a, b), point), placed(a, placed(b, point)))
    left, right = compose(compose(a, b), c), compose(a, compose(b, c))
    assert close(placed(left, point), placed(right, point))
    assert close(placed(inverse(a), placed(a, point)), point)
    assert close(placed(compose(a, IDENTITY), point), placed(a, point))
    assert close(sum(part * part for part in compose(a, b).rotation), 1.0)


@given(QUATERNIONS, VECTORS)
def test_a_rotation_keeps_lengths(rotation, vector):
    assume(any(vector))
    assert close(math.hypot(*rotate(rotation, vector)), math.hypot(*vector))


def test_numbers_that_are_no_transform():
    assert fault(IDENTITY) == ""
    assert fault(Transform((0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0005))) == ""
    assert fault(Transform((0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 0.0))) == (
        "its quaternion has the length 0 in place of 1"
    )
    assert "not finite" in fault(Transform((math.nan, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0)))
    assert "not finite" in fault(Transform((0.0, 0.0, 0.0), (0.0, math.inf, 0.0, 1.0)))
