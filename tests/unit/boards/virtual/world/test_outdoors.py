"""The place outdoors: plausible and continuous quantities, reproducible from the seed."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from uros.boards.virtual.world.outdoors import (
    DAY,
    EPOCH,
    RADIUS,
    SPEED,
    G,
    Outdoors,
    dipole,
    rest_voltage,
)

times = st.floats(0, 100 * DAY)
seeds = st.integers(-1000, 1000)


@given(times, seeds)
def test_quantities_are_plausible(t, seed):
    world = Outdoors(seed)
    place = world.place(t)
    assert -35 < place.latitude < 65 and -180 <= place.longitude < 180
    assert 0 <= place.course < 360
    motion = world.motion(t)
    assert abs(motion[2] - G) < 0.5 and motion[5] == SPEED / RADIUS
    # The earth has 22 to 67 µT.
    assert 22e-6 < math.hypot(*world.field(t)) < 67e-6
    assert 0 <= world.light(t) <= 100_000
    assert 5 < world.temperature(t) < 30 and 0.05 <= world.humidity(t) <= 0.98
    metres, reflects = world.target(t)
    assert metres > 0.3 and (metres <= 7.01 or metres == math.inf) and 0 <= reflects <= 1
    volts, full = world.cell(t)
    assert 3.1 < volts < 4.2 and 0 <= full <= 0.9


@given(times, seeds)
def test_the_walk_is_consistent(t, seed):
    """Position, speed and course agree with each other, by finite differences."""
    world = Outdoors(seed)
    (x0, y0), (x1, y1) = world.offset(t - 0.01), world.offset(t + 0.01)
    assert math.hypot(x1 - x0, y1 - y0) / 0.02 == pytest.approx(SPEED, rel=1e-3)
    heading = math.atan2(y1 - y0, x1 - x0)
    assert math.cos(heading - world.heading(t)) == pytest.approx(1, abs=1e-6)
    assert math.cos(math.radians(90 - world.place(t).course) - heading) > 1 - 1e-6
    turned = world.heading(t + 1) - world.heading(t)
    assert math.sin(turned) == pytest.approx(math.sin(SPEED / RADIUS), rel=1e-6)


def test_degrees_are_metres():
    """Metres per degree of WGS 84 at 35 and at 53 degrees, from tables."""
    for latitude, north, east in ((35.43, 110_950, 90_815), (53.46, 111_275, 66_401)):
        world = next(
            candidate
            for seed in range(99)
            if abs((candidate := Outdoors(seed)).latitude - latitude) < 0.01
        )
        assert world.metres[0] == pytest.approx(north, rel=1e-3)
        assert world.metres[1] == pytest.approx(east, rel=1e-3)


def test_the_compass_points_north_when_it_heads_north():
    world = Outdoors(5)
    t = ((math.pi / 2 - world.heading(0)) % (2 * math.pi)) / (SPEED / RADIUS)
    east, north, up = dipole(world.latitude, world.longitude)
    x, y, z = world.field(t)
    assert (x, y, z) == pytest.approx((north, -east, up), abs=1e-9)
    assert north > 0


def test_the_dipole_of_known_places():
    """The field of a dipole is right to some tenths.

    Berlin has 49.5 µT with a dip of 68 degrees; Singapore 42 µT, nearly horizontal.
    """
    for where, total, dip in (((52.5, 13.4), 49.5e-6, 68), ((1.3, 103.8), 42e-6, -13)):
        east, north, up = dipole(*where)
        assert math.hypot(east, north, up) == pytest.approx(total, rel=0.3)
        computed_dip = math.degrees(math.atan2(-up, math.hypot(east, north)))
        assert computed_dip == pytest.approx(dip, abs=10)


def test_day_and_night():
    assert Outdoors(1, 12).light(0) > 50_000
    assert Outdoors(1, 12).light(DAY / 2) < 1
    assert Outdoors(1, 0).light(0) < 1
    # With an epoch, the light follows the sun at the place.
    world = Outdoors(1, epoch=EPOCH)
    noon = (12 * 3600 - world.longitude * 240) % DAY
    assert world.sun(noon) == pytest.approx(math.sin(math.pi * 6 / 14))
    assert world.epoch == EPOCH


def test_the_battery_runs_down():
    world = Outdoors()
    cells = [world.cell(60.0 * minute) for minute in range(600)]
    assert all(a[0] >= b[0] and a[1] >= b[1] for a, b in zip(cells, cells[1:], strict=False))
    assert cells[-1][1] == 0
    assert (rest_voltage(-1), rest_voltage(0.5), rest_voltage(2)) == (
        3.2,
        pytest.approx(3.815),
        4.2,
    )


def test_the_same_seed_is_the_same_place():
    def look(world):
        return [
            (world.place(t), world.motion(t), world.field(t), world.light(t)) for t in range(60)
        ]

    assert look(Outdoors(3)) == look(Outdoors(3))
    assert look(Outdoors(3)) != look(Outdoors(4))
