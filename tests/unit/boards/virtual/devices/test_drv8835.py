"""The driver's truth table, and its outputs with PWM."""

import pytest

from uros.boards.virtual.devices.drv8835 import FULL, Drv8835


def driver_at(*duties: int, frequency: int = 20_000) -> Drv8835:
    driver = Drv8835()
    driver.powered = True
    for channel, duty in enumerate(duties):
        driver.set_duty(channel, duty, frequency)
    return driver


@pytest.mark.parametrize(
    ("first", "second", "drives", "brakes"),
    # The table of the datasheet, IN/IN mode.
    [(0, 0, 0, 0), (0, FULL, -1, 0), (FULL, 0, 1, 0), (FULL, FULL, 0, 1)],
)
def test_the_truth_table(first: int, second: int, drives: float, brakes: float) -> None:
    assert driver_at(first, second, 0, 0).bridge(0) == (drives, brakes)
    assert driver_at(0, 0, first, second).bridge(1) == (drives, brakes)
    assert driver_at(first, second, 0, 0).bridge(1) == (0, 0)


def test_pwm_on_one_input_drives_and_coasts_or_drives_and_brakes() -> None:
    quarter = FULL // 4
    assert driver_at(quarter, 0, 0, 0).bridge(0) == pytest.approx((0.25, 0), abs=1e-4)
    assert driver_at(FULL, FULL - quarter, 0, 0).bridge(0) == pytest.approx((0.25, 0.75), abs=1e-4)
    assert driver_at(FULL - quarter, FULL, 0, 0).bridge(0) == pytest.approx((-0.25, 0.75), abs=1e-4)


def test_without_power_overheated_or_dead_it_coasts() -> None:
    driver = driver_at(FULL, 0, 0, FULL)
    driver.powered = False
    assert driver.bridge(0) == driver.bridge(1) == (0, 0)
    driver.powered = True
    driver.faults.add("dead_a")
    assert driver.bridge(0) == (0, 0)
    assert driver.bridge(1) == (-1, 0)
    driver.faults.add("overheated")
    assert driver.bridge(1) == (0, 0)
    driver.faults.clear()
    assert driver.bridge(0) == (1, 0)
    driver.off()
    assert not driver.powered


def test_inputs_above_the_frequency_limit_count_as_low() -> None:
    assert driver_at(FULL // 2, 0, 0, 0, frequency=250_000).bridge(0)[0] > 0
    assert driver_at(FULL // 2, 0, 0, 0, frequency=250_001).bridge(0) == (0, 0)
    assert driver_at(FULL, 0, 0, 0, frequency=300_000).bridge(0) == (1, 0)


def test_invalid_inputs_are_refused() -> None:
    driver = Drv8835()
    with pytest.raises(ValueError, match="0 to 3"):
        driver.set_duty(4, 0)
    for duty in (-1, FULL + 1):
        with pytest.raises(ValueError, match="a duty is"):
            driver.set_duty(0, duty)
