"""The MCP9600 against its data sheet."""

import errno

import pytest
from hypothesis import given
from hypothesis import strategies as st

from uros.boards.virtual.devices.mcp9600 import Mcp9600
from uros.boards.virtual.hardware.clock import ManualClock
from uros.boards.virtual.hardware.i2c import BusError, I2CBus

CONVERSION = 320_000


class Bench:
    def __init__(self, junctions=lambda t: (61.3, 22.1), noise=False):
        self.clock = ManualClock()
        self.bus = I2CBus(clock=self.clock)
        self.device = Mcp9600(junctions, noise=noise)
        self.bus.attach(self.device)
        self.clock.advance(CONVERSION)

    def get(self, register, count=2):
        return self.bus.transfer(0x67, bytes((register,)), count)

    def celsius(self, register):
        return int.from_bytes(self.get(register), "big", signed=True) * 0.0625

    def set(self, register, *data):
        self.bus.transfer(0x67, bytes((register, *data)), 0)


@pytest.fixture
def bench():
    return Bench()


def test_temperatures(bench):
    assert bench.celsius(0x00) == 61.3125
    assert bench.celsius(0x02) == 22.125
    assert bench.celsius(0x01) == 61.3125 - 22.125


@pytest.mark.parametrize(
    "celsius, data",
    [(0.0, b"\x00\x00"), (0.0625, b"\x00\x01"), (-0.0625, b"\xff\xff"), (1000.0, b"\x3e\x80")],
)
def test_the_values_of_the_data_sheet(celsius, data):
    assert Bench(lambda t: (celsius, celsius)).get(0x00) == data


def test_pointer_and_read_in_two_transfers(bench):
    bench.set(0x02)
    assert bench.bus.transfer(0x67, b"", 2) == bench.bus.transfer(0x67, b"", 2) == b"\x01\x62"


def test_before_the_first_conversion_registers_are_zero():
    bench = Bench()
    bench.device._began = bench.clock.world_us()
    assert bench.get(0x00) == b"\0\0"
    bench.clock.advance(CONVERSION)
    assert bench.celsius(0x00) == 61.3125


def test_a_value_stays_for_a_conversion():
    bench = Bench(lambda t: (100 * t, 20))
    assert bench.celsius(0x00) == 32.0
    bench.clock.advance(CONVERSION - 2000)
    assert bench.celsius(0x00) == 32.0
    bench.clock.advance(2000)
    assert bench.celsius(0x00) == 64.0
    bench.clock.advance(10 * CONVERSION)
    assert bench.celsius(0x00) == 12 * 32.0


def test_reads_stretch_the_clock(bench):
    before = bench.clock.world_us()
    bench.get(0x00)
    assert bench.clock.world_us() - before == (10 + 9 + 10 + 18 + 1) * 10 + 60


def test_identity_and_octets_beyond_a_register(bench):
    assert bench.get(0x20, 4) == b"\x40\x14\xff\xff"
    assert bench.get(0x77, 2) == b"\xff\xff"


def test_the_cold_junction_can_be_coarser(bench):
    bench.set(0x06, 0x80)
    bench.clock.advance(CONVERSION)
    assert bench.celsius(0x02) == 22.0
    assert bench.celsius(0x00) == 61.3125


def test_fewer_bits_convert_faster():
    bench = Bench(lambda t: (100 * t, 0))
    bench.set(0x06, 0x60)
    first = bench.celsius(0x00)
    bench.clock.advance(10_000)
    assert bench.celsius(0x00) > first


def test_raw_microvolts(bench):
    raw = int.from_bytes(bench.get(0x03, 3), "big", signed=True)
    assert raw * 2e-6 == pytest.approx(39.2 * 40.6e-6, rel=0.01)
    bench.set(0x06, 0x60)  # 12 bits
    bench.clock.advance(5000)
    assert int.from_bytes(bench.get(0x03, 3), "big") % 64 == 0


def test_the_update_bit_of_status(bench):
    assert bench.get(0x04, 1) == b"\xc0"
    bench.set(0x04, 0x00)
    assert bench.get(0x04, 1) == b"\x00"
    bench.clock.advance(CONVERSION)
    assert bench.get(0x04, 1) == b"\xc0"


def test_shutdown(bench):
    bench.get(0x00)
    bench.set(0x06, 0x01)
    bench.set(0x04, 0x00)
    bench.clock.advance(10 * CONVERSION)
    assert bench.get(0x04, 1) == b"\x00"
    bench.set(0x06, 0x00)
    bench.clock.advance(CONVERSION)
    assert bench.get(0x04, 1) == b"\xc0"


@pytest.mark.parametrize("hot, expected, flag", [(1400, 1372, 1), (-250, -200, 1), (1372, 1372, 0)])
def test_out_of_range(hot, expected, flag):
    bench = Bench(lambda t: (hot, 20))
    assert bench.celsius(0x00) == expected
    assert bench.get(0x04, 1)[0] >> 4 & 1 == flag


def test_the_range_is_that_of_the_type():
    bench = Bench(lambda t: (500, 20))
    bench.set(0x05, 0x20)  # T
    bench.clock.advance(CONVERSION)
    assert bench.celsius(0x00) == 400


def test_a_broken_thermocouple(bench):
    bench.device.faults.add("open")
    bench.clock.advance(CONVERSION)
    assert bench.celsius(0x00) == 1372
    assert bench.get(0x04, 1) == b"\xd0"
    bench.set(0x04, 0x00)  # clears the update bit only
    assert bench.get(0x04, 1) == b"\x10"
    bench.device.faults.clear()
    bench.clock.advance(CONVERSION)
    assert bench.celsius(0x00) == 61.3125
    assert bench.get(0x04, 1) == b"\xc0"


@pytest.mark.parametrize("register", [0x00, 0x01, 0x02, 0x03, 0x20, 0x77])
def test_read_only_registers_refuse_writes(bench, register):
    with pytest.raises(BusError) as caught:
        bench.set(register, 1)
    assert caught.value.errno == errno.EIO


def test_alert_registers_keep_what_is_written(bench):
    bench.set(0x10, 0x12, 0x34)
    assert bench.get(0x10) == b"\x12\x34"


def test_noise_is_small():
    bench = Bench(noise=True)
    readings = set()
    for _ in range(100):
        readings.add(bench.celsius(0x00))
        bench.clock.advance(CONVERSION)
    assert len(readings) > 3
    assert all(abs(celsius - 61.3) < 0.4 for celsius in readings)


@given(
    st.lists(
        st.tuples(st.binary(max_size=5), st.integers(0, 6), st.integers(0, CONVERSION)),
        max_size=20,
    ),
    st.floats(-1e6, 1e6),
    st.floats(-1e6, 1e6),
)
def test_any_bytes_sent(steps, hot, cold):
    bench = Bench(lambda t: (hot, cold))
    for write, read, us in steps:
        try:
            assert len(bench.bus.transfer(0x67, write, read)) == read
        except BusError as error:
            assert error.errno == errno.EIO
        bench.clock.advance(us)
    assert bench.get(0x20) == b"\x40\x14"
