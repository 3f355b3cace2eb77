"""The rover's body: where its wheels bring it, what stops it, and that it is the same each time."""

import math
import time

import pytest
from hypothesis import given
from hypothesis import strategies as st

from uros.boards.virtual.devices.drv8835 import FULL
from uros.boards.virtual.world.arena import Arena, Box
from uros.boards.virtual.world.rover import BODY, RADIUS, Rover, open_volts

ROOM = Arena(size=20.0, boxes=[])
HALF = FULL // 2


def rover(seed: object = 0, arena: Arena = ROOM, **options: float) -> Rover:
    it = Rover("rover", seed, arena, **options)
    it.power(True)
    return it


def drive(it: Rover, right: int, left: int, seconds: float = 0.0) -> None:
    """Duties of 65535 with a sign, driving and braking in turn."""
    for channel, duty in ((0, right), (2, left)):
        it.set_duty(channel, FULL if duty >= 0 else FULL + duty)
        it.set_duty(channel + 1, FULL - duty if duty >= 0 else FULL)
    run(it, seconds)


def run(it: Rover, seconds: float) -> None:
    it.advance(it._at + round(seconds * 1e6))


def test_equal_motors_drive_it_straight_on() -> None:
    it = rover(spread=0.0, tolerance=0.0)
    drive(it, HALF, HALF, 3.0)
    assert it.x > 0.8
    assert it.y == pytest.approx(0, abs=1e-6)
    assert it.theta == pytest.approx(0, abs=1e-6)
    assert it.path_length == pytest.approx(it.x)
    assert it.v == pytest.approx(it.speeds[0])
    drive(it, -HALF, -HALF, 6.0)
    assert it.x < 0


def test_a_faster_right_wheel_turns_it_to_the_left() -> None:
    it = rover()
    drive(it, HALF, HALF // 2, 1.0)
    assert it.theta > 0.3 and it.y > 0
    assert it.w > 0
    it = rover()
    drive(it, HALF, -HALF, 1.0)
    assert it.theta > 1
    assert abs(it.x) < 0.02 and abs(it.y) < 0.02


def test_its_pose_is_that_of_its_wheels() -> None:
    it = rover(3, tolerance=0.005)
    for right, left in ((HALF, HALF), (HALF, -HALF // 2), (-HALF, HALF), (FULL, HALF)):
        drive(it, right, left, 1.0)
    (right, left), (a, b) = it.radii, it.angles
    assert it.theta == pytest.approx((a * right - b * left) / (2 * it.half_track))
    assert it.radii != (RADIUS, RADIUS)


def test_a_run_is_the_same_in_whatever_rhythm_it_is_advanced() -> None:
    def run_by(steps: list[int]) -> tuple[object, ...]:
        it = rover(5, Arena(5))
        told: list[tuple[int, int, int]] = []
        for side, encoder in enumerate(it.encoders):
            encoder.on_edge = lambda t, level, side=side: told.append((t, side, level))
        it.fault("right_encoder_noise")
        t = 0
        for duty in (HALF, -HALF, FULL):
            drive(it, duty, HALF)
            end = t + 900_000
            while t < end:
                t = min(t + steps[t % len(steps)], end)
                it.advance(t)
        assert [when for when, _, _ in told] == sorted(when for when, _, _ in told)
        return it.x, it.y, it.theta, it.battery, told

    once = run_by([900_000])
    assert once == run_by([1000]) == run_by([333, 5000, 17, 20_011])
    assert len(once[-1]) > 50  # type: ignore[arg-type]


def test_what_is_set_counts_from_the_next_whole_millisecond_on() -> None:
    it, other = rover(), rover()
    it.advance(1500)
    drive(it, FULL, FULL)
    other.advance(1999)
    drive(other, FULL, FULL)
    it.advance(50_000)
    other.advance(50_000)
    assert it.angles == other.angles and it.angles[0] > 0


def test_without_the_motors_power_it_rolls_to_a_stand() -> None:
    it = rover()
    drive(it, HALF, HALF, 1.0)
    assert it.v > 0.3
    it.power(False)
    run(it, 3.0)
    assert it.v == 0
    x = it.x
    run(it, 1.0)
    assert it.x == x


def test_a_reset_ends_its_duties_and_its_power() -> None:
    it = rover()
    drive(it, HALF, HALF, 1.0)
    it.reset()
    run(it, 3.0)
    assert it.v == 0 and not it.driver.powered


def test_a_wall_stops_it() -> None:
    it = rover(arena=Arena(size=3.0, boxes=[]), spread=0.0, tolerance=0.0)
    drive(it, FULL, FULL, 5.0)
    assert it.x == pytest.approx(1.5 - BODY, abs=0.002)
    assert it.v == 0 and it.blocked and "wall" in it.shows()
    assert it.speeds[0] == 0, "its wheels stand too"
    assert it.current > 1, "and its motors take what stalled ones do"
    # It can turn there, and leave.
    drive(it, HALF, -HALF, 0.3)
    assert it.theta > 0.1
    drive(it, -HALF, -HALF, 0.5)
    assert not it.blocked and it.x < 1.3


def test_pressed_against_a_wall_it_does_not_turn() -> None:
    it = rover(1, arena=Arena(size=3.0, boxes=[]))
    drive(it, HALF, HALF, 5.0)
    assert it.blocked
    theta = it.theta
    drive(it, FULL, HALF, 1.0)
    assert it.theta == theta


def test_one_wheel_alone_moves_the_other_one_too_little_to_matter() -> None:
    # The body's mass is between them: a push at one side is one on the other side's wheel.
    it = rover(spread=0.0, tolerance=0.0)
    it.driver.faults.add("dead_b")
    drive(it, FULL, 0, 0.1)
    assert it.angles[0] > 0.1
    assert it.angles[1] < 0.0
    assert abs(it.angles[1]) < 0.2 * it.angles[0]


def test_a_box_stops_it_too() -> None:
    box = Box(0.6, -0.3, 0.8, 0.3, 0.3, (0, 0, 0))
    it = rover(arena=Arena(size=3.0, boxes=[box]), spread=0.0, tolerance=0.0)
    drive(it, HALF, HALF, 5.0)
    assert it.x == pytest.approx(0.6 - BODY, abs=0.002)


def test_its_battery_sags_and_runs_down() -> None:
    it = rover(battery=0.5)
    rest = open_volts(0.5)
    drive(it, FULL, FULL, 0.05)
    assert it.volts < rest - 0.1
    it.fault("left_stuck")
    it.fault("right_stuck")
    drive(it, FULL, FULL, 10.0)
    assert it.volts < rest - 0.2
    assert 0.49 < it.battery < 0.5
    full, empty = rover(battery=1.0), rover(battery=1.0)
    empty.fault("low_battery")
    for each in (full, empty):
        drive(each, FULL, FULL, 3.0)
    assert empty.v < 0.85 * full.v


def test_the_voltage_rises_with_the_charge() -> None:
    volts = [open_volts(level / 100) for level in range(-5, 110)]
    assert volts == sorted(volts)
    assert volts[0] == pytest.approx(6.2) and volts[-1] == pytest.approx(8.3)
    assert open_volts(0.5) == pytest.approx(7.4)


def test_a_stuck_wheel_is_what_it_turns_around() -> None:
    it = rover()
    it.fault("left_stuck")
    drive(it, HALF, HALF, 1.0)
    assert it.angles[1] == 0 and it.angles[0] > 1
    assert math.hypot(it.x, it.y - it.half_track) == pytest.approx(it.half_track, abs=1e-3)
    it.heal()
    drive(it, HALF, HALF, 1.0)
    assert it.angles[1] > 1


def test_a_slip_loses_way_and_the_encoders_do_not_see_it() -> None:
    sound, slips = rover(), rover()
    slips.fault("slip")
    for it in (sound, slips):
        drive(it, HALF, HALF, 2.0)
    assert slips.angles == sound.angles
    assert slips.path_length == pytest.approx(0.75 * sound.path_length, rel=0.01)


@pytest.mark.parametrize("fault", sorted(Rover.FAULTS))
def test_each_fault_makes_a_difference_and_is_healed(fault: str) -> None:
    def seen(it: Rover) -> tuple[object, ...]:
        told: list[tuple[int, int]] = []
        for encoder in it.encoders:
            encoder.on_edge = lambda t, level: told.append((t, level))
        drive(it, HALF, HALF, 1.0)
        return it.x, it.angles[0], it.angles[1], told

    it = rover(seed=2)
    it.fault(fault)
    assert seen(it) != seen(rover(seed=2))
    it = rover(seed=2)
    it.fault(fault)
    it.heal()
    assert seen(it) == seen(rover(seed=2))


def test_a_fault_that_it_does_not_have() -> None:
    with pytest.raises(ValueError, match="left_stuck"):
        rover().fault("rust")


def test_acts() -> None:
    it = rover(arena=Arena(size=3.0, boxes=[]))
    it.act("place", "0.5, -0.25, 90")
    assert (it.x, it.y) == (0.5, -0.25)
    assert it.theta == pytest.approx(math.pi / 2)
    it.act("push", "0.1")
    assert it.x == pytest.approx(0.4) and it.y == pytest.approx(-0.25)
    it.act("push")
    assert it.x == pytest.approx(0.35)
    it.act("push", "9")
    assert it.x == pytest.approx(-1.35, abs=0.01)
    it.act("battery", "20")
    assert it.battery == 0.2
    assert it.shows() == "-1.350 m, -0.250 m, 90.0°"
    with pytest.raises(ValueError, match="no room"):
        it.act("place", "1.45,0,0")
    with pytest.raises(ValueError, match="it knows push"):
        it.act("kick")


@given(st.sampled_from(sorted(Rover.ACTS)), st.text(max_size=20))
def test_any_value_of_an_act_is_taken_or_refused_with_a_text(kind: str, value: str) -> None:
    it = rover(arena=Arena(size=3.0, boxes=[]))
    try:
        it.act(kind, value)
    except ValueError as error:
        assert len(str(error)) > 10
    assert it.arena.free(it.x, it.y, BODY)
    assert 0 <= it.battery <= 1


def test_it_is_twenty_times_faster_than_the_world() -> None:
    it = rover(arena=Arena(1))
    best = math.inf
    for _ in range(5):
        began = time.process_time()
        drive(it, HALF, -HALF, 1.0)
        best = min(best, time.process_time() - began)
    assert best < 1 / 20


def test_standing_still_costs_nothing() -> None:
    it = rover()
    began = time.process_time()
    it.advance(10**12)
    assert time.process_time() - began < 1
    drive(it, HALF, HALF, 1.0)
    assert it.x > 0.1
