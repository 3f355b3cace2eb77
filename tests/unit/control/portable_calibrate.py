"""Sizes of wheels and track, found from drives of bodies whose sizes are known."""

import math

from uros.control.calibrate import Calibration, CalibrationError

RADIUS = 0.0325
TRACK = 0.134


def body(calibration, right, left, d, clockwise=False, corner=True, off=(0.0, 0.0, 0.0)):
    """A square as a body drives it that believes in the nominal sizes and has others. ``off`` is
    by how much its poses are measured wrongly."""
    x = y = theta = 0.0
    sign = -1 if clockwise else 1
    quarter = math.pi / 2 * TRACK
    for side in range(4):
        for way_right, way_left in ((1.0, 1.0), (sign * quarter, -sign * quarter)):
            for _ in range(50):
                calibration.add(way_right / 50, way_left / 50)
                true_right = way_right / 50 * right / RADIUS
                true_left = way_left / 50 * left / RADIUS
                turn = (true_right - true_left) / (2 * d)
                x += (true_right + true_left) / 2 * math.cos(theta + turn / 2)
                y += (true_right + true_left) / 2 * math.sin(theta + turn / 2)
                theta += turn
            if side == 0 and way_right == way_left and corner:
                calibration.measured(x + off[0], y + off[1])
    calibration.measured(x + off[0], y + off[1], theta + off[2])


def near(value, wanted, within):
    assert abs(value / wanted - 1) <= within, (value, wanted)


def refused(call, *words):
    try:
        call()
    except CalibrationError as error:
        for word in words:
            assert word in str(error), error
        return
    raise AssertionError("nothing was refused")


def test_one_square_with_its_first_corner_tells_all_three():
    for right, left, d in ((0.0328, 0.0322, 0.136), (0.0321, 0.0323, 0.131), (0.034, 0.034, 0.14)):
        it = Calibration()
        body(it, right, left, d)
        it.solve()
        near(it.right_radius, right, 0.0002)
        near(it.left_radius, left, 0.0002)
        near(it.d, d, 0.0005)
        assert it.misfit < 0.001


def test_squares_in_both_directions_bear_that_a_person_measures_badly():
    it = Calibration()
    body(it, 0.0327, 0.0323, 0.1345, off=(0.004, -0.003, 0.008))
    it.restart()
    body(it, 0.0327, 0.0323, 0.1345, clockwise=True, off=(-0.003, 0.004, -0.006))
    it.solve()
    near(it.right_radius, 0.0327, 0.004)
    near(it.left_radius, 0.0323, 0.004)
    near(it.right_radius / it.left_radius, 0.0327 / 0.0323, 0.001)
    near(it.d, 0.1345, 0.006)


def test_nominal_sizes_stay_what_they_are():
    it = Calibration()
    body(it, RADIUS, RADIUS, TRACK)
    it.solve()
    near(it.right_radius, RADIUS, 1e-4)
    near(it.left_radius, RADIUS, 1e-4)
    near(it.d, TRACK, 3e-4)


def test_the_end_of_a_square_alone_does_not_tell_how_large_the_wheels_are():
    it = Calibration()
    body(it, 0.0328, 0.0322, 0.134, corner=False)
    refused(it.solve, "size", "first corner")
    assert it.right_radius == RADIUS and it.d == TRACK
    # One direction leaves open whether the wheels differ or the track does.
    refused(lambda: it.solve(keep_radius=True), "track")
    it.restart()
    body(it, 0.0328, 0.0322, 0.134, clockwise=True, corner=False)
    it.solve(keep_radius=True)
    near(it.right_radius / it.left_radius, 0.0328 / 0.0322, 0.0005)
    near((it.right_radius + it.left_radius) / 2, RADIUS, 1e-5)


def test_a_straight_way_does_not_tell_the_track():
    it = Calibration()
    for _ in range(100):
        it.add(0.01, 0.01)
    it.measured(1.003, 0.002)
    refused(it.solve, "track", "turns")


def test_data_that_cannot_be_are_refused():
    it = Calibration()
    refused(it.solve, "too short")
    body(it, RADIUS, RADIUS, TRACK)
    for bad in (float("nan"), float("inf")):
        refused(lambda bad=bad: it.measured(bad, 0.0), "numbers")
        refused(lambda bad=bad: it.measured(0.0, bad), "numbers")
        refused(lambda bad=bad: it.measured(0.0, 0.0, bad), "numbers")
    # Millimetres for metres.
    it = Calibration()
    for _ in range(100):
        it.add(0.01, 0.01)
    it.measured(1000.0, 0.0)
    refused(lambda: it.solve())
    # Nobody measured.
    it = Calibration()
    for _ in range(300):
        it.add(0.01, 0.008)
    refused(it.solve, "no pose")
    # Two measurements that contradict each other.
    it = Calibration()
    body(it, RADIUS, RADIUS, TRACK)
    it.measured(0.4, -0.3, 1.0)
    refused(it.solve, "measure again")


def test_wheels_that_are_far_too_large_are_none():
    it = Calibration()
    body(it, RADIUS * 1.2, RADIUS * 1.2, TRACK)
    refused(it.solve, "radius", "cannot be")
    it = Calibration()
    body(it, RADIUS, RADIUS, TRACK * 1.3)
    refused(it.solve, "cannot be")
