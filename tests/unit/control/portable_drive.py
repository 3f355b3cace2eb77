"""Commands, their limits and their end; and where the wheels have brought the body."""

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
    it = DiffDrive(Wheel(), Wheel(), pids[0], pids[1], **options)
    it.power(True)
    it.now = 0
    return it


def steps(it, seconds, right=0, left=0):
    """Time goes on, with an edge of a wheel after each so many microseconds."""
    for _ in range(round(seconds * 50)):
        for t in range(it.now, it.now + STEP, 1000):
            if right and t % right < 1000:
                it.right.edge(t)
            if left and t % left < 1000:
                it.left.edge(t)
        it.now += STEP
        it.step(it.now)


def test_a_twist_becomes_two_speeds():
    # The document's example, 1.0 m/s and 1.57 rad/s, is 1.21 and 0.79 m/s.
    it = drive(fastest=2.0)
    assert it.command(1.0, 1.57)
    near(it._right_target, 1.2104, 1e-3)
    near(it._left_target, 0.7896, 1e-3)
    it.command(-0.2, 0.0)
    near(it._right_target, -0.2)
    near(it._left_target, -0.2)
    # Counter-clockwise is positive: the right wheel goes forward.
    it.command(0.0, 1.0)
    near(it._right_target, 0.134)
    near(it._left_target, -0.134)


def test_what_is_too_fast_becomes_slower_on_the_same_curve():
    for v, w in ((5.0, 3.0), (-2.0, 9.0), (0.0, 100.0), (3e38, 3e38), (1.0, -3e38)):
        it = drive(fastest=0.9)
        assert it.command(v, w)
        fastest = max(abs(it._right_target), abs(it._left_target))
        near(fastest, 0.9, 1e-5)
        if v:
            # The quotient is the curvature.
            near(it.w / it.v / (w / v), 1.0, 1e-5)
    it = drive(fastest=0.9)
    it.command(0.3, 0.5)
    near(it.v, 0.3)
    near(it.w, 0.5)


def test_what_is_no_number_is_refused_and_what_is_driven_goes_on():
    it = drive()
    assert it.command(0.3, 0.0)
    nan = float("nan")
    inf = float("inf")
    for v, w in ((nan, 0.0), (0.0, nan), (inf, 0.0), (0.0, -inf), (nan, nan)):
        assert not it.command(v, w)
    near(it.v, 0.3)
    steps(it, 0.2)
    assert it.right_duty > 0 and it.right_duty == it.right_duty


def test_commands_are_ignored_while_the_motors_are_off():
    it = drive()
    it.power(False)
    assert not it.command(0.3, 0.0)
    steps(it, 0.1)
    assert it.right_duty == 0 and it.left_duty == 0
    it.power(True)
    steps(it, 0.1)
    assert it.right_duty == 0, "a command from before"


def test_it_stops_within_a_second_after_the_last_command_and_forgets():
    it = drive()
    steps(it, 0.1)
    it.command(0.3, 0.5)
    steps(it, 0.9, right=14000, left=22000)
    assert it.right_duty > 0 and it.left_duty > 0
    assert it.right_pid.integral != 0
    steps(it, 0.1, right=14000, left=22000)
    assert it.right_duty == it.left_duty == 0
    for pid in (it.right_pid, it.left_pid):
        assert pid.integral == pid.error == pid.output == 0
    assert it.v == it.w == 0


def test_each_command_begins_a_new_second():
    it = drive()
    for _ in range(30):
        it.command(0.3, 0.0)
        steps(it, 0.1, right=17000, left=17000)
        assert it.right_duty > 0 and it.left_duty > 0


def test_a_command_of_nothing_stops_at_once():
    it = drive()
    it.command(0.3, 0.0)
    steps(it, 0.3, right=17000, left=17000)
    assert it.command(0.0, 0.0)
    assert it.right_duty == it.left_duty == 0


def test_a_change_of_power_forgets_the_integrals():
    it = drive()
    it.command(0.5, 0.0)
    steps(it, 0.5, right=17000, left=17000)
    assert it.right_pid.integral > 0
    it.power(False)
    assert it.right_pid.integral == 0 and it.right_duty == 0
    it.power(True)
    it.command(0.5, 0.0)
    steps(it, 0.5, right=17000, left=17000)
    it.power(True)
    assert it.right_pid.integral == 0 and it.right_duty == 0


def test_a_stuck_wheel_stops_both_and_is_named():
    it = drive()
    for _ in range(9):
        it.command(0.3, 0.0)
        steps(it, 0.1, right=17000)
        if it.fault:
            break
    assert "left wheel" in it.fault, it.fault
    assert it.right_duty == it.left_duty == 0
    assert it.left_pid.integral == 0
    # Not before a second has passed; and then it goes on, and the fault is over.
    assert not it.command(0.3, 0.0)
    steps(it, 1.02)
    assert it.fault
    for _ in range(10):
        assert it.command(0.3, 0.0)
        steps(it, 0.1, right=17000, left=17000)
    assert it.fault == ""


def test_a_wheel_that_reverses_is_braked_until_it_stands():
    it = drive()
    it.command(0.3, 0.0)
    steps(it, 0.5, right=17000, left=17000)
    it.command(-0.3, 0.0)
    steps(it, 0.04, right=17000, left=17000)
    assert it.right_duty == 0 and it.left_duty == 0
    steps(it, 0.2)
    assert it.right_duty < 0 and it.left_duty < 0


def test_odometry_of_a_straight_way_a_circle_and_a_turn_on_the_spot():
    it = Odometry()
    for _ in range(100):
        it.update(0.01, 0.01)
    near(it.x, 1.0)
    near(it.y, 0.0)
    near(it.distance, 1.0)
    it.reset()
    # A quarter of a circle to the left, of radius 0.5.
    turn = math.pi / 2
    for _ in range(100):
        it.update((0.5 + 0.134) * turn / 100, (0.5 - 0.134) * turn / 100)
    near(it.theta, turn)
    near(it.x, 0.5, 1e-4)
    near(it.y, 0.5, 1e-4)
    it.reset()
    for _ in range(100):
        it.update(0.134 * math.pi / 100, -0.134 * math.pi / 100)
    near(it.x, 0.0)
    near(it.y, 0.0)
    near(abs(it.theta), math.pi)


def test_the_heading_wraps_and_the_quaternion_is_a_unit():
    it = Odometry()
    for n in range(1, 1000):
        it.update(0.001, -0.001)
        assert -math.pi - 1e-6 <= it.theta <= math.pi + 1e-6
        near(it.qz * it.qz + it.qw * it.qw, 1.0)
        turned = 0.002 * n / 0.268
        near(math.cos(it.theta), math.cos(turned), 1e-4)
        near(math.sin(it.theta), math.sin(turned), 1e-4)
    it.reset(1.0, 2.0, 0.5)
    near(it.qz, math.sin(0.25))
    near(it.qw, math.cos(0.25))


def test_the_twist_is_a_rate():
    it = Odometry()
    it.update(0.006, 0.004, 0.3, 0.2)
    near(it.v, 0.25)
    near(it.w, 0.1 / 0.268)
    it.update(0.0, 0.0, 0.0, 0.0)
    assert it.v == 0 and it.w == 0


def test_its_doubt_grows_with_the_way_and_not_while_it_stands():
    it = Odometry()
    pose = [9.0] * 36
    it.pose_covariance(pose)
    assert pose[0] == pose[7] == pose[35] == pose[5] == 0
    assert pose[14] == pose[21] == pose[28] == 1e6
    last = 0.0
    for _ in range(5):
        for _ in range(20):
            it.update(0.01, 0.01)
        it.pose_covariance(pose)
        assert pose[0] > 0 and pose[7] >= 0 and pose[35] > last
        last = pose[35]
        for row in range(6):
            for column in range(6):
                assert pose[6 * row + column] == pose[6 * column + row]
    # Straight on, the heading's doubt becomes one of the side.
    assert pose[7] > pose[0] and pose[11] > 0
    for _ in range(100):
        it.update(0.0, 0.0)
    again = [0.0] * 36
    it.pose_covariance(again)
    assert again == pose
    it.twist_covariance(pose)
    assert pose[0] > 0 and pose[35] > 0 and pose[14] == 1e6


def test_the_doubt_is_that_of_a_sum_of_many_wheels():
    # Against a plain sum over random walks of the wheels, along a bent way.
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
        it = Odometry()
        for _ in range(40):
            noise = math.sqrt(2e-5 * 0.025)
            few = math.sqrt(2e-5 * 0.001)
            it.update(0.025 + noise * drawn.normal(), 0.001 + few * drawn.normal())
        ends.append((it.x, it.y, it.theta))
    mean = [sum(end[i] for end in ends) / len(ends) for i in range(3)]
    pose = [0.0] * 36
    it.pose_covariance(pose)
    for i, j, at in ((0, 0, 0), (1, 1, 7), (2, 2, 35), (0, 1, 1), (0, 2, 5), (1, 2, 11)):
        seen = sum((end[i] - mean[i]) * (end[j] - mean[j]) for end in ends) / len(ends)
        scale = math.sqrt(pose[(0, 7, 35)[i]] * pose[(0, 7, 35)[j]])
        near(seen / scale, pose[at] / scale, 0.2)


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
