"""The outdoor sensors against their data sheets, and any bytes sent to them."""

import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from support.examples import examples

from uros.boards.virtual.devices.bh1750 import Bh1750
from uros.boards.virtual.devices.lis3mdl import Lis3mdl
from uros.boards.virtual.devices.max17048 import Max17048
from uros.boards.virtual.devices.mpu6050 import Mpu6050, accel_trim, gyro_trim
from uros.boards.virtual.devices.tfluna import TfLuna
from uros.boards.virtual.hardware.clock import ManualClock
from uros.boards.virtual.hardware.i2c import BusError, I2CBus

MAKERS = {
    "mpu6050": (0x68, lambda v, noise: Mpu6050(lambda t: (v,) * 6, lambda t: v, noise=noise)),
    "lis3mdl": (0x1C, lambda v, noise: Lis3mdl(lambda t: (v,) * 3, lambda t: v, noise=noise)),
    "bh1750": (0x23, lambda v, noise: Bh1750(lambda t: v, noise=noise)),
    "max17048": (0x36, lambda v, noise: Max17048(lambda t: (v, v), noise=noise)),
    "tfluna": (0x10, lambda v, noise: TfLuna(lambda t: (v, 0.5), lambda t: v, noise=noise)),
}


class Bench:
    def __init__(self, device):
        self.clock = ManualClock()
        self.bus = I2CBus(frequency=400_000, clock=self.clock)
        self.bus.attach(device)
        self.address = device.address

    def get(self, register, count=1):
        return self.bus.transfer(self.address, bytes((register,)), count)

    def set(self, register, *data):
        self.bus.transfer(self.address, bytes((register, *data)), 0)

    def wait(self, us):
        self.clock.advance(us)


def int16(data, order="big"):
    return int.from_bytes(data, order, signed=True)


# --- MPU-6050 ---------------------------------------------------------------------------------


def imu(motion=(0, 0, 9.80665, 0, 0, 0)):
    return Bench(Mpu6050(lambda t: motion, lambda t: 34.53, noise=False))


def test_mpu6050_sleeps_after_power_on():
    bench = imu()
    bench.wait(10**6)
    assert bench.get(0x75) == b"\x68"
    assert bench.get(0x6B) == b"\x40"
    assert bench.get(0x3A, 15) == bytes(15)


def test_mpu6050_samples():
    bench = imu()
    bench.set(0x38, 1)
    bench.set(0x6B, 0)
    bench.set(0x19, 9, 3, 0, 0)
    assert bench.get(0x3A) == b"\0"
    bench.wait(9_000)
    assert bench.get(0x3A) == b"\0"
    bench.wait(1_000)
    assert bench.get(0x3A) == b"\1"
    assert bench.get(0x3A) == b"\0"  # reading has cleared it
    assert int16(bench.get(0x3F, 2)) == 16384
    assert int16(bench.get(0x41, 2)) == 0  # 36.53 °C
    bench.set(0x1C, 0x18)
    bench.wait(10_000)
    assert int16(bench.get(0x3F, 2)) == 2048
    bench.set(0x6B, 0x80)
    assert bench.get(0x6B) == b"\x40"
    assert bench.get(0x3B, 14) == bytes(14)


def test_mpu6050_saturates():
    bench = imu((100, -100, 0, 100, -100, 0))
    bench.set(0x6B, 0)
    bench.wait(100_000)
    data = bench.get(0x3B, 14)
    assert [int16(data[i : i + 2]) for i in (0, 2, 8, 10)] == [32767, -32768, 32767, -32768]


def test_mpu6050_gyroscope_needs_30_ms_to_start():
    bench = imu()
    bench.set(0x6B, 0)
    bench.wait(20_000)
    assert int16(bench.get(0x43, 2)) > 10_000
    bench.wait(20_000)
    assert int16(bench.get(0x43, 2)) == 0


def test_mpu6050_trims():
    """Trim codes 1 and 31 (register map, 4.1)."""
    assert accel_trim(1) == pytest.approx(1392.64)
    assert accel_trim(31) == pytest.approx(3768.32)
    assert gyro_trim(1) == pytest.approx(3275)
    assert accel_trim(0) == gyro_trim(0) == 0


def test_mpu6050_ignores_writes_to_read_only_registers():
    bench = imu()
    before = bench.get(0x0D, 4)
    bench.set(0x0D, 1, 2, 3, 4)
    bench.set(0x75, 1)
    bench.set(0x3A, 1)
    assert (bench.get(0x0D, 4), bench.get(0x75), bench.get(0x3A)) == (before, b"\x68", b"\0")


# --- LIS3MDL ----------------------------------------------------------------------------------


def test_lis3mdl():
    bench = Bench(Lis3mdl(lambda t: (1e-4, -1e-4, 5e-3), lambda t: 27.0, noise=False))
    bench.wait(10**6)
    assert bench.get(0x0F) == b"\x3d"
    assert bench.get(0xA0, 5) == bytes((0x10, 0, 3, 0, 0))
    assert bench.get(0x27) == b"\0"
    bench.set(0xA0, 0x90, 0, 0)  # 10 a second, with the temperature
    bench.wait(99_000)
    assert bench.get(0x27) == b"\0"
    bench.wait(1_000)
    assert bench.get(0xA7, 7) == b"\x0f" + bytes.fromhex("ba1a 46e5 ff7f")
    assert bench.get(0x27) == b"\0"
    assert bench.get(0xAE, 2) == bytes((16, 0))
    bench.wait(200_000)
    assert bench.get(0x27) == b"\xff"  # one was not read
    bench.set(0x21, 0x60)  # 16 gauss
    bench.wait(100_000)
    assert int16(bench.get(0xA8, 2), "little") == 1711
    bench.set(0x21, 0x04)
    assert bench.get(0x22) == b"\x03"


def test_lis3mdl_pointer_increments_only_with_its_top_bit():
    bench = Bench(Lis3mdl(lambda t: (0, 0, 0), noise=False))
    assert bench.get(0x0F, 3) == b"\x3d\x3d\x3d"


def test_lis3mdl_single_conversion():
    bench = Bench(Lis3mdl(lambda t: (1e-4, 0, 0), noise=False))
    bench.set(0x22, 1)
    bench.wait(10**6)
    assert bench.get(0xA7, 3) == b"\x0f\xba\x1a"
    assert bench.get(0x22) == b"\x03"


# --- BH1750 -----------------------------------------------------------------------------------


def lux(bench, *commands, wait=180_000):
    for command in commands:
        bench.bus.transfer(0x23, bytes((command,)), 0)
    bench.wait(wait)
    return int.from_bytes(bench.bus.transfer(0x23, b"", 2), "big")


def test_bh1750():
    bench = Bench(Bh1750(lambda t: 1000.0, noise=False))
    assert lux(bench) == 0  # off
    assert lux(bench, 0x20, wait=119_000) == 0
    assert lux(bench, wait=1_000) == 1200
    assert lux(bench, 0x21) == 2400
    assert lux(bench, 0x23, wait=16_000) == 1200
    assert lux(bench, 0x40, 0x7F, 0x20, wait=54_000) == 539
    assert lux(bench, 0x40, 0x7F, 0x20, wait=50_000) == 539  # the old one
    assert lux(bench, 0x47, 0x7E, 0x20, wait=442_000) == 4417
    bench.bus.transfer(0x23, b"\x01", 0)
    assert lux(bench, 0x07) == 0
    with pytest.raises(BusError):
        lux(bench, 0x55 | 0x80)


def test_bh1750_continuous():
    bench = Bench(Bh1750(lambda t: 100 * t, noise=False))
    first = lux(bench, 0x10)
    assert lux(bench, wait=10_000) == first
    assert lux(bench, wait=120_000) == first + 15
    assert lux(bench, 0x00) == lux(bench, wait=10**6)


# --- MAX17048 ---------------------------------------------------------------------------------


def test_max17048():
    bench = Bench(Max17048(lambda t: (4.0, 0.75 + t / 36_000), noise=False))
    assert bench.get(0x02, 4) == bytes(4)
    assert bench.get(0x08, 2) == b"\x00\x12"
    assert bench.get(0x0C, 2) == b"\x97\x1c"
    assert bench.get(0x1A, 2) == b"\x01\x00"
    bench.wait(1_000_000)
    assert bench.get(0x02, 4) == bytes.fromhex("c800 4b01")
    assert int16(bench.get(0x16, 2)) == 48  # 10 % an hour
    bench.set(0x1A, 0, 0)
    bench.set(0x02, 1, 2)
    assert bench.get(0x1A, 2) == b"\0\0"
    assert bench.get(0x02, 2) == b"\xc8\x00"
    bench.set(0xFE, 0x54, 0x00)
    assert bench.get(0x1A, 2) == b"\x01\x00"
    assert bench.get(0x02, 2) == b"\0\0"


# --- TF-Luna ----------------------------------------------------------------------------------


def test_tfluna_continuous():
    bench = Bench(TfLuna(lambda t: (2.0 if t < 1 else 3.0, 0.8), lambda t: 20.0, noise=False))
    bench.wait(500_000)
    assert bench.get(0x3C, 4) == b"LUNA"
    data = bench.get(0x00, 8)
    assert int16(data[:2], "little") == 200
    assert int16(data[4:6], "little") == 3200
    assert int16(data[6:], "little") == 500
    bench.wait(10_000)
    assert int16(bench.get(0x06, 2), "little") == 510


def test_tfluna_triggered():
    bench = Bench(TfLuna(lambda t: (2.0, 0.8), noise=False))
    bench.set(0x23, 1)
    before = bench.get(0x06, 2)
    bench.wait(10**6)
    assert bench.get(0x06, 2) == before
    bench.set(0x24, 1)
    bench.wait(5_000)
    assert bench.get(0x06, 2) != before
    assert bench.get(0x00, 2) == b"\xc8\x00"


def test_tfluna_may_update_during_a_read():
    """A read during an update from 255 to 256 cm returns one byte of each."""
    bench = Bench(TfLuna(lambda t: (2.55 if t < 0.9999 else 2.56, 0.8), noise=False))
    # The first byte is read 190 µs after the beginning and the second 90 µs later: around 1 s.
    bench.bus.frequency = 100_000
    bench.wait(999_400 - bench.clock.world_us())
    bench.bus.transfer(0x10, b"\x00", 0)
    bench.wait(999_760 - bench.clock.world_us())
    torn = int16(bench.bus.transfer(0x10, b"", 2), "little")
    assert torn == 511


# --- all --------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", MAKERS)
@settings(max_examples=examples(60), deadline=None)
@given(data=st.data())
def test_any_bytes_sent(name, data):
    address, make = MAKERS[name]
    value = data.draw(st.floats(-1e12, 1e12) | st.sampled_from((math.inf, -math.inf, math.nan)))
    bench = Bench(make(value, True))
    steps = st.tuples(st.binary(max_size=6), st.integers(0, 20), st.integers(0, 2_000_000))
    for write, read, us in data.draw(st.lists(steps, max_size=15)):
        try:
            assert len(bench.bus.transfer(address, write, read)) == read
        except BusError:
            assert name == "bh1750"  # the only one that refuses bytes
        bench.wait(us)


@pytest.mark.parametrize("name", MAKERS)
def test_faults_have_a_text(name):
    device = MAKERS[name][1](1.0, False)
    assert device.name == name
    for kind, text in device.FAULTS.items():
        assert text and not text.endswith(".")
        device.fault(kind)
    device.heal()
    assert not device.faults
