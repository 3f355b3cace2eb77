"""One motor with its wheel off the ground, against its constants."""

import math

import pytest

from uros.boards.virtual.devices import motor
from uros.boards.virtual.devices.motor import Motor


def run(
    dc_motor: Motor, seconds: float, drive: float, brake: float = 0.0, volts: float = 7.0
) -> float:
    for _ in range(round(seconds * 1000)):
        dc_motor.step(0.001, volts, drive, brake)
    return dc_motor.speed


def test_speed_follows_from_voltage_and_friction() -> None:
    dc_motor = Motor(spread=0.0)
    speed = run(dc_motor, 3.0, 1.0)
    # Torque and friction are equal: Kt (V - Ke w) / R = friction + viscous w.
    ke = motor.BACK_EMF * motor.GEAR
    kt = ke * motor.EFFICIENCY
    wanted = (kt * 7.0 / motor.RESISTANCE - motor.COULOMB) / (
        kt * ke / motor.RESISTANCE + motor.VISCOUS
    )
    assert speed == pytest.approx(wanted, rel=1e-3)
    assert run(Motor(spread=0.0), 3.0, -1.0) == pytest.approx(-wanted, rel=1e-3)


def test_a_motor_does_not_turn_in_its_dead_zone() -> None:
    kt = motor.BACK_EMF * motor.GEAR * motor.EFFICIENCY
    starts = motor.COULOMB * motor.STICTION * motor.RESISTANCE / kt / 7.0
    assert 0.03 < starts < 0.2
    assert run(Motor(spread=0.0), 1.0, starts * 0.98, 1 - starts * 0.98) == 0
    assert run(Motor(spread=0.0), 1.0, starts * 1.02, 1 - starts * 1.02) > 0


def test_starting_takes_a_higher_duty_than_running() -> None:
    dc_motor = Motor(spread=0.0)
    kt = motor.BACK_EMF * motor.GEAR * motor.EFFICIENCY
    share = 1.1 * motor.COULOMB * motor.RESISTANCE / kt / 7.0
    assert run(Motor(spread=0.0), 2.0, share, 1 - share) == 0
    run(dc_motor, 1.0, 0.5, 0.5)
    assert run(dc_motor, 2.0, share, 1 - share) > 0


def test_braking_ends_a_motion_sooner_than_coasting() -> None:
    def until_it_stands(brake: float) -> int:
        dc_motor = Motor(spread=0.0)
        run(dc_motor, 2.0, 1.0)
        for ms in range(10_000):
            dc_motor.step(0.001, 7.0, 0.0, brake)
            if dc_motor.speed == 0:
                return ms
        raise AssertionError("the motor does not stop")

    assert until_it_stands(1.0) * 2 < until_it_stands(0.0)


def test_pwm_with_braking_makes_speed_proportional_to_duty() -> None:
    # And coasting in turn does not: half the duty is far more than half the speed.
    full = run(Motor(spread=0.0), 3.0, 1.0)
    half = run(Motor(spread=0.0), 3.0, 0.5, 0.5)
    assert 0.4 < half / full < 0.5
    assert run(Motor(spread=0.0), 3.0, 0.5) / full > 0.8


def test_a_stalled_motor_takes_the_most_current() -> None:
    dc_motor = Motor(spread=0.0)
    dc_motor.faults.add("stuck")
    run(dc_motor, 0.1, 1.0)
    assert dc_motor.speed == 0
    assert dc_motor.current == dc_motor.draw == pytest.approx(7.0 / motor.RESISTANCE)
    dc_motor.faults.clear()
    run(dc_motor, 3.0, 1.0)
    assert dc_motor.current < 0.4 * 7.0 / motor.RESISTANCE


def test_energy_is_conserved() -> None:
    dc_motor = Motor(seed=3)
    taken = heat = 0.0
    for ms in range(4000):
        drive = math.sin(ms / 300)
        dc_motor.step(0.001, 7.0, drive, 1 - abs(drive))
        taken += dc_motor.draw * 7.0 * 0.001
        heat += dc_motor.current**2 * dc_motor.resistance * 0.001
    assert taken > heat > 0


def test_the_faults_weak_and_open() -> None:
    sound = run(Motor(spread=0.0), 3.0, 0.3, 0.7)
    weak = Motor(spread=0.0)
    weak.faults.add("weak")
    assert 0 < run(weak, 3.0, 0.3, 0.7) < 0.9 * sound
    broken = Motor(spread=0.0)
    broken.faults.add("open")
    assert run(broken, 1.0, 1.0) == 0
    assert broken.current == 0


def test_motors_differ_by_their_seed_and_within_their_spread() -> None:
    motors = [Motor(seed, 0.15) for seed in range(300)]
    for value, nominal in (
        ([dc_motor.resistance for dc_motor in motors], motor.RESISTANCE),
        ([dc_motor.back_emf for dc_motor in motors], motor.BACK_EMF * motor.GEAR),
        ([dc_motor.coulomb for dc_motor in motors], motor.COULOMB),
    ):
        assert min(value) >= nominal * 0.85
        assert max(value) <= nominal * 1.15
        assert max(value) - min(value) > 0.25 * nominal
    assert vars(Motor(7)) == vars(Motor(7))
    with pytest.raises(ValueError, match=r"0 to 0\.15"):
        Motor(0, 0.5)
