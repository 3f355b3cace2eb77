"""The drive train of a rover, with parts that record their calls."""

from uros.control.autotune import AutoTune
from uros.control.chassis import Chassis
from uros.control.pid import Pid


class Pin:
    def __init__(self):
        self.levels = []
        self.handler = None

    def value(self, level):
        self.levels.append(level)

    def irq(self, handler):
        self.handler = handler


class Motor:
    def __init__(self):
        self.duties = []

    def drive(self, duty):
        self.duties.append(duty)

    def coast(self):
        self.duties.append(None)


class Parts:
    def __init__(self):
        self.now = 0
        self.power = Pin()
        self.motors = (Motor(), Motor())
        self.encoders = (Pin(), Pin())
        self.chassis = Chassis(
            self.power, self.motors[0], self.motors[1], self.encoders[0], self.encoders[1],
            Pid(200, 0), Pid(200, 0), lambda: self.now, timeout_ms=500,
        )  # fmt: skip

    def steps(self, count, right=0, left=0):
        """Run control cycles of 20 ms, with so many edges of each wheel in each."""
        for _ in range(count):
            for pin, edges in zip(self.encoders, (right, left)):
                for n in range(edges):
                    at = self.now
                    self.now = (at + 20000 * (n + 1) // (edges + 1)) & 0x3FFFFFFF
                    pin.handler(pin)
                    self.now = at
            self.now = (self.now + 20000) & 0x3FFFFFFF
            self.chassis.step()


def test_the_supply_is_off_until_it_is_switched_on():
    parts = Parts()
    assert parts.power.levels == [0]
    assert parts.motors[0].duties == parts.motors[1].duties == [None]
    assert not parts.chassis.drive.command(0.3, 0.0)
    parts.steps(3)
    assert parts.motors[0].duties == [None]
    parts.chassis.power(True)
    assert parts.power.levels == [0, 1]
    assert parts.chassis.drive.command(0.3, 0.0)
    parts.steps(5)
    assert parts.motors[0].duties[-1] > 0 and parts.motors[1].duties[-1] > 0
    parts.chassis.power(False)
    assert parts.power.levels == [0, 1, 0]
    assert parts.motors[0].duties[-1] is None and parts.motors[1].duties[-1] is None
    parts.steps(3)
    assert parts.motors[0].duties[-1] is None


def test_edges_of_each_side_count_for_that_side():
    parts = Parts()
    parts.chassis.power(True)
    parts.chassis.drive.command(0.3, 0.0)
    parts.steps(10, 2, 1)
    right, left = parts.chassis.right, parts.chassis.left
    assert (right.edges, left.edges) == (20, 10)
    odometry = parts.chassis.odometry
    assert abs(odometry.distance - 15 * right.pitch) < 2 * right.pitch
    assert odometry.theta > 0.1  # to the left
    assert odometry.v > 0 and odometry.w > 0


def test_options_are_those_of_the_drive():
    parts = Parts()
    parts.chassis.power(True)
    parts.chassis.drive.command(0.3, 0.0)
    parts.steps(24, 1, 1)
    assert parts.chassis.drive.v
    parts.steps(2, 1, 1)
    assert not parts.chassis.drive.v
    assert parts.motors[0].duties[-1] == 0.0


def test_each_wheel_has_its_own_radius():
    parts = Parts()
    chassis = Chassis(
        parts.power, parts.motors[0], parts.motors[1], parts.encoders[0], parts.encoders[1],
        Pid(200, 0), Pid(200, 0), lambda: 0, 0.03, 0.04, 0.1,
    )  # fmt: skip
    assert abs(chassis.right.pitch / chassis.left.pitch - 0.75) < 1e-6
    assert chassis.drive.d == chassis.odometry.d == 0.1


def test_another_controller_drives_until_the_power_is_switched():
    parts = Parts()
    chassis = parts.chassis
    chassis.power(True)
    chassis.control = AutoTune(chassis.right, chassis.left)
    parts.steps(60)
    assert parts.motors[0].duties[-1] > 0  # the ramp of the tuning
    assert chassis.drive.v == 0
    chassis.power(False)
    assert chassis.control is chassis.drive
