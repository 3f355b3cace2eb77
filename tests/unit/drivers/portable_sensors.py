"""Drivers of sensors on a scripted bus. Also runs on MicroPython."""

import errno

from support.script import Script, raised

from uros.drivers import SensorError, reason
from uros.drivers.mcp9600 import MCP9600
from uros.drivers.sht3x import SHT3x, crc8
from uros.drivers.vcnl4010 import LUX_PER_COUNT, VCNL4010


def near(a, b):
    assert abs(a - b) < 0.0005, (a, b)


def test_crc_of_the_datasheet():
    assert crc8(b"\xbe\xef", 0, 2) == 0x92
    assert crc8(b"\x00\x00", 0, 2) == 0x81
    assert crc8(b"xx\xff\xffyy", 2, 4) == 0xAC
    assert crc8(b"", 0, 0) == 0xFF


def test_sht3x_reads_temperature_and_humidity():
    # 0x6666 is 2/5 of the range: -45 + 70; 0x8000 half of it.
    bus = Script("44>2c06", "44<666693" + "8000a2")
    sensor = SHT3x(bus)
    sensor.start()
    sensor.read()
    near(sensor.temperature, 25.0)
    near(sensor.humidity, 0.5)
    bus.over()


def test_sht3x_checks_both_words_and_keeps_the_last_good_values():
    bus = Script("44<666693" + "8000a2", "44<666692" + "8000a2", "44<666693" + "8000a3")
    sensor = SHT3x(bus)
    sensor.read()
    assert "CRC of the temperature" in str(raised(sensor.read))
    assert "CRC of the humidity" in str(raised(sensor.read))
    near(sensor.temperature, 25.0)
    near(sensor.humidity, 0.5)


def test_sht3x_refuses_what_it_cannot_measure():
    hot, dry = "ffffac", "000081"
    sensor = SHT3x(Script("44<" + hot + dry, "44<" + dry + dry))
    assert "130.0 C is out of range" in str(raised(sensor.read))
    assert "-45.0 C is out of range" in str(raised(sensor.read))
    assert sensor.temperature == 0.0


def test_sht3x_bus_errors_pass_through():
    sensor = SHT3x(Script("44>!%d" % errno.ENODEV, "44<!%d" % errno.ETIMEDOUT))
    assert raised(sensor.start).args[0] == errno.ENODEV
    assert raised(sensor.read).args[0] == errno.ETIMEDOUT


def test_sht3x_at_its_other_address():
    bus = Script("45>2c06")
    SHT3x(bus, 0x45).start()
    bus.over()


def test_mcp9600_reads_both_junctions():
    bus = Script("67>00", "67<0190", "67>04", "67<40", "67>02", "67<017d")
    sensor = MCP9600(bus)
    assert sensor.read_hot() == 25.0
    assert sensor.read_cold() == 23.8125
    bus.over()


def test_mcp9600_high_and_negative_temperatures():
    sensor = MCP9600(
        Script("67>00", "67<4b00", "67>04", "67<00", "67>00", "67<ffff", "67>04", "67<00")
    )
    assert sensor.read_hot() == 1200.0
    assert sensor.read_hot() == -0.0625
    sensor = MCP9600(Script("67>02", "67<fe70"))
    assert sensor.read_cold() == -25.0


def test_mcp9600_refuses_what_it_cannot_measure():
    sensor = MCP9600(
        Script(
            "67>00", "67<7fff", "67>04", "67<40",
            "67>00", "67<0190", "67>04", "67<50",
            "67>02", "67<0800",
        )
    )  # fmt: skip
    assert "broken" in str(raised(sensor.read_hot))
    assert "broken" in str(raised(sensor.read_hot))
    assert "cold junction: 128.0 C is out of range" in str(raised(sensor.read_cold))


SET_UP = ("13>81", "13<21", "13>8314", "13>849d")
START = ("13>8018",)
SETTINGS = "21" + "00" + "14" + "9d"  # product, proximity rate, current, ambient parameter
READY = ("13>80", "13<e0" + SETTINGS)
RESULTS = ("13>85", "13<04e0" + "2710")


def test_vcnl4010_is_set_up_once_and_read_when_both_are_ready():
    half = ("13>80", "13<a0" + SETTINGS)  # the proximity alone
    none = ("13>80", "13<98" + SETTINGS)
    bus = Script(*(SET_UP + START + none + half + READY + RESULTS + START + READY + RESULTS))
    sensor = VCNL4010(bus)
    sensor.start()
    assert sensor.read() is False
    assert sensor.read() is False
    assert (sensor.proximity, sensor.ambient) == (0, 0)
    assert sensor.read() is True
    assert (sensor.proximity, sensor.ambient) == (10000, 1248)
    assert sensor.ambient * LUX_PER_COUNT == 312.0
    sensor.start()
    assert sensor.read() is True
    bus.over()


def test_vcnl4010_missing_at_start_is_set_up_later():
    missing = "13>!%d" % errno.ENODEV
    bus = Script(missing, missing, *(SET_UP + START))
    sensor = VCNL4010(bus)
    raised(sensor.start)
    raised(sensor.start)
    sensor.start()
    bus.over()


def test_vcnl4010_is_set_up_again_after_every_error():
    gone = "13>!%d" % errno.ENODEV
    late = "13<!%d" % errno.ETIMEDOUT
    whole = SET_UP + START
    bus = Script(
        *(whole + (gone,) + whole + (gone,) + whole + ("13>80", late) + whole)
        + (READY + ("13>85", late) + whole + READY + RESULTS + (gone,) + whole)
    )
    sensor = VCNL4010(bus)
    sensor.start()
    raised(sensor.start)
    sensor.start()
    raised(sensor.read)
    sensor.start()
    raised(sensor.read)
    sensor.start()
    raised(sensor.read)
    sensor.start()
    assert sensor.read()
    raised(sensor.start)
    sensor.start()
    bus.over()


def test_vcnl4010_detects_a_reset():
    """The sensor answers with its settings after power-on: 20 mA."""
    fresh = ("13>80", "13<e0" + "21" + "00" + "02" + "9d")
    darker = ("13>80", "13<e0" + "21" + "00" + "14" + "1d")
    fuse = (
        "13>80",
        "13<e0" + "21" + "00" + "d4" + "9d",
    )  # the upper bits at 0x83 are not part of the current
    whole = SET_UP + START
    bus = Script(*(whole + fresh + whole + darker + whole + fuse + RESULTS))
    sensor = VCNL4010(bus)
    sensor.start()
    assert "lost its settings" in str(raised(sensor.read))
    sensor.start()
    assert "lost its settings" in str(raised(sensor.read))
    sensor.start()
    assert sensor.read()
    bus.over()


def test_vcnl4010_does_not_set_up_foreign_devices():
    bus = Script("13>81", "13<ea", *(SET_UP + START))
    sensor = VCNL4010(bus)
    assert "product id 0xea" in str(raised(sensor.start))
    sensor.start()
    bus.over()


def test_reasons_are_text():
    assert reason(OSError(errno.ENODEV)) == "no answer"
    assert reason(OSError(errno.EIO)) == "bus error"
    assert reason(OSError(errno.EPERM)) == "bus error"
    assert reason(OSError(errno.ETIMEDOUT)) == "bus timed out"
    assert reason(OSError(12345)) == "bus error 12345"
    assert reason(OSError()) == "bus error 0"
    assert reason(SensorError("wrong CRC of the humidity")) == "wrong CRC of the humidity"
