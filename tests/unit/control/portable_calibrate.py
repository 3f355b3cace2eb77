"""Calibration of wheels and track by simulated drives of bodies with known sizes."""

import math

from uros.control.calibrate import Calibration, CalibrationError

RADIUS = 0.0325
TRACK = 0.134


def body(calibration, right, left, d, clockwise=False, corner=True, off=(0.0, 0.0, 0.0)):
    """Drive a square with these sizes; ``off`` is the error of the measured poses."""
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


def test_one_square_with_its_first_corner_determines_all_sizes():
    for right, left, d in ((0.0328, 0.0322, 0.136), (0.0321, 0.0323, 0.131), (0.034, 0.034, 0.14)):
        calibration = Calibration()
        body(calibration, right, left, d)
        calibration.solve()
        near(calibration.right_radius, right, 0.0002)
        near(calibration.left_radius, left, 0.0002)
        near(calibration.d, d, 0.0005)
        assert calibration.misfit < 0.001


def test_squares_in_both_directions_tolerate_errors_of_measurement():
    calibration = Calibration()
    body(calibration, 0.0327, 0.0323, 0.1345, off=(0.004, -0.003, 0.008))
    calibration.restart()
    body(calibration, 0.0327, 0.0323, 0.1345, clockwise=True, off=(-0.003, 0.004, -0.006))
    calibration.solve()
    near(calibration.right_radius, 0.0327, 0.004)
    near(calibration.left_radius, 0.0323, 0.004)
    near(calibration.right_radius / calibration.left_radius, 0.0327 / 0.0323, 0.001)
    near(calibration.d, 0.1345, 0.006)


def test_a_nominal_body_keeps_its_sizes():
    calibration = Calibration()
    body(calibration, RADIUS, RADIUS, TRACK)
    calibration.solve()
    near(calibration.right_radius, RADIUS, 1e-4)
    near(calibration.left_radius, RADIUS, 1e-4)
    near(calibration.d, TRACK, 3e-4)


def test_the_end_of_a_square_alone_does_not_determine_the_radius():
    calibration = Calibration()
    body(calibration, 0.0328, 0.0322, 0.134, corner=False)
    refused(calibration.solve, "size", "first corner")
    assert calibration.right_radius == RADIUS and calibration.d == TRACK
    # One direction cannot distinguish a difference of the wheels from an error of the track.
    refused(lambda: calibration.solve(keep_radius=True), "track")
    calibration.restart()
    body(calibration, 0.0328, 0.0322, 0.134, clockwise=True, corner=False)
    calibration.solve(keep_radius=True)
    near(calibration.right_radius / calibration.left_radius, 0.0328 / 0.0322, 0.0005)
    near((calibration.right_radius + calibration.left_radius) / 2, RADIUS, 1e-5)


def test_a_straight_drive_does_not_determine_the_track():
    calibration = Calibration()
    for _ in range(100):
        calibration.add(0.01, 0.01)
    calibration.measured(1.003, 0.002)
    refused(calibration.solve, "track", "turns")


def test_invalid_data_are_refused():
    calibration = Calibration()
    refused(calibration.solve, "too short")
    body(calibration, RADIUS, RADIUS, TRACK)
    for bad in (float("nan"), float("inf")):
        refused(lambda bad=bad: calibration.measured(bad, 0.0), "numbers")
        refused(lambda bad=bad: calibration.measured(0.0, bad), "numbers")
        refused(lambda bad=bad: calibration.measured(0.0, 0.0, bad), "numbers")
    # Millimetres instead of metres.
    calibration = Calibration()
    for _ in range(100):
        calibration.add(0.01, 0.01)
    calibration.measured(1000.0, 0.0)
    refused(lambda: calibration.solve())
    # No pose was measured.
    calibration = Calibration()
    for _ in range(300):
        calibration.add(0.01, 0.008)
    refused(calibration.solve, "no pose")
    # Two measurements that contradict each other.
    calibration = Calibration()
    body(calibration, RADIUS, RADIUS, TRACK)
    calibration.measured(0.4, -0.3, 1.0)
    refused(calibration.solve, "measure again")


def test_sizes_out_of_tolerance_are_refused():
    calibration = Calibration()
    body(calibration, RADIUS * 1.2, RADIUS * 1.2, TRACK)
    refused(calibration.solve, "radius", "cannot be")
    calibration = Calibration()
    body(calibration, RADIUS, RADIUS, TRACK * 1.3)
    refused(calibration.solve, "cannot be")
