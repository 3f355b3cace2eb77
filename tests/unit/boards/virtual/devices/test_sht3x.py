"""The SHT3x against its data sheet."""

import errno

import pytest
from hypothesis import given
from hypothesis import strategies as st

from uros.boards.virtual.devices.sht3x import Sht3x, crc8
from uros.boards.virtual.hardware.clock import ManualClock
from uros.boards.virtual.hardware.i2c import BusError, I2CBus

AIR = (21.5, 0.40)


class Bench:
    def __init__(self, air=lambda t: AIR, noise=False):
        self.clock = ManualClock()
        self.bus = I2CBus(clock=self.clock)
        self.device = Sht3x(air, noise=noise)
        self.bus.attach(self.device)
        self.clock.advance(2000)

    def command(self, code, read=0):
        return self.bus.transfer(0x44, code.to_bytes(2, "big"), read)

    def read(self, count=6):
        return self.bus.transfer(0x44, b"", count)

    def wait(self, us):
        self.clock.advance(us)

    def status(self):
        self.wait(1000)
        data = self.command(0xF32D, 3)
        self.wait(1000)
        assert crc8(data[:2]) == data[2]
        return int.from_bytes(data[:2], "big")

    def refuses(self, code=None):
        with pytest.raises(BusError) as caught:
            self.read() if code is None else self.command(code)
        return caught.value.errno


@pytest.fixture
def bench():
    return Bench()


def values(data):
    assert crc8(data[:2]) == data[2] and crc8(data[3:5]) == data[5]
    raw = int.from_bytes(data[:2], "big"), int.from_bytes(data[3:5], "big")
    return -45 + 175 * raw[0] / 65535, raw[1] / 65535


@pytest.mark.parametrize("data, crc", [(b"\xbe\xef", 0x92), (b"\x00\x00", 0x81), (b"", 0xFF)])
def test_checksum(data, crc):
    assert crc8(data) == crc


@pytest.mark.parametrize(
    "celsius, humidity, expected",
    [
        (-45, 0, b"\x00\x00\x81\x00\x00\x81"),
        (130, 1, b"\xff\xff\xac\xff\xff\xac"),
        (-300, -1, b"\x00\x00\x81\x00\x00\x81"),
        (1000, 2, b"\xff\xff\xac\xff\xff\xac"),
    ],
)
def test_ends_of_the_range(celsius, humidity, expected):
    bench = Bench(lambda t: (celsius, humidity))
    assert bench.command(0x2C06, 6) == expected


def test_temperature_and_humidity_are_those_of_the_air(bench):
    celsius, humidity = values(bench.command(0x2C06, 6))
    assert celsius == pytest.approx(21.5, abs=0.002)
    assert humidity == pytest.approx(0.40, abs=1e-5)


@pytest.mark.parametrize("code, ms", [(0x2C06, 15), (0x2C0D, 6), (0x2C10, 4)])
def test_a_read_waits_for_the_measurement(bench, code, ms):
    bench.command(code)
    before = bench.clock.world_us()
    values(bench.read())
    took = bench.clock.world_us() - before
    wire = (10 + 6 * 9 + 1) * 10
    # It began with the command's last bit, just before its STOP.
    assert ms * 1000 + wire - 200 < took < ms * 1000 + wire


def test_a_read_20_ms_later_does_not_wait(bench):
    bench.command(0x2C06)
    bench.wait(20_000)
    before = bench.clock.world_us()
    values(bench.read())
    assert bench.clock.world_us() - before == 650


@pytest.mark.parametrize("code, ms", [(0x2400, 15), (0x240B, 6), (0x2416, 4)])
def test_without_stretching_an_early_read_is_refused(bench, code, ms):
    bench.command(code)
    assert bench.refuses() == errno.ENODEV
    bench.wait(ms * 1000 - 500)
    assert bench.refuses() == errno.ENODEV
    bench.wait(500)
    values(bench.read())


def test_a_result_is_read_once(bench):
    assert bench.refuses() == errno.ENODEV
    bench.command(0x2C06)
    bench.wait(20_000)
    bench.read(2)
    assert bench.refuses() == errno.ENODEV


def test_a_repeated_start_does_not_read_it_again(bench):
    bench.command(0x2C06)
    bench.wait(20_000)
    bench.bus.transfer(0x44, b"", 2, stop=False)
    assert bench.refuses() == errno.ENODEV


def test_beyond_the_result_the_line_is_idle(bench):
    assert bench.command(0x2C06, 9)[6:] == b"\xff\xff\xff"


def test_the_air_is_sampled_at_the_end_of_the_measurement():
    times = []
    bench = Bench(lambda t: times.append(t) or AIR)
    bench.command(0x2400)
    ends = bench.clock.world_us() - 10 + 15_000
    bench.wait(500_000)
    bench.read()
    assert times == [ends / 1e6]


def test_no_command_is_acknowledged_during_a_measurement(bench):
    bench.command(0x2400)
    bench.wait(10_000)
    assert bench.refuses(0x30A2) == errno.ENODEV
    bench.wait(5000)
    bench.command(0x30A2)


def test_a_millisecond_between_commands(bench):
    bench.command(0x3041)
    assert bench.refuses(0x3041) == errno.ENODEV
    bench.wait(1000)
    bench.command(0x3041)


def test_unknown_command(bench):
    assert bench.refuses(0x1234) == errno.EIO
    assert bench.status() & 0x0002
    assert not bench.status() & 0x0002


def test_a_third_byte_is_refused(bench):
    with pytest.raises(BusError) as caught:
        bench.bus.transfer(0x44, b"\x2c\x06\x00", 0)
    assert caught.value.errno == errno.EIO


def test_status_after_power_up_and_cleared(bench):
    assert bench.status() == 0x8010
    bench.command(0x3041)
    assert bench.status() == 0
    bench.command(0x30A2)
    assert bench.refuses(0x2400) == errno.ENODEV
    bench.wait(1500)
    assert bench.status() == 0x8010


def test_the_heater_warms(bench):
    bench.command(0x306D)
    assert bench.status() & 0x2000
    celsius, humidity = values(bench.command(0x2C06, 6))
    assert celsius == pytest.approx(24.5, abs=0.01)
    assert 0.30 < humidity < 0.36
    bench.wait(1000)
    bench.command(0x3066)
    assert not bench.status() & 0x2000
    assert values(bench.command(0x2C06, 6))[0] == pytest.approx(21.5, abs=0.01)


def test_periodic_mode():
    bench = Bench(lambda t: (20 + t, 0.5))
    bench.command(0x2737)  # ten a second
    bench.wait(1000)
    with pytest.raises(BusError):
        bench.command(0xE000, 6)  # not yet
    bench.wait(15_000)
    first = values(bench.command(0xE000, 6))[0]
    bench.wait(1000)
    with pytest.raises(BusError):
        bench.command(0xE000, 6)  # taken already
    bench.wait(250_000)
    third = values(bench.command(0xE000, 6))[0]
    assert third - first == pytest.approx(0.2, abs=0.005)
    bench.wait(1000)
    assert bench.refuses(0x2400) == errno.EIO  # only after a break
    bench.wait(1000)
    bench.command(0x3093)
    bench.wait(1000)
    assert bench.refuses(0xE000) == errno.EIO
    bench.wait(1000)
    values(bench.command(0x2C06, 6))


def test_noise_is_small_and_comes_from_the_seed():
    def series():
        bench = Bench(noise=True)
        out = []
        for _ in range(200):
            out.append(values(bench.command(0x2C06, 6)))
            bench.wait(1000)
        return out

    first = series()
    assert first == series()
    assert 0.005 < max(abs(t - 21.5) for t, _ in first) < 0.1
    assert len({t for t, _ in first}) > 5


def test_the_fault_crc(bench):
    bench.device.faults.add("crc")
    data = bench.command(0x2C06, 6)
    assert crc8(data[:2]) == data[2] ^ 0xFF and crc8(data[3:5]) == data[5] ^ 0xFF
    bench.device.faults.clear()
    bench.wait(1000)
    values(bench.command(0x2C06, 6))


@given(
    st.lists(
        st.tuples(
            st.one_of(
                st.binary(max_size=4),
                st.sampled_from((b"\x2c\x06", b"\x24\x00", b"\x27\x37", b"\xe0\x00", b"\x30\xa2")),
            ),
            st.integers(0, 8),
            st.integers(0, 30_000),
        ),
        max_size=20,
    )
)
def test_any_bytes_sent(steps):
    bench = Bench()
    for write, read, us in steps:
        try:
            bench.bus.transfer(0x44, write, read)
        except BusError as error:
            assert error.errno in (errno.ENODEV, errno.EIO)
        bench.wait(us)
    bench.wait(20_000)
    try:
        bench.command(0x3093)
    except BusError:
        pass
    bench.wait(2000)
    bench.command(0x30A2)
    bench.wait(2000)
    assert values(bench.command(0x2C06, 6))[0] == pytest.approx(21.5, abs=0.01)
