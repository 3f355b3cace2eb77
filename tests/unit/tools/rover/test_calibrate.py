"""uros calibrate: the squares it drives, in virtual time, and what a person types."""

import math
from types import SimpleNamespace

import pytest
from support.driving import Car
from support.variants import slow_except

from uros.control.calibrate import Calibration
from uros.tools import cli
from uros.tools.errors import ToolError
from uros.tools.rover.calibrate import Watched, read_pose, square

SAID_US = 1_000_000  # odometry comes once a second


class Driven(Watched):
    """A virtual rover, watched by odometry once a second and measured to ``blur`` metres."""

    def __init__(self, seed, blur=0.0, **rover):
        super().__init__()
        self.car = Car(seed, **rover).start()
        self.blur = blur
        self.slips = []  # of the pen, one an answer
        self.asked = []
        self.said = []
        self.tell()

    def say(self, text):
        self.said.append(text)

    def tell(self):
        """An Odometry."""
        odometry = self.car.odometry
        point = SimpleNamespace(x=odometry.x, y=odometry.y)
        turn = SimpleNamespace(z=odometry.qz, w=odometry.qw)
        twist = SimpleNamespace(
            linear=SimpleNamespace(x=odometry.v), angular=SimpleNamespace(z=odometry.w)
        )
        pose = SimpleNamespace(position=point, orientation=turn)
        message = SimpleNamespace(
            pose=SimpleNamespace(pose=pose), twist=SimpleNamespace(twist=twist)
        )
        self.heard(message, self.now())

    def now(self):
        return self.car.t_us / 1e6

    def wait(self, seconds):
        until = self.car.t_us + round(seconds * 1e6)
        while self.car.t_us < until:
            before = self.car.t_us // SAID_US
            self.car.step()
            if self.car.t_us // SAID_US != before:
                self.tell()
                return True
        return False

    def command(self, v, w):
        self.car.drive.command(v, w)

    def ask_pose(self, what):
        self.asked.append(what)
        if self.slips:
            return self.slips.pop()
        rover = self.car.rover
        return rover.x + self.blur, rover.y, rover.theta

    def put_back(self):
        self.car.rover.act("place", "0,0,0")


@pytest.mark.parametrize("seed", slow_except(range(4), 0))
def test_two_squares_find_the_wheels_and_the_track(seed):
    rover = Driven(seed, tolerance=0.01)
    calibration = Calibration()
    square(rover, calibration, 1.0, 0.2, False)
    calibration.restart()
    rover.put_back()
    square(rover, calibration, 1.0, 0.2, True)
    assert rover.asked == ["after the first side", "at the end"] * 2
    calibration.solve()
    right, left = rover.car.rover.radii
    assert calibration.right_radius == pytest.approx(right, rel=0.003)
    assert calibration.left_radius == pytest.approx(left, rel=0.003)
    assert calibration.d == pytest.approx(rover.car.rover.half_track, rel=0.006)
    nominal = max(abs(radius / 0.0325 - 1) for radius in (right, left))
    assert nominal > 0.003  # there was something to find


def test_an_implausible_pose_is_reported_and_asked_again():
    rover = Driven(2)
    calibration = Calibration()
    rover.slips = [(98.0, 1.0)]  # centimetres
    square(rover, calibration, 1.0, 0.2, False)
    assert rover.asked == ["after the first side", "after the first side", "at the end"]
    (said,) = rover.said
    assert said.startswith("this is 97.0") and "metres from the origin" in said
    calibration.restart()
    rover.put_back()
    square(rover, calibration, 1.0, 0.2, True)
    calibration.solve()
    assert calibration.right_radius == pytest.approx(rover.car.rover.radii[0], rel=0.003)


def test_a_rover_that_does_not_move_is_reported():
    rover = Driven(1)
    rover.car.rover.fault("right_stuck")
    rover.car.rover.fault("left_stuck")
    with pytest.raises(ToolError, match="are its motors on, is it against a wall"):
        square(rover, Calibration(), 1.0, 0.2, False)


def test_the_steps_of_a_turn_are_on_an_arc():
    rover = Watched()
    steps = []
    rover.on_step = lambda ds, dtheta: steps.append((ds, dtheta))
    for turn in (0.0, 1.0, 2.5, 3.5, 6.0):  # a circle of radius 2; past a half turn, and round
        half = turn / 2
        point = SimpleNamespace(x=2 * math.sin(turn), y=2 - 2 * math.cos(turn))
        quaternion = SimpleNamespace(z=math.sin(half), w=math.cos(half))
        zero = SimpleNamespace(x=0.0, z=0.0)
        pose = SimpleNamespace(position=point, orientation=quaternion)
        message = SimpleNamespace(
            pose=SimpleNamespace(pose=pose),
            twist=SimpleNamespace(twist=SimpleNamespace(linear=zero, angular=zero)),
        )
        rover.heard(message, 0.0)
    assert steps == [
        pytest.approx(step) for step in ((2.0, 1.0), (3.0, 1.5), (2.0, 1.0), (5.0, 2.5))
    ]
    assert rover.theta == pytest.approx(6.0)


def test_poses_that_are_typed():
    assert read_pose("0.998 0.004\n") == (0.998, 0.004)
    assert read_pose(" 1,-0.02, 90") == (1.0, -0.02, pytest.approx(math.pi / 2))
    assert read_pose("\n") == ()


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("1", "type x and y in metres"), ("1 2 3 4", "type x and y"),
        ("a b", "'a b': type numbers"),
        ("nan 0", "this is too far away"), ("1e9 0", "this is too far away"),
    ],
)  # fmt: skip
def test_invalid_poses_are_reported(text, words):
    with pytest.raises(ValueError, match=words):
        read_pose(text)


def test_bad_command_lines(capsys):
    for arguments in (["--side", "0"], ["--odom", "a b"], ["--speed", "fast"]):
        assert cli.main(["calibrate", *arguments]) == 2
    assert capsys.readouterr().err.count("uros calibrate: error: ") == 3
