"""The rover's body: motion, collisions, faults, and reproducible runs."""

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


def make_rover(seed: object = 0, arena: Arena = ROOM, **options: float) -> Rover:
    rover = Rover("rover", seed, arena, **options)
    rover.power(True)
    return rover


def drive(rover: Rover, right: int, left: int, seconds: float = 0.0) -> None:
    """Set signed duty cycles (of 65535), driving and braking alternately."""
    for channel, duty in ((0, right), (2, left)):
        rover.set_duty(channel, FULL if duty >= 0 else FULL + duty)
        rover.set_duty(channel + 1, FULL - duty if duty >= 0 else FULL)
    run(rover, seconds)


def run(rover: Rover, seconds: float) -> None:
    rover.advance(rover._at + round(seconds * 1e6))


def test_equal_motors_drive_straight_on() -> None:
    rover = make_rover(spread=0.0, tolerance=0.0)
    drive(rover, HALF, HALF, 3.0)
    assert rover.x > 0.8
    assert rover.y == pytest.approx(0, abs=1e-6)
    assert rover.theta == pytest.approx(0, abs=1e-6)
    assert rover.path_length == pytest.approx(rover.x)
    assert rover.v == pytest.approx(rover.speeds[0])
    drive(rover, -HALF, -HALF, 6.0)
    assert rover.x < 0


def test_a_faster_right_wheel_turns_to_the_left() -> None:
    rover = make_rover()
    drive(rover, HALF, HALF // 2, 1.0)
    assert rover.theta > 0.3 and rover.y > 0
    assert rover.w > 0
    rover = make_rover()
    drive(rover, HALF, -HALF, 1.0)
    assert rover.theta > 1
    assert abs(rover.x) < 0.02 and abs(rover.y) < 0.02


def test_the_pose_follows_from_the_wheel_angles() -> None:
    rover = make_rover(3, tolerance=0.005)
    for right, left in ((HALF, HALF), (HALF, -HALF // 2), (-HALF, HALF), (FULL, HALF)):
        drive(rover, right, left, 1.0)
    (right, left), (a, b) = rover.radii, rover.angles
    assert rover.theta == pytest.approx((a * right - b * left) / (2 * rover.half_track))
    assert rover.radii != (RADIUS, RADIUS)


def test_a_run_does_not_depend_on_the_time_steps() -> None:
    def run_by(steps: list[int]) -> tuple[object, ...]:
        rover = make_rover(5, Arena(5))
        edges: list[tuple[int, int, int]] = []
        for side, encoder in enumerate(rover.encoders):
            encoder.on_edge = lambda t, level, side=side: edges.append((t, side, level))
        rover.fault("right_encoder_noise")
        t = 0
        for duty in (HALF, -HALF, FULL):
            drive(rover, duty, HALF)
            end = t + 900_000
            while t < end:
                t = min(t + steps[t % len(steps)], end)
                rover.advance(t)
        assert [when for when, _, _ in edges] == sorted(when for when, _, _ in edges)
        return rover.x, rover.y, rover.theta, rover.battery, edges

    once = run_by([900_000])
    assert once == run_by([1000]) == run_by([333, 5000, 17, 20_011])
    assert len(once[-1]) > 50  # type: ignore[arg-type]


def test_inputs_take_effect_at_the_next_whole_millisecond() -> None:
    rover, delayed = make_rover(), make_rover()
    rover.advance(1500)
    drive(rover, FULL, FULL)
    delayed.advance(1999)
    drive(delayed, FULL, FULL)
    rover.advance(50_000)
    delayed.advance(50_000)
    assert rover.angles == delayed.angles and rover.angles[0] > 0


def test_without_motor_power_the_rover_rolls_to_a_stop() -> None:
    rover = make_rover()
    drive(rover, HALF, HALF, 1.0)
    assert rover.v > 0.3
    rover.power(False)
    run(rover, 3.0)
    assert rover.v == 0
    x = rover.x
    run(rover, 1.0)
    assert rover.x == x


def test_a_reset_clears_duties_and_motor_power() -> None:
    rover = make_rover()
    drive(rover, HALF, HALF, 1.0)
    rover.reset()
    run(rover, 3.0)
    assert rover.v == 0 and not rover.driver.powered


def test_a_wall_stops_the_rover() -> None:
    rover = make_rover(arena=Arena(size=3.0, boxes=[]), spread=0.0, tolerance=0.0)
    drive(rover, FULL, FULL, 5.0)
    assert rover.x == pytest.approx(1.5 - BODY, abs=0.002)
    assert rover.v == 0 and rover.blocked and "wall" in rover.shows()
    assert rover.speeds[0] == 0, "its wheels stop too"
    assert rover.current > 1, "and its motors take the current of stalled ones"
    # It can turn there, and leave.
    drive(rover, HALF, -HALF, 0.3)
    assert rover.theta > 0.1
    drive(rover, -HALF, -HALF, 0.5)
    assert not rover.blocked and rover.x < 1.3


def test_a_rover_pressed_against_a_wall_does_not_turn() -> None:
    rover = make_rover(1, arena=Arena(size=3.0, boxes=[]))
    drive(rover, HALF, HALF, 5.0)
    assert rover.blocked
    theta = rover.theta
    drive(rover, FULL, HALF, 1.0)
    assert rover.theta == theta


def test_driving_one_wheel_hardly_moves_the_other() -> None:
    # The wheels are coupled by the body's mass.
    rover = make_rover(spread=0.0, tolerance=0.0)
    rover.driver.faults.add("dead_b")
    drive(rover, FULL, 0, 0.1)
    assert rover.angles[0] > 0.1
    assert rover.angles[1] < 0.0
    assert abs(rover.angles[1]) < 0.2 * rover.angles[0]


def test_a_box_stops_the_rover() -> None:
    box = Box(0.6, -0.3, 0.8, 0.3, 0.3, (0, 0, 0))
    rover = make_rover(arena=Arena(size=3.0, boxes=[box]), spread=0.0, tolerance=0.0)
    drive(rover, HALF, HALF, 5.0)
    assert rover.x == pytest.approx(0.6 - BODY, abs=0.002)


def test_the_battery_voltage_drops_under_load_and_the_charge_decreases() -> None:
    rover = make_rover(battery=0.5)
    rest_volts = open_volts(0.5)
    drive(rover, FULL, FULL, 0.05)
    assert rover.volts < rest_volts - 0.1
    rover.fault("left_stuck")
    rover.fault("right_stuck")
    drive(rover, FULL, FULL, 10.0)
    assert rover.volts < rest_volts - 0.2
    assert 0.49 < rover.battery < 0.5
    full, empty = make_rover(battery=1.0), make_rover(battery=1.0)
    empty.fault("low_battery")
    for each in (full, empty):
        drive(each, FULL, FULL, 3.0)
    assert empty.v < 0.85 * full.v


def test_the_voltage_rises_with_the_charge() -> None:
    volts = [open_volts(level / 100) for level in range(-5, 110)]
    assert volts == sorted(volts)
    assert volts[0] == pytest.approx(6.2) and volts[-1] == pytest.approx(8.3)
    assert open_volts(0.5) == pytest.approx(7.4)


def test_the_rover_turns_around_a_stuck_wheel() -> None:
    rover = make_rover()
    rover.fault("left_stuck")
    drive(rover, HALF, HALF, 1.0)
    assert rover.angles[1] == 0 and rover.angles[0] > 1
    turned_around = math.hypot(rover.x, rover.y - rover.half_track)
    assert turned_around == pytest.approx(rover.half_track, abs=1e-3)
    rover.heal()
    drive(rover, HALF, HALF, 1.0)
    assert rover.angles[1] > 1


def test_slip_loses_distance_that_the_encoders_do_not_measure() -> None:
    sound, slips = make_rover(), make_rover()
    slips.fault("slip")
    for rover in (sound, slips):
        drive(rover, HALF, HALF, 2.0)
    assert slips.angles == sound.angles
    assert slips.path_length == pytest.approx(0.75 * sound.path_length, rel=0.01)


@pytest.mark.parametrize("fault", sorted(Rover.FAULTS))
def test_each_fault_changes_a_run_and_can_be_cleared(fault: str) -> None:
    def outcome(rover: Rover) -> tuple[object, ...]:
        edges: list[tuple[int, int]] = []
        for encoder in rover.encoders:
            encoder.on_edge = lambda t, level: edges.append((t, level))
        drive(rover, HALF, HALF, 1.0)
        return rover.x, rover.angles[0], rover.angles[1], edges

    rover = make_rover(seed=2)
    rover.fault(fault)
    assert outcome(rover) != outcome(make_rover(seed=2))
    rover = make_rover(seed=2)
    rover.fault(fault)
    rover.heal()
    assert outcome(rover) == outcome(make_rover(seed=2))


def test_an_unknown_fault_is_refused() -> None:
    with pytest.raises(ValueError, match="left_stuck"):
        make_rover().fault("rust")


def test_actions_of_the_user() -> None:
    rover = make_rover(arena=Arena(size=3.0, boxes=[]))
    rover.act("place", "0.5, -0.25, 90")
    assert (rover.x, rover.y) == (0.5, -0.25)
    assert rover.theta == pytest.approx(math.pi / 2)
    rover.act("push", "0.1")
    assert rover.x == pytest.approx(0.4) and rover.y == pytest.approx(-0.25)
    rover.act("push")
    assert rover.x == pytest.approx(0.35)
    rover.act("push", "9")
    assert rover.x == pytest.approx(-1.35, abs=0.01)
    rover.act("battery", "20")
    assert rover.battery == 0.2
    assert rover.shows() == "-1.350 m, -0.250 m, 90.0°"
    with pytest.raises(ValueError, match="no room"):
        rover.act("place", "1.45,0,0")
    with pytest.raises(ValueError, match="it has push"):
        rover.act("kick")


@given(st.sampled_from(sorted(Rover.ACTS)), st.text(max_size=20))
def test_any_value_of_an_action_is_accepted_or_refused_with_a_text(kind: str, value: str) -> None:
    rover = make_rover(arena=Arena(size=3.0, boxes=[]))
    try:
        rover.act(kind, value)
    except ValueError as error:
        assert len(str(error)) > 10
    assert rover.arena.is_free(rover.x, rover.y, BODY)
    assert 0 <= rover.battery <= 1


def test_the_simulation_is_twenty_times_faster_than_real_time() -> None:
    rover = make_rover(arena=Arena(1))
    best = math.inf
    for _ in range(5):
        began = time.process_time()
        drive(rover, HALF, -HALF, 1.0)
        best = min(best, time.process_time() - began)
    assert best < 1 / 20


def test_time_at_rest_is_not_integrated() -> None:
    rover = make_rover()
    began = time.process_time()
    rover.advance(10**12)
    assert time.process_time() - began < 1
    drive(rover, HALF, HALF, 1.0)
    assert rover.x > 0.1
