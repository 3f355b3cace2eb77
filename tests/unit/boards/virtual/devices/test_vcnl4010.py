"""The VCNL4010 against its data sheet, and the door threshold."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from uros.boards.virtual.devices.vcnl4010 import Vcnl4010, proximity_counts
from uros.boards.virtual.hardware.clock import ManualClock
from uros.boards.virtual.hardware.i2c import I2CBus
from uros.boards.virtual.world.room import DOOR_CLOSED_MM, DOOR_OPEN_MM

DOOR = 10_000  # counts


class Bench:
    def __init__(self, scene=lambda t: (DOOR_CLOSED_MM, 78.0), noise=False):
        self.clock = ManualClock()
        self.bus = I2CBus(clock=self.clock)
        self.device = Vcnl4010(scene, noise=noise)
        self.bus.attach(self.device)

    def get(self, register, count=1):
        return int.from_bytes(self.bus.transfer(0x13, bytes((register,)), count), "big")

    def set(self, register, *data):
        self.bus.transfer(0x13, bytes((register, *data)), 0)

    def wait(self, us):
        self.clock.advance(us)


@pytest.fixture
def bench():
    return Bench()


def test_power_on(bench):
    assert bench.get(0x80) == 0x80
    assert bench.get(0x81) == 0x21
    assert bench.get(0x83) == 2
    assert bench.get(0x84) == 0x1D
    assert bench.get(0x85, 4) == 0


def test_both_on_demand(bench):
    bench.set(0x80, 0x18)
    assert bench.get(0x80) == 0x98
    bench.wait(1000)
    assert bench.get(0x80) == 0xB0  # proximity is ready first
    bench.wait(100_000)
    assert bench.get(0x80) == 0xE0
    assert bench.get(0x87, 2) == 13_100
    assert bench.get(0x80) == 0xC0
    assert bench.get(0x85, 2) == 312
    assert bench.get(0x80) == 0x80


def test_a_read_before_completion_returns_the_old_value():
    bench = Bench(lambda t: (3.0 if t < 1 else 400.0, 78.0 if t < 1 else 500.0))
    bench.set(0x80, 0x18)
    bench.wait(10**6)
    assert (bench.get(0x85, 2), bench.get(0x87, 2)) == (312, 13_100)
    bench.set(0x80, 0x18)
    assert bench.get(0x87, 2) == 13_100
    bench.wait(98_000)
    assert bench.get(0x80) & 0x40 == 0
    assert bench.get(0x85, 2) == 312
    bench.wait(2000)
    assert (bench.get(0x85, 2), bench.get(0x87, 2)) == (2000, 2102)


def test_continuous_conversion_is_faster(bench):
    bench.set(0x84, 0x9D)
    bench.set(0x80, 0x10)
    bench.wait(13_000)
    assert bench.get(0x80) & 0x40 == 0
    bench.wait(2000)
    assert bench.get(0x80) & 0x40


@pytest.mark.parametrize("lux, counts", [(0, 0), (0.25, 1), (16_383.75, 65535), (10**6, 65535)])
def test_a_quarter_lux_a_count(lux, counts):
    bench = Bench(lambda t: (10, lux))
    bench.set(0x80, 0x10)
    bench.wait(100_000)
    assert bench.get(0x85, 2) == counts


def test_the_pointer_increments(bench):
    bench.set(0x82, 3, 7)
    assert bench.bus.transfer(0x13, b"\x81", 4) == b"\x21\x03\x07\x1d"
    assert bench.bus.transfer(0x13, b"\x8f", 3) == b"\0\0\0"


def test_writes_to_read_only_registers_are_ignored(bench):
    bench.set(0x81, 0x55)
    bench.set(0x85, 1, 2, 3, 4)
    bench.set(0x20, 1)
    assert bench.get(0x81) == 0x21
    assert bench.get(0x85, 4) == 0


def measured(distance, current):
    bench = Bench(lambda t: (distance, 0))
    bench.set(0x83, current)
    bench.set(0x80, 0x08)
    bench.wait(1000)
    return bench.get(0x87, 2)


def test_the_door_at_the_default_current_and_at_200_mA():
    assert measured(DOOR_CLOSED_MM, 2) == 13_100 >= DOOR
    assert measured(DOOR_OPEN_MM, 2) == 2102 < DOOR / 4
    assert measured(DOOR_CLOSED_MM, 20) == 65_535
    assert measured(DOOR_OPEN_MM, 20) == 2117
    # A door that is ajar: open at 20 mA, and at 200 mA only with a higher threshold.
    assert measured(15, 2) == 3052 < DOOR
    assert DOOR < measured(15, 20) == 11_616 < 30_000


def test_the_current_is_limited_to_200_mA_and_none_measures_nothing():
    assert measured(10, 20) == measured(10, 63)
    assert measured(0, 0) == measured(400, 0) == 2100


@given(st.floats(-10, 1e4), st.floats(-10, 1e4), st.integers(0, 20))
def test_counts_rise_with_proximity_and_current(a, b, current):
    near, far = sorted((a, b))
    counts = proximity_counts(near, 10 * current)
    assert 2100 <= proximity_counts(far, 10 * current) <= counts <= 65535
    assert proximity_counts(near, 10 * current + 10) >= counts


def test_setting_the_rate_is_not_setting_the_current(bench):
    bench.set(0x82, 20)
    bench.set(0x80, 0x08)
    bench.wait(1000)
    assert bench.get(0x87, 2) == 13_100


def test_self_timed():
    bench = Bench(lambda t: (1000, 100 * t))
    bench.set(0x84, 0x7D)  # ten a second
    bench.set(0x80, 0x07)
    began = bench.clock.world_us() - 10
    bench.wait(100_000)
    assert bench.get(0x80) == 0xE7
    first = bench.get(0x85, 2)
    assert first == round(400 * (began + 100_000) / 1e6)
    bench.wait(50_000)
    assert bench.get(0x85, 2) == first
    bench.wait(1_000_000)
    assert bench.get(0x85, 2) == pytest.approx(first + 400, abs=1)
    bench.set(0x80, 0x00)
    last = bench.get(0x85, 2)
    bench.wait(10**6)
    assert bench.get(0x85, 2) == last


def test_proximity_rate():
    bench = Bench(lambda t: (1000 * t, 0))
    bench.set(0x82, 7)  # 250 a second
    bench.set(0x80, 0x03)
    bench.wait(1000)
    first = bench.get(0x87, 2)
    bench.wait(4000)
    assert bench.get(0x87, 2) < first


def test_interrupt_status(bench):
    bench.set(0x89, 0x0A)  # ready, and thresholds, of proximity
    bench.set(0x8A, 0x00, 0x10, 0x20, 0x00)
    bench.set(0x80, 0x08)
    bench.wait(1000)
    assert bench.get(0x8E) == 0x09
    bench.set(0x8E, 0x01)
    assert bench.get(0x8E) == 0x08


def test_noise_is_small_and_comes_from_the_seed():
    def series():
        bench = Bench(noise=True)
        out = []
        for _ in range(100):
            bench.set(0x80, 0x18)
            bench.wait(100_000)
            out.append((bench.get(0x85, 2), bench.get(0x87, 2)))
        return out

    first = series()
    assert first == series()
    assert len({light for light, _ in first}) > 2 and len({near for _, near in first}) > 10
    assert all(abs(light - 312) < 10 and near > 13_000 for light, near in first)


@given(
    st.lists(
        st.tuples(
            st.one_of(
                st.binary(max_size=6),
                st.tuples(st.integers(0x80, 0x8F), st.integers(0, 255)).map(bytes),
            ),
            st.integers(0, 20),
            st.integers(0, 200_000),
        ),
        max_size=20,
    ),
    st.floats(-1e9, 1e9),
    st.floats(-1e9, 1e9),
)
def test_any_bytes_sent(steps, distance, lux):
    bench = Bench(lambda t: (distance, lux), noise=True)
    for write, read, us in steps:
        assert len(bench.bus.transfer(0x13, write, read)) == read
        bench.wait(us)
    assert bench.get(0x81) == 0x21
