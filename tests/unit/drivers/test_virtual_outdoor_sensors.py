"""Drivers of outdoor sensors with the virtual sensors and all of their faults."""

import errno
import math

import pytest

from uros.boards.virtual.devices.bh1750 import Bh1750
from uros.boards.virtual.devices.lis3mdl import Lis3mdl
from uros.boards.virtual.devices.max17048 import Max17048
from uros.boards.virtual.devices.mpu6050 import Mpu6050
from uros.boards.virtual.devices.tfluna import TfLuna
from uros.boards.virtual.hardware.clock import ManualClock
from uros.boards.virtual.hardware.i2c import FAULTS, I2CBus
from uros.drivers import SensorError
from uros.drivers.bh1750 import BH1750
from uros.drivers.lis3mdl import LIS3MDL
from uros.drivers.max17048 import MAX17048
from uros.drivers.mpu6050 import MPU6050
from uros.drivers.tfluna import TFLuna

MOTION = (1.5, -2.0, 9.3, 0.25, -0.5, 1.0)
FIELD = (21e-6, -12e-6, -38e-6)
LUX = 8_000.0
CELL = (3.87, 0.6)
TARGET = (2.34, 0.8)


class World:
    """The measured quantities; a test may change them."""

    def __init__(self):
        self.motion, self.field, self.lux = MOTION, FIELD, LUX
        self.cell, self.target = CELL, TARGET


class Bench:
    """All five sensors on one bus, and their drivers; it is also the drivers' I2C."""

    def __init__(self, noise=True, seed=1):
        self.clock = ManualClock()
        self.bus = I2CBus(frequency=400_000, clock=self.clock, seed=seed)
        self.world = world = World()
        self.devices = {
            "mpu6050": Mpu6050(lambda t: world.motion, seed=seed, noise=noise),
            "lis3mdl": Lis3mdl(lambda t: world.field, seed=seed, noise=noise),
            "bh1750": Bh1750(lambda t: world.lux, seed=seed, noise=noise),
            "max17048": Max17048(lambda t: world.cell, seed=seed, noise=noise),
            "tfluna": TfLuna(lambda t: world.target, seed=seed, noise=noise),
        }
        for device in self.devices.values():
            self.bus.attach(device)
        self.drivers = {
            "mpu6050": MPU6050(self),
            "lis3mdl": LIS3MDL(self),
            "bh1750": BH1750(self),
            "max17048": MAX17048(self),
            "tfluna": TFLuna(self),
        }
        self.clock.advance(2_000_000)

    def writeto(self, address, buf):
        self.bus.transfer(address, bytes(buf), 0)

    def readfrom_into(self, address, buf):
        buf[:] = self.bus.transfer(address, b"", len(buf))

    def read(self, name):
        """Make one measurement; return its values. The driver is called as by a program."""
        driver = self.drivers[name]
        for _ in range(20):
            if hasattr(driver, "start"):
                driver.start()
                self.clock.advance(driver.wait_ms * 1000)
            if driver.read() is not False:
                return self.values(name)
        raise AssertionError(f"{name} gives nothing")

    def values(self, name):
        driver = self.drivers[name]
        return {
            "mpu6050": lambda: (driver.ax, driver.ay, driver.az, driver.gx, driver.gy, driver.gz),
            "lis3mdl": lambda: (driver.x * 1e6, driver.y * 1e6, driver.z * 1e6),
            "bh1750": lambda: (driver.lux,),
            "max17048": lambda: (driver.volts, driver.fraction),
            "tfluna": lambda: (driver.range,),
        }[name]()


# Tolerances of the datasheets: offsets of IMU and magnetometer up to 3 sigma.
EXPECTED = {
    "mpu6050": pytest.approx(MOTION, abs=0.6),
    "lis3mdl": pytest.approx(tuple(component * 1e6 for component in FIELD), abs=4.0),
    "bh1750": pytest.approx((LUX,), rel=0.16),
    "max17048": pytest.approx(CELL, abs=0.01),
    "tfluna": pytest.approx((TARGET[0],), abs=0.05),
}
EXACT = {
    "mpu6050": pytest.approx(MOTION, abs=0.0005),
    "lis3mdl": pytest.approx(tuple(component * 1e6 for component in FIELD), abs=0.01),
    "bh1750": pytest.approx((LUX,), abs=1.0),
    "max17048": pytest.approx(CELL, abs=0.0001),
    "tfluna": pytest.approx((TARGET[0],), abs=0.001),
}


@pytest.fixture
def bench():
    return Bench()


@pytest.mark.parametrize("name", EXPECTED)
def test_reading(bench, name):
    for _ in range(20):
        assert bench.read(name) == EXPECTED[name]
        bench.clock.advance(300_000)


@pytest.mark.parametrize("name", EXACT)
def test_units_are_exact_without_noise(name):
    assert Bench(noise=False).read(name) == EXACT[name]


@pytest.mark.parametrize("name", EXPECTED)
def test_a_seed_is_the_same_sensor(name):
    first = [Bench(seed=3).read(name) for _ in range(2)]
    assert first[0] == first[1]
    if name != "tfluna":
        assert first[0] != Bench(seed=4).read(name)


def test_ranges_of_the_imu():
    for accel, gyro in ((4, 500), (8, 1000), (16, 2000)):
        bench = Bench(noise=False)
        bench.world.motion = (0, 0, 1.5 * 9.80665, 0, 0, 4.0 if gyro > 250 else 0)
        bench.drivers["mpu6050"] = MPU6050(bench, accel_g=accel, gyro_dps=gyro)
        assert bench.read("mpu6050") == pytest.approx((0, 0, 14.71, 0, 0, 4.0), abs=0.003)


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
def test_outdoor_sensors_recover_from_bus_faults(bench, name, kind, number):
    bench.read(name)
    bench.devices[name].fault(kind)
    for _ in range(3):
        with pytest.raises(OSError) as raised:
            bench.read(name)
        assert raised.value.args[0] == number
        bench.clock.advance(900_000)
    bench.devices[name].heal()
    bench.bus.recover()
    bench.clock.advance(1_000_000)
    assert bench.read(name) == EXPECTED[name]


@pytest.mark.parametrize("kind", ["noise", "rubbish"])
@pytest.mark.parametrize("name", EXPECTED)
def test_garbled_bytes_raise_declared_errors_only(bench, name, kind):
    """Without checksums only documented errors are raised, and values are in range."""
    bench.devices[name].fault(kind)
    for _ in range(100):
        try:
            values = bench.read(name)
        except SensorError:
            pass
        except AssertionError as error:
            assert "gives nothing" in str(error)
        else:
            assert not any(math.isnan(value) for value in values)
            if name == "max17048":
                assert 2 <= values[0] <= 5 and 0 <= values[1] <= 1
            elif name == "tfluna":
                assert math.isinf(values[0]) or 0.2 <= values[0] <= 8
        bench.clock.advance(20_000)
    bench.devices[name].heal()
    bench.clock.advance(1_000_000)
    assert settles(bench, name) == EXPECTED[name]


def settles(bench, name):
    """Return the first reading after a fault; up to three errors may precede it."""
    for _ in range(3):
        try:
            return bench.read(name)
        except SensorError:
            bench.clock.advance(100_000)
    return bench.read(name)


def fails(bench, name, reads=12):
    """Return the text of the error within ``reads`` readings."""
    for _ in range(reads):
        try:
            bench.read(name)
        except SensorError as error:
            return str(error)
        bench.clock.advance(100_000)
    raise AssertionError("it does not fail")


@pytest.mark.parametrize(
    ("name", "kind", "text"),
    [
        ("mpu6050", "frozen", "same values"),
        ("mpu6050", "saturated", "acceleration is out of range"),
        ("lis3mdl", "frozen", "same values"),
        ("lis3mdl", "saturated", "field is out of range"),
        ("bh1750", "saturated", "light is out of range"),
        ("max17048", "open", "0.04 V is no cell's"),
        ("tfluna", "frozen", "does not end"),
        ("tfluna", "sun", "blinded"),
    ],
)
def test_faults_of_a_sensor_are_reported_and_end(bench, name, kind, text):
    bench.read(name)
    before = bench.values(name)
    bench.devices[name].fault(kind)
    bench.clock.advance(300_000)
    assert text in fails(bench, name)
    if kind != "frozen":
        assert bench.values(name) == before
    bench.devices[name].heal()
    bench.clock.advance(1_000_000)
    assert settles(bench, name) == EXPECTED[name]


@pytest.mark.parametrize("name", ["mpu6050", "lis3mdl"])
def test_a_frozen_sensor_fails_until_its_values_change(bench, name):
    """The driver sets the sensor up again after each error, without effect."""
    bench.read(name)
    bench.devices[name].fault("frozen")
    assert "same values" in fails(bench, name)
    for _ in range(20):
        bench.clock.advance(100_000)
        with pytest.raises(SensorError, match="same values"):
            bench.read(name)
    bench.devices[name].heal()
    assert settles(bench, name) == EXPECTED[name]


def test_every_fault_of_outdoor_sensors_is_tested():
    tried = {
        "mpu6050": {"asleep", "frozen", "saturated", "selftest"},
        "lis3mdl": {"asleep", "frozen", "saturated"},
        "bh1750": {"frozen", "saturated"},
        "max17048": {"open", "frozen", "low"},
        "tfluna": {"frozen", "dirty", "sun"},
    }
    for name, device in Bench().devices.items():
        assert set(device.FAULTS) - set(FAULTS) == tried[name]
        assert all(device.FAULTS.values())


@pytest.mark.parametrize("name", ["mpu6050", "lis3mdl"])
def test_a_sensor_that_lost_its_settings_is_set_up_again(bench, name):
    bench.read(name)
    bench.devices[name].fault("asleep")
    assert not bench.devices[name].faults
    driver = bench.drivers[name]
    for _ in range(7):
        bench.clock.advance(100_000)
        assert driver.read() is False
    with pytest.raises(SensorError, match="no new values"):
        driver.read()
    assert bench.read(name) == EXPECTED[name]


@pytest.mark.parametrize("name", EXPECTED)
def test_a_replaced_sensor_is_set_up(name):
    bench, spare = Bench(), Bench(seed=1)
    bench.read(name)
    address = bench.devices[name].address
    bench.bus.detach(address)
    with pytest.raises(OSError):
        bench.read(name)
    device = spare.devices[name]
    spare.bus.detach(address)
    bench.bus.attach(device)
    bench.clock.advance(1_500_000)
    assert bench.read(name) == EXPECTED[name]


def test_a_frozen_gauge_or_light_cannot_be_told_from_a_steady_one(bench):
    """These sensors have no flag for new values: the driver returns the old ones."""
    for name in ("max17048", "bh1750"):
        before = bench.read(name)
        bench.devices[name].fault("frozen")
        bench.world.cell, bench.world.lux = (3.5, 0.1), 5.0
        bench.clock.advance(1_000_000)
        assert bench.read(name) == before


def test_a_low_cell(bench):
    bench.devices["max17048"].fault("low")
    assert bench.read("max17048") == pytest.approx((3.2, 0.03), abs=0.01)


def test_rate_of_the_cell():
    bench = Bench(noise=False)
    bench.devices["max17048"]._cell = lambda t: (3.87, 0.6 - t / 7200)
    bench.clock.advance(100_000_000)
    bench.read("max17048")
    assert bench.drivers["max17048"].rate == pytest.approx(-0.5, abs=0.002)


def test_ranges_without_a_target(bench):
    for target, wanted in (
        ((math.inf, 0.0), math.inf),
        ((9.5, 0.9), math.inf),
        ((6.0, 0.02), math.inf),  # something black
        ((0.05, 0.8), -math.inf),
        ((0.3, 0.8), pytest.approx(0.3, abs=0.05)),
        ((7.5, 0.9), pytest.approx(7.5, abs=0.05)),
    ):
        bench.world.target = target
        assert bench.read("tfluna") == (wanted,)
    bench.world.target = TARGET
    bench.devices["tfluna"].fault("dirty")
    assert bench.read("tfluna") == (math.inf,)


def test_sunlight_is_within_range(bench):
    bench.world.lux = 100_000.0
    assert bench.read("bh1750") == pytest.approx((100_000.0,), rel=0.16)
    bench.world.lux = 0.0
    assert bench.read("bh1750") == pytest.approx((0.0,), abs=4)


def test_self_test(bench):
    bench.world.motion = (0, 0, 9.80665, 0, 0, 0)
    driver = bench.drivers["mpu6050"]

    def run():
        for _ in range(3):
            if driver.self_test():
                return
            bench.clock.advance(50_000)

    bench.read("mpu6050")
    run()
    assert bench.read("mpu6050") == pytest.approx((0, 0, 9.80665, 0, 0, 0), abs=0.6)
    bench.devices["mpu6050"].fault("selftest")
    with pytest.raises(SensorError, match="self-test is wrong: az$"):
        run()
    bench.devices["mpu6050"].heal()
    run()
    assert bench.read("mpu6050") == pytest.approx((0, 0, 9.80665, 0, 0, 0), abs=0.6)


def test_each_call_returns_soon(bench):
    """Each call takes less than 1 ms at 400 kHz; the longest one sets up the IMU."""
    for name, driver in bench.drivers.items():
        for call in (getattr(driver, "start", driver.read), driver.read):
            before = bench.clock.world_us()
            call()
            assert bench.clock.world_us() - before < 1000, name


def test_reading_allocates_no_buffers(bench):
    driver = bench.drivers["mpu6050"]
    bench.read("mpu6050")
    buffers = {id(driver._buf), id(driver._last)}
    for _ in range(5):
        bench.read("mpu6050")
        assert {id(driver._buf), id(driver._last)} == buffers
