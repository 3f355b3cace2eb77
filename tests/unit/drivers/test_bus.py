"""The I2C bus, which is recovered when a device holds its data line."""

import errno

import pytest
from unit.firmware.loader import load


@pytest.fixture
def program():
    with load("ra6m5_usb_text") as program:
        yield program


@pytest.fixture
def bus(program):
    return program.main.Bus(2, "P415")


def sht3x(program):
    return program.board.i2c[2].devices[0x44]


def test_the_channel_is_opened_at_100_khz_with_a_timeout(program, bus):
    assert program.machine.opened == [{"channel": 2, "freq": 100_000, "timeout": 100_000}]


def test_a_port_without_a_timeout_argument(program):
    program.machine.timeout_argument = False
    program.main.Bus(2, "P415", frequency=400_000)
    assert program.machine.opened == [{"channel": 2, "freq": 400_000}]


def test_a_missing_channel_raises(program):
    with pytest.raises(ValueError, match="channel"):
        program.main.Bus(1, "P415")


def test_transfers(program, bus):
    bus.writeto(0x44, b"\xf3\x2d")  # the status register
    data = bytearray(3)
    bus.readfrom_into(0x44, data)
    assert data[:2] == b"\x80\x10"
    assert bus.recovered == 0


def test_a_missing_device_causes_no_recovery(program, bus):
    for call in (lambda: bus.writeto(0x20, b"\0"), lambda: bus.readfrom_into(0x20, bytearray(1))):
        with pytest.raises(OSError) as raised:
            call()
        assert raised.value.args[0] == errno.ENODEV
    assert bus.recovered == 0
    assert len(program.machine.opened) == 1


def test_a_held_bus_is_free_for_the_next_transfer(program, bus):
    """Only the transfers of the sensor that holds the bus fail."""
    sht3x(program).faults.add("stuck")
    for count in (1, 2, 3):
        with pytest.raises(OSError) as raised:
            bus.writeto(0x44, b"\x2c\x06")
        assert raised.value.args[0] == errno.ETIMEDOUT
        assert bus.recovered == count
        assert program.board.i2c[2].sda == 1
        bus.writeto(0x67, b"\0")
        bus.readfrom_into(0x67, bytearray(2))
    assert program.machine.opened[-1] == {"channel": 2, "freq": 100_000, "timeout": 100_000}


def test_a_bus_held_since_before_the_start_is_freed(program):
    wires = program.board.i2c[2]
    sht3x(program).faults.add("stuck")
    with pytest.raises(OSError):
        wires.transfer(0x44, b"\x2c\x06", 0)
    assert wires.sda == 0
    program.main.Bus(2, "P415")
    assert wires.sda == 1


def test_eperm_causes_a_recovery(program, bus):
    """The renesas-ra port raises EPERM for every error."""

    def fails(*_):
        raise OSError(errno.EPERM)

    bus._i2c.writeto = fails
    with pytest.raises(OSError):
        bus.writeto(0x44, b"")
    assert bus.recovered == 1
    bus.writeto(0x44, b"\x2c\x06")


def test_shorted_wires_are_an_error_at_each_transfer(program, bus):
    program.board.happen("bus:stuck")
    for _ in range(3):
        with pytest.raises(OSError):
            bus.writeto(0x44, b"\x2c\x06")
    program.board.happen("bus:off")
    bus.writeto(0x44, b"\x2c\x06")
