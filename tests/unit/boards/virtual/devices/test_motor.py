"""One motor with its wheel in the air, against what its constants say."""

import math

import pytest

from uros.boards.virtual.devices import motor
from uros.boards.virtual.devices.motor import Motor


def run(it: Motor, seconds: float, drive: float, brake: float = 0.0, volts: float = 7.0) -> float:
    for _ in range(round(seconds * 1000)):
        it.step(0.001, volts, drive, brake)
    return it.speed


def test_it_runs_as_fast_as_its_voltage_and_its_friction_let_it() -> None:
    it = Motor(spread=0.0)
    speed = run(it, 3.0, 1.0)
    # Torque and friction are equal: Kt (V - Ke w) / R = friction + viscous w.
    ke = motor.BACK_EMF * motor.GEAR
    kt = ke * motor.EFFICIENCY
    wanted = (kt * 7.0 / motor.RESISTANCE - motor.COULOMB) / (
        kt * ke / motor.RESISTANCE + motor.VISCOUS
    )
    assert speed == pytest.approx(wanted, rel=1e-3)
    assert run(Motor(spread=0.0), 3.0, -1.0) == pytest.approx(-wanted, rel=1e-3)


def test_below_its_dead_zone_it_does_not_turn() -> None:
    kt = motor.BACK_EMF * motor.GEAR * motor.EFFICIENCY
    starts = motor.COULOMB * motor.STICTION * motor.RESISTANCE / kt / 7.0
    assert 0.03 < starts < 0.2
    assert run(Motor(spread=0.0), 1.0, starts * 0.98, 1 - starts * 0.98) == 0
    assert run(Motor(spread=0.0), 1.0, starts * 1.02, 1 - starts * 1.02) > 0


def test_what_turns_goes_on_with_less_than_what_it_takes_to_start() -> None:
    it = Motor(spread=0.0)
    kt = motor.BACK_EMF * motor.GEAR * motor.EFFICIENCY
    share = 1.1 * motor.COULOMB * motor.RESISTANCE / kt / 7.0
    assert run(Motor(spread=0.0), 2.0, share, 1 - share) == 0
    run(it, 1.0, 0.5, 0.5)
    assert run(it, 2.0, share, 1 - share) > 0


def test_braking_ends_a_motion_sooner_than_coasting() -> None:
    def until_it_stands(brake: float) -> int:
        it = Motor(spread=0.0)
        run(it, 2.0, 1.0)
        for ms in range(10_000):
            it.step(0.001, 7.0, 0.0, brake)
            if it.speed == 0:
                return ms
        raise AssertionError("it runs for ever")

    assert until_it_stands(1.0) * 2 < until_it_stands(0.0)


def test_braking_in_turn_makes_speed_follow_the_duty() -> None:
    # And coasting in turn does not: half the duty is far more than half the speed.
    full = run(Motor(spread=0.0), 3.0, 1.0)
    half = run(Motor(spread=0.0), 3.0, 0.5, 0.5)
    assert 0.4 < half / full < 0.5
    assert run(Motor(spread=0.0), 3.0, 0.5) / full > 0.8


def test_a_stalled_motor_takes_the_most_current() -> None:
    it = Motor(spread=0.0)
    it.faults.add("stuck")
    run(it, 0.1, 1.0)
    assert it.speed == 0
    assert it.current == it.draw == pytest.approx(7.0 / motor.RESISTANCE)
    it.faults.clear()
    run(it, 3.0, 1.0)
    assert it.current < 0.4 * 7.0 / motor.RESISTANCE


def test_no_energy_comes_from_nowhere() -> None:
    it = Motor(seed=3)
    taken = heat = 0.0
    for ms in range(4000):
        drive = math.sin(ms / 300)
        it.step(0.001, 7.0, drive, 1 - abs(drive))
        taken += it.draw * 7.0 * 0.001
        heat += it.current**2 * it.resistance * 0.001
    assert taken > heat > 0


def test_weak_and_open() -> None:
    sound = run(Motor(spread=0.0), 3.0, 0.3, 0.7)
    weak = Motor(spread=0.0)
    weak.faults.add("weak")
    assert 0 < run(weak, 3.0, 0.3, 0.7) < 0.9 * sound
    broken = Motor(spread=0.0)
    broken.faults.add("open")
    assert run(broken, 1.0, 1.0) == 0
    assert broken.current == 0


def test_motors_differ_by_their_seed_and_within_their_spread() -> None:
    made = [Motor(seed, 0.15) for seed in range(300)]
    for value, nominal in (
        ([it.resistance for it in made], motor.RESISTANCE),
        ([it.back_emf for it in made], motor.BACK_EMF * motor.GEAR),
        ([it.coulomb for it in made], motor.COULOMB),
    ):
        assert min(value) >= nominal * 0.85
        assert max(value) <= nominal * 1.15
        assert max(value) - min(value) > 0.25 * nominal
    assert vars(Motor(7)) == vars(Motor(7))
    with pytest.raises(ValueError, match=r"0 to 0\.15"):
        Motor(0, 0.5)
