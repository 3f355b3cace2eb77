"""Drivers of sensors with the virtual sensors and all of their faults."""

import errno

import pytest

from uros.boards.virtual.devices.mcp9600 import Mcp9600
from uros.boards.virtual.devices.sht3x import Sht3x
from uros.boards.virtual.devices.vcnl4010 import LED_CURRENT, Vcnl4010
from uros.boards.virtual.hardware.clock import ManualClock
from uros.boards.virtual.hardware.i2c import FAULTS, I2CBus
from uros.drivers import SensorError
from uros.drivers.mcp9600 import MCP9600
from uros.drivers.sht3x import SHT3x
from uros.drivers.vcnl4010 import LUX_PER_COUNT, VCNL4010

AIR = (23.4, 0.45)
JUNCTIONS = (85.0, 24.1)
SCENE = (50.0, 312.0)


class Bench:
    """All three sensors on one bus, and their drivers; it is also the drivers' I2C."""

    def __init__(self):
        self.clock = ManualClock()
        self.bus = I2CBus(clock=self.clock)
        self.devices = {
            "sht3x": Sht3x(lambda t: AIR, noise=False),
            "mcp9600": Mcp9600(lambda t: JUNCTIONS, noise=False),
            "vcnl4010": Vcnl4010(lambda t: SCENE, noise=False),
        }
        for device in self.devices.values():
            self.bus.attach(device)
        self.sht3x = SHT3x(self)
        self.mcp9600 = MCP9600(self)
        self.vcnl4010 = VCNL4010(self)
        self.clock.advance(400_000)  # the MCP9600 has converted

    def writeto(self, address, buf):
        self.bus.transfer(address, bytes(buf), 0)

    def readfrom_into(self, address, buf):
        buf[:] = self.bus.transfer(address, b"", len(buf))

    def read(self, name):
        """Make one measurement of a sensor; return its values."""
        if name == "sht3x":
            self.sht3x.start()
            self.clock.advance(SHT3x.wait_ms * 1000)
            self.sht3x.read()
            return self.sht3x.temperature, self.sht3x.humidity
        if name == "mcp9600":
            return self.mcp9600.read_hot(), self.mcp9600.read_cold()
        self.vcnl4010.start()
        self.clock.advance(VCNL4010.wait_ms * 1000)
        assert self.vcnl4010.read()
        return self.vcnl4010.proximity, self.vcnl4010.ambient * LUX_PER_COUNT


EXPECTED = {
    "sht3x": pytest.approx(AIR, abs=0.002),
    "mcp9600": pytest.approx(JUNCTIONS, abs=0.05),
    # 2100 + 13750 * 200 mA / (50 mm + 2)²
    "vcnl4010": pytest.approx((3117, 312.0), abs=0.5),
}


@pytest.fixture
def bench():
    return Bench()


@pytest.mark.parametrize("name", EXPECTED)
def test_reading(bench, name):
    for _ in range(3):
        assert bench.read(name) == EXPECTED[name]
        bench.clock.advance(900_000)


def test_the_led_runs_at_200_ma_and_the_rate_is_left_alone(bench):
    bench.read("vcnl4010")
    assert bench.bus.transfer(0x13, bytes((LED_CURRENT - 1,)), 3) == bytes((0, 20, 0x9D))


@pytest.mark.parametrize(
    ("kind", "number"),
    [
        ("absent", errno.ENODEV),
        ("nack", errno.EIO),
        ("stretch", errno.ETIMEDOUT),
        ("stuck", errno.ETIMEDOUT),
    ],
)
@pytest.mark.parametrize("name", EXPECTED)
def test_sensors_recover_from_bus_faults(bench, name, kind, number):
    bench.read(name)
    bench.devices[name].faults.add(kind)
    for _ in range(3):
        with pytest.raises(OSError) as raised:
            bench.read(name)
        assert raised.value.args[0] == number
        bench.clock.advance(900_000)
    bench.devices[name].faults.clear()
    bench.clock.advance(1_000_000)
    assert bench.read(name) == EXPECTED[name]


def test_every_fault_of_the_sensors_is_tested():
    """The faults of single sensors have their own tests below."""
    assert set(FAULTS) == {"absent", "nack", "stretch", "stuck", "noise", "rubbish"}


def test_each_transfer_ends_in_time(bench):
    """On a held bus a call takes one timeout at most."""
    bench.devices["mcp9600"].faults.add("stuck")
    before = bench.clock.world_us()
    with pytest.raises(OSError):
        bench.read("mcp9600")
    assert bench.clock.world_us() - before <= 100_000


@pytest.mark.parametrize("fault", ["crc", "noise", "rubbish"])
def test_sht3x_never_returns_garbled_values(bench, fault):
    bench.devices["sht3x"].faults.add(fault)
    refused = 0
    for _ in range(200):
        try:
            values = bench.read("sht3x")
        except SensorError as error:
            refused += 1
            assert "CRC" in str(error) or "range" in str(error)
        else:
            # Random bytes have both checksums right once in 65536 times.
            assert values == EXPECTED["sht3x"]
        bench.clock.advance(5_000)
    assert refused > 100 or fault == "noise" and refused > 50
    bench.devices["sht3x"].faults.clear()
    assert bench.read("sht3x") == EXPECTED["sht3x"]


def test_garbled_mcp9600_values_stay_in_range(bench):
    """The sensor has no checksum; impossible values are refused."""
    bench.devices["mcp9600"].faults.add("rubbish")
    refused = 0
    for _ in range(200):
        try:
            hot, cold = bench.read("mcp9600")
        except SensorError:
            refused += 1
        else:
            assert -200 <= hot <= 1372 and -40 <= cold <= 125
    assert refused > 100


def test_mcp9600_with_a_broken_thermocouple(bench):
    bench.devices["mcp9600"].faults.add("open")
    bench.clock.advance(400_000)
    with pytest.raises(SensorError, match="broken"):
        bench.mcp9600.read_hot()
    assert bench.mcp9600.read_cold() == pytest.approx(JUNCTIONS[1], abs=0.05)
    bench.devices["mcp9600"].faults.clear()
    bench.clock.advance(400_000)
    assert bench.read("mcp9600") == EXPECTED["mcp9600"]


@pytest.mark.parametrize("fault", ["noise", "rubbish"])
def test_vcnl4010_with_garbled_settings_is_an_error(bench, fault):
    bench.devices["vcnl4010"].faults.add(fault)
    refused = 0
    for _ in range(100):
        try:
            bench.vcnl4010.start()
            bench.clock.advance(100_000)
            bench.vcnl4010.read()
        except SensorError:
            refused += 1
    assert refused > 20
    bench.devices["vcnl4010"].faults.clear()
    bench.clock.advance(1_000_000)
    assert bench.read("vcnl4010") == EXPECTED["vcnl4010"]


def test_vcnl4010_is_not_ready_at_once(bench):
    bench.vcnl4010.start()
    assert bench.vcnl4010.read() is False
    bench.clock.advance(2_000)  # the proximity is measured by now
    assert bench.vcnl4010.read() is False
    bench.clock.advance(98_000)
    assert bench.vcnl4010.read() is True


def test_a_replaced_vcnl4010_is_set_up(bench):
    bench.read("vcnl4010")
    bench.vcnl4010.start()
    bench.bus.detach(0x13)
    with pytest.raises(OSError):
        bench.vcnl4010.read()
    bench.bus.attach(Vcnl4010(lambda t: SCENE, noise=False))
    assert bench.read("vcnl4010") == EXPECTED["vcnl4010"]


def test_a_vcnl4010_replaced_between_two_transfers_is_detected(bench):
    """The replacement answers, but would measure with a tenth of the LED current."""
    bench.read("vcnl4010")
    bench.bus.detach(0x13)
    bench.bus.attach(Vcnl4010(lambda t: SCENE, noise=False))
    with pytest.raises(SensorError, match="lost its settings"):
        bench.read("vcnl4010")
    assert bench.read("vcnl4010") == EXPECTED["vcnl4010"]


def test_sensors_of_one_bus_do_not_disturb_each_other(bench):
    bench.devices["sht3x"].faults.add("absent")
    for _ in range(2):
        with pytest.raises(OSError):
            bench.read("sht3x")
        assert bench.read("mcp9600") == EXPECTED["mcp9600"]
        assert bench.read("vcnl4010") == EXPECTED["vcnl4010"]
