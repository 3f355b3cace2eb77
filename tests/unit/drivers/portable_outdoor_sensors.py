"""Drivers of IMU, magnetometer, light, battery and range sensors on a scripted bus.

Also runs on MicroPython. The bytes are written by hand from the datasheets.
"""

import errno

from support.script import Script, raised

from uros.drivers.bh1750 import BH1750
from uros.drivers.lis3mdl import LIS3MDL
from uros.drivers.max17048 import MAX17048
from uros.drivers.mpu6050 import MPU6050
from uros.drivers.tfluna import TFLuna

GONE = "!%d" % errno.ENODEV


def near(a, b, by=0.0005):
    assert abs(a - b) < by, (a, b)


# --- MPU-6050 ---------------------------------------------------------------------------------

IMU = ("68>75", "68<68", "68>6b01", "68>1909030000", "68>3801")


def imu(status, *words):
    """Return a burst of the status and seven words."""
    return ("68>3a", "68<" + status + "".join(words))


FLAT = ("0000", "0000", "4000", "0000", "0000", "0000", "0000")
SETTLING = (
    imu("01", *FLAT)
    + imu("01", "0001", *FLAT[1:])
    + imu("01", *FLAT)
    + imu("01", "0001", *FLAT[1:])
)


def settled(*more):
    bus = Script(*(IMU + SETTLING + more))
    sensor = MPU6050(bus)
    for _ in range(4):
        assert sensor.read() is False
    return bus, sensor


def test_mpu6050_is_set_up_and_read():
    # 1 g is 16384 at 2 g; 90 degrees a second 11796 at 250; 25 °C is (25 - 36.53) * 340.
    bus, sensor = settled(*imu("01", "c000", "2000", "4000", "f0b0", "2e14", "d1ec", "0083"))
    assert sensor.read() is True
    near(sensor.ax, -9.80665)
    near(sensor.ay, 4.903325)
    near(sensor.az, 9.80665)
    near(sensor.temperature, 25.0, 0.01)
    near(sensor.gx, 1.5708)
    near(sensor.gy, -1.5708)
    near(sensor.gz, 0.01744)
    bus.over()


def test_mpu6050_ranges():
    bus = Script("68>75", "68<68", "68>6b01", "68>1909031818", "68>3801")
    sensor = MPU6050(bus, accel_g=16, gyro_dps=2000)
    sensor.start()
    bus.over()
    bus.transfers = list(SETTLING + imu("01", "0800", "0000", "0000", *FLAT[3:6], "1062"))
    for _ in range(4):
        sensor.read()
    assert sensor.read()
    near(sensor.ax, 9.80665)
    near(sensor.gz, 4.4677)
    for accel, gyro in ((3, 250), (2, 300)):
        try:
            MPU6050(bus, accel_g=accel, gyro_dps=gyro)
        except ValueError as error:
            assert " or " in str(error)
        else:
            raise AssertionError("taken")


def test_mpu6050_without_new_values_is_set_up_again():
    bus, sensor = settled(*(imu("00", *FLAT) * 8 + IMU))
    for _ in range(7):
        assert sensor.read() is False
    assert "no new values" in str(raised(sensor.read))
    sensor.start()
    bus.over()


def test_mpu6050_with_constant_values_is_an_error():
    bus, sensor = settled(*(imu("01", *FLAT) * 9))
    for _ in range(8):
        assert sensor.read() is True
    assert "same values" in str(raised(sensor.read))
    bus.over()


def test_mpu6050_refuses_the_ends_of_its_ranges_and_keeps_the_last():
    bus, sensor = settled(
        *(
            imu("01", *FLAT)
            + imu("01", "7fff", *FLAT[1:])
            + IMU
            + SETTLING
            + imu("01", *(FLAT[:6] + ("8000",)))
        )
    )
    assert sensor.read()
    assert "acceleration is out of range" in str(raised(sensor.read))
    for _ in range(4):
        assert sensor.read() is False
    assert "rate of turn is out of range" in str(raised(sensor.read))
    near(sensor.az, 9.80665)
    bus.over()


def test_mpu6050_temperature_has_no_range_check():
    _, sensor = settled(*imu("01", "0000", "0000", "4000", "7fff", "0000", "0000", "0000"))
    assert sensor.read()


def test_mpu6050_foreign_device_and_bus_errors():
    bus = Script("68>75", "68<19", "68>75", "68" + "<" + GONE, *IMU)
    sensor = MPU6050(bus)
    assert "id 0x19 is not an MPU-6050's" in str(raised(sensor.read))
    assert raised(sensor.start).args[0] == errno.ENODEV
    sensor.start()
    sensor.start()
    bus.over()


def test_mpu6050_self_test():
    """Codes of 16 everywhere: 1392.64 * 2.70588 ** 0.5 = 2291 for an acceleration, and
    3275 * 1.046 ** 15 = 6430 for a rate."""
    begin = ("68>1909030010",)
    push = ("68>190903e0f0",)
    still = imu("01", "0000", "0000", "1000", "0000", "0000", "0000", "0000")
    codes = ("68>0d", "68<90909000")
    good = imu("01", "08f3", "08f3", "18f3", "0000", "191e", "e6e2", "191e")
    # z by half as much; x of the gyroscope the wrong way.
    bad = imu("01", "08f3", "08f3", "1479", "0000", "e6e2", "e6e2", "191e")
    bus = Script(*(IMU + begin + still + push + good + codes + IMU + begin + still + push + bad)
                 + codes + IMU)  # fmt: skip
    sensor = MPU6050(bus)
    assert (sensor.self_test(), sensor.self_test()) == (False, False)
    assert sensor.self_test() is True
    sensor.self_test()
    sensor.self_test()
    assert str(raised(sensor.self_test)) == "self-test is wrong: az gx"
    sensor.start()
    bus.over()


# --- LIS3MDL ----------------------------------------------------------------------------------

FIELD = ("1c>0f", "1c<3d", "1c>a074000" + "00c40")


def test_lis3mdl_is_set_up_and_read():
    # 0.5 gauss is 3421 counts: 0x0d5d.
    bus = Script(*(FIELD + ("1c>a7", "1c<0f5d0d" + "a3f2" + "0000")))
    sensor = LIS3MDL(bus)
    assert sensor.read() is True
    near(sensor.x * 1e6, 50.0)
    near(sensor.y * 1e6, -50.0)
    assert sensor.z == 0.0
    bus.over()


def test_lis3mdl_out_of_range_and_without_samples():
    sample = ("1c>a7", "1c<0fff7f" + "0000" + "0000")
    none = ("1c>a7", "1c<00" + "00" * 6)
    bus = Script(*(FIELD + sample + FIELD + none * 8 + FIELD))
    sensor = LIS3MDL(bus)
    assert "field is out of range" in str(raised(sensor.read))
    for _ in range(7):
        assert sensor.read() is False
    assert "no new values" in str(raised(sensor.read))
    sensor.start()
    bus.over()


def test_lis3mdl_foreign_device():
    assert "id 0x33 is not a LIS3MDL's" in str(raised(LIS3MDL(Script("1c>0f", "1c<33")).read))


# --- BH1750 -----------------------------------------------------------------------------------


def test_bh1750_sets_its_time_before_each_measurement():
    start = ("23>40", "23>7f", "23>20")
    bus = Script(*(start + ("23<0216",) + start + ("23<ffff",) + start + ("23" + "<" + GONE,)))
    sensor = BH1750(bus)
    sensor.start()
    sensor.read()
    near(sensor.lux, 534 / 1.2 * 69 / 31, 0.01)
    sensor.start()
    assert "out of range" in str(raised(sensor.read))
    sensor.start()
    assert raised(sensor.read).args[0] == errno.ENODEV
    near(sensor.lux, 990.48, 0.01)
    bus.over()


# --- MAX17048 ---------------------------------------------------------------------------------


def test_max17048_voltage_and_charge():
    # 3.9 V is 49920 counts; 50 % 12800; 12 counts less an hour are 2.5 %.
    known = ("36>08", "36<0012")
    read = ("36>02", "36<c300" + "3200", "36>16", "36<fff4")
    bus = Script(*(known + read + read))
    sensor = MAX17048(bus)
    sensor.read()
    sensor.read()
    near(sensor.volts, 3.9)
    near(sensor.fraction, 0.5)
    near(sensor.rate, -0.02496)
    bus.over()


def test_max17048_charge_is_limited_to_one():
    sensor = MAX17048(Script("36>08", "36<0011", "36>02", "36<d2006480", "36>16", "36<0000"))
    sensor.read()
    assert sensor.fraction == 1.0


def test_max17048_without_a_cell_and_foreign_device():
    known = ("36>08", "36<0012")
    bus = Script(*(known + ("36>02", "36<02000000") + known + ("36>02", "36" + "<" + GONE)))
    sensor = MAX17048(bus)
    assert "0.04 V is no cell's" in str(raised(sensor.read))
    assert raised(sensor.read).args[0] == errno.ENODEV
    bus.over()
    assert "version 0x0003" in str(raised(MAX17048(Script("36>08", "36<0003")).read))


# --- TF-Luna ----------------------------------------------------------------------------------

RANGE = ("10>3c", "10<4c554e41", "10>2301", "10>00", "10<" + "00" * 6 + "e803")
TRIGGER = ("10>2401",)


def results(centimetres, amplitude, counter):
    out = bytes((centimetres & 255, centimetres >> 8, amplitude & 255, amplitude >> 8, 0, 0,
                 counter & 255, counter >> 8))  # fmt: skip
    return ("10>00", "10<" + "".join("%02x" % octet for octet in out))


def test_tfluna_measures_when_it_is_triggered():
    bus = Script(
        *(RANGE + TRIGGER + results(0, 0, 1000) + results(123, 2000, 1004))
        + (TRIGGER + results(800, 200, 1100))
    )
    sensor = TFLuna(bus)
    sensor.start()
    assert sensor.read() is False
    assert sensor.read() is True
    near(sensor.range, 1.23)
    assert sensor.amplitude == 2000
    sensor.start()
    assert sensor.read()
    assert sensor.range == 8.0
    bus.over()


def test_tfluna_too_far_and_too_near():
    inf = float("inf")
    bus = Script(
        *(RANGE + TRIGGER + results(0, 99, 1) + TRIGGER + results(801, 500, 2))
        + (TRIGGER + results(19, 30000, 3) + TRIGGER + results(20, 30000, 4))
    )
    sensor = TFLuna(bus)
    for wanted in (inf, inf, -inf, 0.2):
        sensor.start()
        assert sensor.read()
        assert sensor.range == wanted
    bus.over()


def test_tfluna_blinded_stuck_or_foreign_device():
    blinded = results(0, 65535, 7)
    bus = Script(*(RANGE + TRIGGER + blinded + TRIGGER + results(0, 0, 7) * 5 + RANGE + TRIGGER))
    sensor = TFLuna(bus)
    sensor.start()
    assert "blinded" in str(raised(sensor.read))
    sensor.start()
    for _ in range(4):
        assert sensor.read() is False
    assert "does not end" in str(raised(sensor.read))
    sensor.start()
    bus.over()
    assert "no TF-Luna" in str(raised(TFLuna(Script("10>3c", "10<00000000")).start))
