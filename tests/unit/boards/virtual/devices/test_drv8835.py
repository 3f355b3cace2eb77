"""The driver's truth table, and what PWM makes of it."""

import pytest

from uros.boards.virtual.devices.drv8835 import FULL, Drv8835


def made(*duties: int, frequency: int = 20_000) -> Drv8835:
    it = Drv8835()
    it.powered = True
    for channel, duty in enumerate(duties):
        it.set_duty(channel, duty, frequency)
    return it


@pytest.mark.parametrize(
    ("first", "second", "drives", "brakes"),
    # The table of the datasheet, IN/IN mode.
    [(0, 0, 0, 0), (0, FULL, -1, 0), (FULL, 0, 1, 0), (FULL, FULL, 0, 1)],
)
def test_the_truth_table(first: int, second: int, drives: float, brakes: float) -> None:
    assert made(first, second, 0, 0).bridge(0) == (drives, brakes)
    assert made(0, 0, first, second).bridge(1) == (drives, brakes)
    assert made(first, second, 0, 0).bridge(1) == (0, 0)


def test_pwm_on_one_input_drives_and_coasts_or_drives_and_brakes() -> None:
    quarter = FULL // 4
    assert made(quarter, 0, 0, 0).bridge(0) == pytest.approx((0.25, 0), abs=1e-4)
    assert made(FULL, FULL - quarter, 0, 0).bridge(0) == pytest.approx((0.25, 0.75), abs=1e-4)
    assert made(FULL - quarter, FULL, 0, 0).bridge(0) == pytest.approx((-0.25, 0.75), abs=1e-4)


def test_without_power_overheated_or_dead_it_coasts() -> None:
    it = made(FULL, 0, 0, FULL)
    it.powered = False
    assert it.bridge(0) == it.bridge(1) == (0, 0)
    it.powered = True
    it.faults.add("dead_a")
    assert it.bridge(0) == (0, 0)
    assert it.bridge(1) == (-1, 0)
    it.faults.add("overheated")
    assert it.bridge(1) == (0, 0)
    it.faults.clear()
    assert it.bridge(0) == (1, 0)
    it.off()
    assert not it.powered


def test_inputs_faster_than_the_datasheet_allows_do_nothing() -> None:
    assert made(FULL // 2, 0, 0, 0, frequency=250_000).bridge(0)[0] > 0
    assert made(FULL // 2, 0, 0, 0, frequency=250_001).bridge(0) == (0, 0)
    assert made(FULL, 0, 0, 0, frequency=300_000).bridge(0) == (1, 0)


def test_wrong_inputs_are_refused() -> None:
    it = Drv8835()
    with pytest.raises(ValueError, match="0 to 3"):
        it.set_duty(4, 0)
    for duty in (-1, FULL + 1):
        with pytest.raises(ValueError, match="a duty is"):
            it.set_duty(0, duty)
