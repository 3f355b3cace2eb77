"""The room: plausible and continuous quantities, reproducible from the seed."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from uros.boards.virtual.world.room import DAY, DOOR_CLOSED_MM, DOOR_INTERVAL, DOOR_OPEN_MM, Room

times = st.floats(0, 100 * DAY)


@given(times, st.integers(-5, 5), st.floats(0, 24))
def test_quantities_are_plausible(t, seed, hour):
    room = Room(seed, hour)
    assert 18 < room.temperature(t) < 25
    assert 0.3 < room.humidity(t) < 0.6
    assert 0 <= room.daylight(t) < 800
    assert 0 <= room.door(t) <= 1
    assert DOOR_CLOSED_MM <= room.door_mm(t) <= DOOR_OPEN_MM
    assert 28 < room.hot(t) < 95
    assert room.cold(t) - room.temperature(t) == pytest.approx(1.2)
    assert room.air(t) == (room.temperature(t), room.humidity(t))
    assert room.junctions(t) == (room.hot(t), room.cold(t))
    assert room.scene(t) == (room.door_mm(t), room.daylight(t))


@given(times)
def test_quantities_are_continuous(t):
    room = Room(1)
    later = t + 0.01
    # The lamp is switched, and the door is fast.
    assert abs(room.temperature(later) - room.temperature(t)) < 0.01
    assert abs(room.humidity(later) - room.humidity(t)) < 0.001
    assert abs(room.hot(later) - room.hot(t)) < 0.1
    assert abs(room.door_mm(later) - room.door_mm(t)) < 10


def test_the_same_seed_is_the_same_room():
    def look(room):
        return [(room.air(t), room.junctions(t), room.scene(t)) for t in range(0, 600, 7)]

    assert look(Room(3)) == look(Room(3))
    assert look(Room(3)) != look(Room(4))


def test_the_door_opens_once_in_each_interval_and_closes():
    room = Room()
    for interval in range(50):
        levels = [room.door(interval * DOOR_INTERVAL + s / 4) for s in range(4 * 60)]
        assert levels[0] == levels[-1] == 0
        wide_open = sum(level == 1 for level in levels) / 4
        assert 7 < wide_open < 21
        moving = sum(0 < level < 1 for level in levels) / 4
        assert 1 < moving <= 2


def test_the_room_warms_up():
    room = Room(start_hour=9)
    assert room.temperature(3600) - room.temperature(0) > 1.5


def test_the_open_door_cools():
    room = Room(start_hour=0)
    for n in range(20, 40):
        begins, ends = room._visit(n)
        before, after = room._door_loss(begins), room._door_loss(ends)
        assert after - before > 0.02
        assert room._door_loss(ends + 20) < after or room._visit(n + 1)[0] < ends + 20


def test_it_is_cooler_after_an_opening_on_average():
    room = Room(start_hour=0)
    visits = [room._visit(n) for n in range(60, 160)]  # whole periods of the thermostat
    changes = [room.temperature(ends) - room.temperature(begins) for begins, ends in visits]
    assert -0.2 < sum(changes) / len(changes) < -0.04


def test_daylight_goes_with_the_hour():
    def light(hour):
        return Room(start_hour=hour).daylight(0)

    assert light(12) > 300
    assert light(8) < light(12)
    assert light(3) < 1
    assert 100 < light(21) < 200  # the lamp
    assert Room(start_hour=0).daylight(12 * 3600) > 300


def test_the_hotplate_is_switched_on_and_off():
    room = Room()
    hot = [room.hot(7200 + t) for t in range(240)]
    assert max(hot) > 80 and min(hot) < 40
    assert 85 <= hot.index(max(hot)) <= 95
