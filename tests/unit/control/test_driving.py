"""Control of virtual rovers with manufacturing tolerances, in deterministic time.

The assertions compare true speeds and poses, which the control does not know.
"""

import itertools
import math
import random

import pytest
from support.driving import Car, answers, calibrate, gains, square, tune, use
from support.variants import slow_except

from uros.boards.virtual.world.arena import Arena

FIELD = Arena(size=20.0, boxes=[])


@pytest.mark.parametrize("seed", slow_except(range(6), 0, 1))
def test_tuned_wheels_settle_in_time(seed: int) -> None:
    car = Car(seed)
    tuning = tune(car)
    assert tuning.fault == ""
    fresh = Car(seed, (car.drive.right_pid, car.drive.left_pid))
    for wheel in answers(fresh, 0.3):
        assert wheel.settled < 0.6
        assert wheel.overshoot < 0.1


@pytest.mark.parametrize("seed", slow_except(range(6), 0, 1))
def test_wheels_with_default_gains_settle_in_time(seed: int) -> None:
    for wheel in answers(Car(seed), 0.3):
        assert wheel.settled < 0.6
        assert wheel.overshoot < 0.1


# Of resistance, torque constant and friction, each at an end of ±15 %.
ENDS = list(itertools.product((0.85, 1.15), repeat=3))


@pytest.mark.parametrize("right", ENDS)
def test_tuning_at_the_ends_of_the_spread(right: tuple[float, float, float]) -> None:
    # The other wheel is at the opposite end.
    left = tuple(2.0 - share for share in right)

    def extreme_car() -> Car:
        car = Car(1, spread=0.0)
        for motor, (resistance, emf, friction) in zip(car.rover.motors, (right, left), strict=True):
            motor.resistance *= resistance
            motor.back_emf *= emf
            motor.coulomb *= friction
        return car

    car = extreme_car()
    assert tune(car).fault == ""
    fresh = extreme_car()
    fresh.drive.right_pid, fresh.drive.left_pid = car.drive.right_pid, car.drive.left_pid
    for wheel in answers(fresh, 0.3):
        assert wheel.settled < 0.6
        assert wheel.overshoot < 0.1


@pytest.mark.parametrize("battery", [0.15, 1.0])
def test_gains_hold_for_a_full_battery_and_a_nearly_empty_one(battery: float) -> None:
    car = Car(3)
    tune(car)
    fresh = Car(3, (car.drive.right_pid, car.drive.left_pid), battery=battery)
    for wheel in answers(fresh, 0.3):
        assert wheel.settled < 0.7
        assert wheel.overshoot < 0.1


@pytest.mark.parametrize("seed", slow_except(range(6), 0, 1))
def test_a_square_of_a_metre(seed: int) -> None:
    car = Car(seed)
    square(car, clockwise=bool(seed & 1))
    metres, degrees = car.error()
    # 2 % of the path; the heading includes the manufacturing tolerances.
    assert metres < 0.02 * 4
    assert abs(degrees) < 3.5
    assert math.hypot(car.rover.x, car.rover.y) < 0.08
    assert abs(abs(math.degrees(car.rover.theta)) - 360) < 4


@pytest.mark.parametrize("seed", slow_except(range(4), 0))
def test_a_square_of_a_metre_after_calibration(seed: int) -> None:
    source = random.Random(seed)

    def person(length: float) -> float:
        return length + source.uniform(-0.003, 0.003)

    sizes = calibrate(lambda: Car(seed), person)
    car = Car(seed)
    use(car, sizes)
    square(car, clockwise=bool(seed & 1))
    metres, degrees = car.error()
    assert metres < 0.02 * 4
    assert abs(degrees) < 3
    right, left = car.rover.radii
    assert sizes.right_radius == pytest.approx(right, rel=0.004)
    assert sizes.left_radius == pytest.approx(left, rel=0.004)
    assert sizes.right_radius / sizes.left_radius == pytest.approx(right / left, rel=0.0015)
    assert sizes.d == pytest.approx(car.rover.half_track, rel=0.006)


@pytest.mark.slow
def test_calibration_corrects_a_body_with_large_deviations() -> None:
    def off() -> Car:
        car = Car(9, FIELD_PIDS(), tolerance=0.0)
        # Two per cent between the wheels, one of the track.
        car.rover.radii = (0.0325 * 1.01, 0.0325 * 0.99)
        car.rover.half_track = 0.134 * 1.01
        return car

    car = off()
    square(car)
    before = car.error()
    sizes = calibrate(off)
    car = off()
    use(car, sizes)
    square(car)
    after = car.error()
    assert before[0] > 0.08 and abs(before[1]) > 10
    assert after[0] < 0.02 and abs(after[1]) < 1.5


def FIELD_PIDS() -> tuple:
    return gains(), gains()


@pytest.mark.slow
def test_the_covariance_of_odometry_covers_its_errors() -> None:
    inside = 0
    for seed in range(8):
        car = Car(seed)
        square(car, side=0.5, clockwise=bool(seed & 1))
        pose = [0.0] * 36
        car.odometry.pose_covariance(pose)
        _, degrees = car.error()
        inside += abs(math.radians(degrees)) < 2 * math.sqrt(pose[35])
    assert inside >= 7


def test_a_twist_gives_its_speed_and_its_turn() -> None:
    car = Car(2, arena=FIELD).start()
    car.drive_for(2.0, 0.3, 0.8)
    assert car.rover.v == pytest.approx(0.3, rel=0.05)
    assert car.rover.w == pytest.approx(0.8, rel=0.08)
    assert car.odometry.v == pytest.approx(car.rover.v, rel=0.08)
    car.drive_for(2.0, -0.3, -0.8)
    assert car.rover.v == pytest.approx(-0.3, rel=0.05)
    assert car.rover.w == pytest.approx(-0.8, rel=0.08)


def test_the_documents_quarter_turn() -> None:
    # One command of 1.57 rad/s turns the rover to the left for a second.
    car = Car(1).start()
    car.run(0.1)
    car.drive.command(0.0, 1.57)
    car.run(2.0)
    assert 65 < math.degrees(car.rover.theta) < 95
    assert car.rover.v == car.rover.w == 0


def test_reversals_are_followed_though_the_encoders_have_one_channel() -> None:
    car = Car(4, arena=FIELD).start()
    for _ in range(10):
        car.drive_for(0.7, 0.4, 0.0)
        car.drive_for(0.7, -0.4, 0.0)
    car.drive.stop()
    car.run(0.5)
    metres, degrees = car.error()
    assert car.rover.path_length > 3
    assert metres < 0.03
    assert abs(degrees) < 4


def test_a_lost_cmd_vel_ends_the_drive_within_a_second() -> None:
    car = Car(5, arena=FIELD).start()
    car.drive_for(1.0, 0.5, 0.0)
    assert car.rover.v > 0.4
    car.run(0.88)
    assert car.rover.v > 0.4
    car.run(0.02)
    assert car.drive.right_duty == car.drive.left_duty == 0
    # The wheels come to rest shortly after.
    car.run(0.2)
    assert car.rover.v == car.rover.w == 0
    assert car.drive.right_pid.integral == car.drive.left_pid.integral == 0


def test_a_command_of_nan_has_no_effect() -> None:
    car = Car(5, arena=FIELD).start()
    car.drive_for(1.0, 0.3, 0.0)
    assert not car.drive.command(math.nan, 0.0)
    car.run(0.3)
    assert car.rover.v == pytest.approx(0.3, rel=0.05)


@pytest.mark.parametrize("fault", ["left_stuck", "left_open", "left_encoder_dead"])
def test_a_stalled_wheel_is_reported_without_windup(fault: str) -> None:
    car = Car(6, arena=FIELD).start()
    car.drive_for(1.0, 0.3, 0.0)
    car.rover.fault(fault)
    refused = 0
    for _ in range(20):
        refused += not car.drive.command(0.3, 0.0)
        car.run(0.1)
        assert abs(car.drive.left_pid.ki * car.drive.left_pid.integral) <= 255
        if car.drive.fault:
            break
    assert "left wheel" in car.drive.fault
    # Each accepted command is tried, without success.
    car.drive_for(5.0, 0.3, 0.0)
    assert car.drive.fault
    # Afterwards it drives as before, without windup.
    car.rover.heal()
    car.run(1.1)
    car.drive_for(1.5, 0.3, 0.0)
    assert car.drive.fault == ""
    assert car.rover.speeds[1] == pytest.approx(0.3, rel=0.05)


def test_a_wheel_against_a_wall_is_reported() -> None:
    car = Car(0, arena=Arena(size=1.5, boxes=[])).start()
    car.drive_for(4.0, 0.4, 0.0)
    assert "wheel" in car.drive.fault
    assert car.rover.blocked


@pytest.mark.parametrize(
    ("fault", "words"),
    [
        ("right_stuck", "right wheel"),
        ("left_encoder_dead", "left wheel"),
        ("driver_overheated", "no wheel turns"),
    ],
)
def test_tuning_reports_faults(fault: str, words: str) -> None:
    car = Car(1, arena=FIELD)
    car.rover.fault(fault)
    tuning = tune(car)
    assert words in tuning.fault
    assert tuning.right_duty == tuning.left_duty == 0


def test_tuning_without_power() -> None:
    car = Car(1, arena=FIELD)
    car.rover.power = lambda on: None  # type: ignore[method-assign]
    assert "switched on" in tune(car).fault


def test_tuning_identifies_the_motors() -> None:
    strong, weak = Car(1, spread=0.0), Car(1, spread=0.0)
    for motor in weak.rover.motors:
        motor.back_emf *= 1.15
        motor.coulomb *= 1.15
    strong_motor, weak_motor = tune(strong).right, tune(weak).right
    # More voltage for a speed, and more friction.
    assert weak_motor.kf / strong_motor.kf == pytest.approx(1.15, rel=0.06)
    assert weak_motor.starts > strong_motor.dead_zone > 5
    assert 0.09 < strong_motor.lag < 0.13
    # The rover ends near the start, with about the same heading.
    assert math.hypot(strong.rover.x, strong.rover.y) < 0.2
    assert abs(math.degrees(strong.rover.theta)) < 20


def test_drives_are_deterministic() -> None:
    ends = []
    for _ in range(2):
        car = Car(7)
        square(car, side=0.4)
        ends.append((car.pose, car.odometry.x, car.odometry.y, car.odometry.theta))
    assert ends[0] == ends[1]


def test_ticks_wrap_while_it_drives() -> None:
    ends = []
    # Two seconds before the wrap, and far from it.
    for begin in (0x3FFFFFFF - 2_000_000, 1_000_000):
        car = Car(7, arena=FIELD, begin_us=begin).start()
        car.drive_for(4.0, 0.3, 0.4)
        ends.append(car.pose)
    assert ends[0] == pytest.approx(ends[1], abs=1e-9)


def test_late_interrupts_lose_no_edges() -> None:
    car = Car(3, late_us=5000)
    square(car)
    metres, degrees = car.error()
    assert metres < 0.08 and abs(degrees) < 3.5
