"""A rover and its control in virtual time: the board's work between encoders and motor driver."""

import math
from collections.abc import Callable

from uros.boards.virtual.world.arena import Arena
from uros.boards.virtual.world.rover import Rover
from uros.control.autotune import AutoTune
from uros.control.calibrate import Calibration
from uros.control.diff_drive import DiffDrive
from uros.control.odometry import Odometry
from uros.control.pid import Pid
from uros.control.square import Square
from uros.control.wheel import Wheel
from uros.drivers.drv8835 import DRV8835

PERIOD_US = 20_000
TICKS = 0x3FFFFFFF


class Pwm:
    """The part of machine.PWM that DRV8835 uses, on an input of the rover's motor driver."""

    def __init__(self, rover: Rover, channel: int) -> None:
        self.rover = rover
        self.channel = channel

    def duty_u16(self, duty: int) -> None:
        self.rover.set_duty(self.channel, duty)


class Car:
    """A rover with its wheels, control and odometry.

    ``seed`` is the rover's. The board's ticks begin at ``begin_us``, and its interrupts come at
    multiples of ``late_us``.
    """

    def __init__(
        self,
        seed: object = 0,
        pids: tuple[Pid, Pid] | None = None,
        arena: Arena | None = None,
        begin_us: int = 0,
        period_us: int = PERIOD_US,
        late_us: int = 1,
        **rover: float,
    ) -> None:
        self.rover = Rover(seed=seed, arena=arena, **rover)
        self.right, self.left = Wheel(), Wheel()
        self.wheels = (self.right, self.left)
        for encoder, wheel in zip(self.rover.encoders, self.wheels, strict=True):
            encoder.on_edge = lambda t_us, level, wheel=wheel: wheel.edge(
                self.ticks(-(-t_us // late_us) * late_us)
            )
        if pids is None:
            pids = (gains(), gains())
        self.drive = DiffDrive(self.right, self.left, *pids)
        self.odometry = Odometry()
        self.bridges = tuple(
            DRV8835(Pwm(self.rover, 2 * n), Pwm(self.rover, 2 * n + 1)) for n in (0, 1)
        )
        self.t_us = 0
        self.begin_us = begin_us
        self.period_us = period_us
        self.steps = 0
        self.on_step = lambda: None

    def ticks(self, t_us: int) -> int:
        return (t_us + self.begin_us) & TICKS

    def start(self) -> "Car":
        self.rover.power(True)
        self.drive.power(True)
        return self

    def settle(self) -> None:
        """Measure for one period, without control."""
        self.t_us += self.period_us
        self.rover.advance(self.t_us)
        for wheel, duty in zip(self.wheels, self.duties, strict=True):
            wheel.update(self.ticks(self.t_us), duty)

    def step(self) -> None:
        """Advance by one period: first the world, then the control."""
        self.t_us += self.period_us
        self.rover.advance(self.t_us)
        self.drive.step(self.ticks(self.t_us))
        self.give(self.drive.right_duty, self.drive.left_duty)
        self.odometry.update(self.right.moved, self.left.moved, self.right.speed, self.left.speed)
        self.on_step()

    def give(self, right: float, left: float) -> None:
        self.bridges[0].drive(right)
        self.bridges[1].drive(left)

    def run(self, seconds: float) -> None:
        for _ in range(round(seconds * 1e6 / self.period_us)):
            self.step()

    def drive_for(self, seconds: float, v: float, w: float) -> None:
        """Drive with speeds ``v`` and ``w``, commanded ten times a second."""
        end = self.t_us + round(seconds * 1e6)
        while self.t_us < end:
            self.drive.command(v, w)
            self.run(min(0.1, (end - self.t_us) / 1e6))

    @property
    def pose(self) -> tuple[float, float, float]:
        """The true pose."""
        return self.rover.x, self.rover.y, self.rover.theta

    def error(self) -> tuple[float, float]:
        """The odometry's error in metres and degrees. The rover began at 0, 0, 0."""
        x, y, theta = self.pose
        turn = math.remainder(self.odometry.theta - theta, math.tau)
        return math.hypot(self.odometry.x - x, self.odometry.y - y), math.degrees(turn)


def gains() -> Pid:
    """The gains for a rover with average motors."""
    return Pid(kp=150, ki=1000, dead_zone=21, kf=214, lag=0.13)


class Stuck(AssertionError):
    """A drive that does not end."""


def tune(car: Car) -> AutoTune:
    """Run the self-tuning and apply the gains where there is no fault; the AutoTune."""
    tuning = AutoTune(car.right, car.left)
    car.rover.power(True)
    going = True
    while going:
        car.t_us += car.period_us
        car.rover.advance(car.t_us)
        going = tuning.step(car.ticks(car.t_us))
        car.give(tuning.right_duty, tuning.left_duty)
        if car.t_us > 60_000_000:
            raise Stuck("it is still tuning after a minute")
    if not tuning.fault:
        tuning.apply(car.drive.right_pid, car.drive.left_pid)
    return tuning


def square(
    car: Car,
    side: float = 1.0,
    clockwise: bool = False,
    corner: Callable[[], None] = lambda: None,
) -> None:
    """Drive a square by odometry, with a command each 40 ms.

    ``corner`` is called when the rover stands at the end of the first side.
    """
    plan = Square(side, clockwise=clockwise)
    car.start()
    car.run(0.1)
    begun = car.t_us
    first = True
    while plan.step(car.odometry.x, car.odometry.y, car.odometry.theta):
        car.drive.command(plan.v, plan.w)
        car.run(0.04)
        if plan.turning and first:
            first = False
            car.drive.stop()
            car.run(0.4)
            corner()
        if car.t_us - begun > 120_000_000:
            raise Stuck(f"corner {plan.corner} after two minutes; {car.drive.fault}")
    car.drive.stop()
    car.run(0.5)


def calibrate(make: Callable[[], Car], measure: Callable[[float], float] = float) -> Calibration:
    """Calibrate by squares in both directions, each with a new ``make()`` of the same body.

    ``measure`` returns the length that a person measures for a true length.
    """
    calibration = Calibration()
    for clockwise in (False, True):
        car = make()
        car.on_step = lambda car=car: calibration.add(car.right.moved, car.left.moved)
        if clockwise:
            calibration.restart()
        square(
            car,
            clockwise=clockwise,
            corner=lambda car=car: calibration.measured(measure(car.rover.x), measure(car.rover.y)),
        )
        x, y, theta = car.pose
        calibration.measured(measure(x), measure(y), theta + 2 * measure(0.0))
    calibration.solve()
    return calibration


def use(car: Car, calibration: Calibration) -> None:
    """Apply the calibrated sizes to control and odometry."""
    car.right.set_radius(calibration.right_radius)
    car.left.set_radius(calibration.left_radius)
    car.drive.d = car.odometry.d = calibration.d


class Answer:
    """The step response of one wheel.

    ``overshoot`` is a share of the target, ``settled`` the seconds until the speed stays within 5 %
    of the target.
    """

    def __init__(self, course: list[tuple[float, float]], target: float) -> None:
        self.course = course
        self.overshoot = max(max(speed / target for _, speed in course) - 1, 0.0)
        off = [t for t, speed in course if abs(speed / target - 1) > 0.05]
        self.settled = max(off, default=0.0)


def answers(car: Car, v: float, seconds: float = 1.5) -> tuple[Answer, Answer]:
    """The responses of both wheels to a step from 0 to ``v``, by true speeds each millisecond."""
    courses: tuple[list[tuple[float, float]], ...] = ([], [])
    car.start()
    car.run(0.1)
    begun = car.t_us
    while car.t_us < begun + seconds * 1e6:
        car.drive.command(v, 0.0)
        before = car.t_us
        for ms in range(before + 1000, before + car.period_us, 1000):
            car.rover.advance(ms)
            for course, speed in zip(courses, car.rover.speeds, strict=True):
                course.append(((ms - begun) / 1e6, speed))
        car.step()
    return Answer(courses[0], v), Answer(courses[1], v)
