"""Commands of the drive, their limits and timeout; odometry and the square."""

import math

from uros.control.diff_drive import DiffDrive
from uros.control.odometry import Odometry
from uros.control.pid import Pid
from uros.control.square import Square
from uros.control.wheel import Wheel

STEP = 20000


def near(value, wanted, within=1e-6):
    assert abs(value - wanted) <= within, (value, wanted)


def drive(**options):
    pids = [Pid(150, 1000, dead_zone=21, kf=214, lag=0.13) for _ in range(2)]
    started = DiffDrive(Wheel(), Wheel(), pids[0], pids[1], **options)
    started.power(True)
    started.now = 0
    return started


def steps(diff_drive, seconds, right=0, left=0):
    """Run control cycles for ``seconds``, with an edge every ``right`` and ``left`` µs."""
    for _ in range(round(seconds * 50)):
        for t in range(diff_drive.now, diff_drive.now + STEP, 1000):
            if right and t % right < 1000:
                diff_drive.right.edge(t)
            if left and t % left < 1000:
                diff_drive.left.edge(t)
        diff_drive.now += STEP
        diff_drive.step(diff_drive.now)


def test_a_twist_becomes_two_speeds():
    # The document's example, 1.0 m/s and 1.57 rad/s, is 1.21 and 0.79 m/s.
    diff_drive = drive(fastest=2.0)
    assert diff_drive.command(1.0, 1.57)
    near(diff_drive._right_target, 1.2104, 1e-3)
    near(diff_drive._left_target, 0.7896, 1e-3)
    diff_drive.command(-0.2, 0.0)
    near(diff_drive._right_target, -0.2)
    near(diff_drive._left_target, -0.2)
    # Counter-clockwise is positive: the right wheel goes forward.
    diff_drive.command(0.0, 1.0)
    near(diff_drive._right_target, 0.134)
    near(diff_drive._left_target, -0.134)


def test_too_fast_commands_are_scaled_on_the_same_curve():
    for v, w in ((5.0, 3.0), (-2.0, 9.0), (0.0, 100.0), (3e38, 3e38), (1.0, -3e38)):
        diff_drive = drive(fastest=0.9)
        assert diff_drive.command(v, w)
        fastest = max(abs(diff_drive._right_target), abs(diff_drive._left_target))
        near(fastest, 0.9, 1e-5)
        if v:
            # The quotient is the curvature.
            near(diff_drive.w / diff_drive.v / (w / v), 1.0, 1e-5)
    diff_drive = drive(fastest=0.9)
    diff_drive.command(0.3, 0.5)
    near(diff_drive.v, 0.3)
    near(diff_drive.w, 0.5)


def test_commands_that_are_no_numbers_are_refused():
    diff_drive = drive()
    assert diff_drive.command(0.3, 0.0)
    nan = float("nan")
    inf = float("inf")
    for v, w in ((nan, 0.0), (0.0, nan), (inf, 0.0), (0.0, -inf), (nan, nan)):
        assert not diff_drive.command(v, w)
    near(diff_drive.v, 0.3)
    steps(diff_drive, 0.2)
    assert diff_drive.right_duty > 0 and diff_drive.right_duty == diff_drive.right_duty


def test_commands_are_ignored_while_the_motors_are_off():
    diff_drive = drive()
    diff_drive.power(False)
    assert not diff_drive.command(0.3, 0.0)
    steps(diff_drive, 0.1)
    assert diff_drive.right_duty == 0 and diff_drive.left_duty == 0
    diff_drive.power(True)
    steps(diff_drive, 0.1)
    assert diff_drive.right_duty == 0, "a command from before"


def test_the_drive_stops_within_a_second_after_the_last_command():
    diff_drive = drive()
    steps(diff_drive, 0.1)
    diff_drive.command(0.3, 0.5)
    steps(diff_drive, 0.9, right=14000, left=22000)
    assert diff_drive.right_duty > 0 and diff_drive.left_duty > 0
    assert diff_drive.right_pid.integral != 0
    steps(diff_drive, 0.1, right=14000, left=22000)
    assert diff_drive.right_duty == diff_drive.left_duty == 0
    for pid in (diff_drive.right_pid, diff_drive.left_pid):
        assert pid.integral == pid.error == pid.output == 0
    assert diff_drive.v == diff_drive.w == 0


def test_each_command_restarts_the_timeout():
    diff_drive = drive()
    for _ in range(30):
        diff_drive.command(0.3, 0.0)
        steps(diff_drive, 0.1, right=17000, left=17000)
        assert diff_drive.right_duty > 0 and diff_drive.left_duty > 0


def test_a_command_of_zero_stops_at_once():
    diff_drive = drive()
    diff_drive.command(0.3, 0.0)
    steps(diff_drive, 0.3, right=17000, left=17000)
    assert diff_drive.command(0.0, 0.0)
    assert diff_drive.right_duty == diff_drive.left_duty == 0


def test_a_change_of_power_resets_the_integrals():
    diff_drive = drive()
    diff_drive.command(0.5, 0.0)
    steps(diff_drive, 0.5, right=17000, left=17000)
    assert diff_drive.right_pid.integral > 0
    diff_drive.power(False)
    assert diff_drive.right_pid.integral == 0 and diff_drive.right_duty == 0
    diff_drive.power(True)
    diff_drive.command(0.5, 0.0)
    steps(diff_drive, 0.5, right=17000, left=17000)
    diff_drive.power(True)
    assert diff_drive.right_pid.integral == 0 and diff_drive.right_duty == 0


def test_a_stuck_wheel_stops_both_and_is_named():
    diff_drive = drive()
    for _ in range(9):
        diff_drive.command(0.3, 0.0)
        steps(diff_drive, 0.1, right=17000)
        if diff_drive.fault:
            break
    assert "left wheel" in diff_drive.fault, diff_drive.fault
    assert diff_drive.right_duty == diff_drive.left_duty == 0
    assert diff_drive.left_pid.integral == 0
    # Commands are refused for a second; the fault ends when both wheels turn.
    assert not diff_drive.command(0.3, 0.0)
    steps(diff_drive, 1.02)
    assert diff_drive.fault
    for _ in range(10):
        assert diff_drive.command(0.3, 0.0)
        steps(diff_drive, 0.1, right=17000, left=17000)
    assert diff_drive.fault == ""


def test_a_wheel_that_reverses_is_braked_until_it_stands():
    diff_drive = drive()
    diff_drive.command(0.3, 0.0)
    steps(diff_drive, 0.5, right=17000, left=17000)
    diff_drive.command(-0.3, 0.0)
    steps(diff_drive, 0.04, right=17000, left=17000)
    assert diff_drive.right_duty == 0 and diff_drive.left_duty == 0
    steps(diff_drive, 0.2)
    assert diff_drive.right_duty < 0 and diff_drive.left_duty < 0


def test_odometry_of_a_straight_way_a_circle_and_a_turn_on_the_spot():
    odometry = Odometry()
    for _ in range(100):
        odometry.update(0.01, 0.01)
    near(odometry.x, 1.0)
    near(odometry.y, 0.0)
    near(odometry.distance, 1.0)
    odometry.reset()
    # A quarter of a circle to the left, of radius 0.5.
    turn = math.pi / 2
    for _ in range(100):
        odometry.update((0.5 + 0.134) * turn / 100, (0.5 - 0.134) * turn / 100)
    near(odometry.theta, turn)
    near(odometry.x, 0.5, 1e-4)
    near(odometry.y, 0.5, 1e-4)
    odometry.reset()
    for _ in range(100):
        odometry.update(0.134 * math.pi / 100, -0.134 * math.pi / 100)
    near(odometry.x, 0.0)
    near(odometry.y, 0.0)
    near(abs(odometry.theta), math.pi)


def test_the_heading_wraps_and_the_quaternion_is_a_unit():
    odometry = Odometry()
    for n in range(1, 1000):
        odometry.update(0.001, -0.001)
        assert -math.pi - 1e-6 <= odometry.theta <= math.pi + 1e-6
        near(odometry.qz * odometry.qz + odometry.qw * odometry.qw, 1.0)
        turned = 0.002 * n / 0.268
        near(math.cos(odometry.theta), math.cos(turned), 1e-4)
        near(math.sin(odometry.theta), math.sin(turned), 1e-4)
    odometry.reset(1.0, 2.0, 0.5)
    near(odometry.qz, math.sin(0.25))
    near(odometry.qw, math.cos(0.25))


def test_the_twist_is_a_rate():
    odometry = Odometry()
    odometry.update(0.006, 0.004, 0.3, 0.2)
    near(odometry.v, 0.25)
    near(odometry.w, 0.1 / 0.268)
    odometry.update(0.0, 0.0, 0.0, 0.0)
    assert odometry.v == 0 and odometry.w == 0


def test_the_covariance_grows_with_the_distance():
    odometry = Odometry()
    pose = [9.0] * 36
    odometry.pose_covariance(pose)
    assert pose[0] == pose[7] == pose[35] == pose[5] == 0
    assert pose[14] == pose[21] == pose[28] == 1e6
    last = 0.0
    for _ in range(5):
        for _ in range(20):
            odometry.update(0.01, 0.01)
        odometry.pose_covariance(pose)
        assert pose[0] > 0 and pose[7] >= 0 and pose[35] > last
        last = pose[35]
        for row in range(6):
            for column in range(6):
                assert pose[6 * row + column] == pose[6 * column + row]
    # On a straight drive the variance of the heading becomes one of the lateral position.
    assert pose[7] > pose[0] and pose[11] > 0
    for _ in range(100):
        odometry.update(0.0, 0.0)
    again = [0.0] * 36
    odometry.pose_covariance(again)
    assert again == pose
    odometry.twist_covariance(pose)
    assert pose[0] > 0 and pose[35] > 0 and pose[14] == 1e6


def test_the_covariance_matches_random_walks_of_the_wheels():
    # Compared with the covariance of random walks of the wheels, along a curve.
    class Drawn:
        state = 12345

        def normal(self):
            total = -6.0
            for _ in range(12):
                self.state = (self.state * 1103515245 + 12345) & 0x7FFFFFFF
                total += self.state / 0x7FFFFFFF
            return total

    drawn = Drawn()
    ends = []
    for _ in range(300):
        odometry = Odometry()
        for _ in range(40):
            noise = math.sqrt(2e-5 * 0.025)
            few = math.sqrt(2e-5 * 0.001)
            odometry.update(0.025 + noise * drawn.normal(), 0.001 + few * drawn.normal())
        ends.append((odometry.x, odometry.y, odometry.theta))
    mean = [sum(end[i] for end in ends) / len(ends) for i in range(3)]
    pose = [0.0] * 36
    odometry.pose_covariance(pose)
    for i, j, at in ((0, 0, 0), (1, 1, 7), (2, 2, 35), (0, 1, 1), (0, 2, 5), (1, 2, 11)):
        covariance = sum((end[i] - mean[i]) * (end[j] - mean[j]) for end in ends) / len(ends)
        scale = math.sqrt(pose[(0, 7, 35)[i]] * pose[(0, 7, 35)[j]])
        near(covariance / scale, pose[at] / scale, 0.2)


def test_a_square_is_driven_by_a_perfect_body():
    for clockwise in (False, True):
        square = Square(0.5, clockwise=clockwise)
        x = y = theta = 0.0
        corners = []
        for _ in range(3000):
            if not square.step(x, y, theta):
                break
            if square.corner > len(corners):
                corners.append((x, y))
            theta += square.w * 0.02
            x += square.v * 0.02 * math.cos(theta)
            y += square.v * 0.02 * math.sin(theta)
        assert square.corner == 4
        assert square.v == 0 and square.w == 0
        left = -1 if clockwise else 1
        for (x, y), (wanted_x, wanted_y) in zip(corners, ((0.5, 0), (0.5, 0.5), (0, 0.5))):
            near(x, wanted_x, 0.02)
            near(y, left * wanted_y, 0.02)
