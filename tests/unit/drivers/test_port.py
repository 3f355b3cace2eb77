"""The serial port towards the host: USB with its descriptors, or a UART."""

import errno

import pytest
from unit.firmware.loader import load

from uros.boards.virtual.hardware.usb import CONFIGURATION_DESCRIPTOR


@pytest.fixture
def program():
    with load("ra6m5_sensor_node") as program:
        yield program


def open_port(program):
    return program.main.open_port(0x045B, 0x2013, "Renesas", "RA6M5 Sensor Node", "000001")


def test_usb_identifiers_and_strings(program):
    open_port(program)
    assert program.usb.on
    assert program.usb.options == {
        "manufacturer_str": "Renesas",
        "product_str": "RA6M5 Sensor Node",
        "serial_str": "000001",
        "id_vendor": 0x045B,
        "id_product": 0x2013,
        "bcd_device": 0x0200,
        "device_class": 2,
        "max_power_ma": 100,
    }


def test_configuration_descriptor(program):
    """67 bytes: self-powered, 100 mA, endpoints 0x83, 0x01, 0x82."""
    port = open_port(program)
    assert bytes(program.usb.configuration) == CONFIGURATION_DESCRIPTOR
    assert len(CONFIGURATION_DESCRIPTOR) == 67
    assert (port.ep_c_in, port.ep_d_out, port.ep_d_in) == (0x83, 0x01, 0x82)


def test_no_call_of_the_port_waits(program):
    port = open_port(program)
    assert port.options == {"timeout": 0, "txbuf": 512, "rxbuf": 2048}
    assert port.read(10) is None
    port.port.incoming += b"hello"
    assert port.read(3) == b"hel"
    port.port.room = 2
    assert port.write(b"abc") == 2
    before = program.clock.world_us()
    port.wait(5)
    assert program.clock.world_us() - before == 5000


def test_without_a_host_every_call_raises(program):
    port = open_port(program)
    port.opened = False
    for call in (port.open, lambda: port.read(1), lambda: port.write(b"a")):
        with pytest.raises(OSError) as raised:
            call()
        assert raised.value.args[0] == errno.ENODEV
    port.opened = True
    port.open()
    assert port.write(b"a") == 1


def test_close_keeps_the_usb_port(program):
    port = open_port(program)
    port.close()
    port.open()
    assert program.usb.on
    assert port.write(b"a") == 1


def test_a_uart_is_used_without_usb_devices(program):
    with load("ra6m5_sensor_node", usb=False) as without_usb:
        open_port(without_usb)
        assert without_usb.machine.uarts == [((7, 115200), {"timeout": 0, "rxbuf": 2048})]


def test_a_uart_is_used_if_micropython_has_no_usb_devices(program):
    def get():
        raise AttributeError("'module' object has no attribute 'USBDevice'")

    program.modules["usb.device"].get = get
    open_port(program)
    assert len(program.machine.uarts) == 1
