"""Peripherals attached to a virtual board: serial lines with a baud rate, and a radio."""

import errno

import pytest

from uros.boards.virtual.hardware.board import FaultError, VirtualBoard
from uros.boards.virtual.hardware.clock import ManualClock
from uros.boards.virtual.hardware.peripherals import (
    PeripheralError,
    Radio,
    Spi,
    Uart,
    UartPins,
)
from uros.boards.virtual.models.catalog import find
from uros.boards.virtual.modems.radio_network import RadioNetwork

BOARD = "ra6m5_sensor_node"


class Device:
    def __init__(self):
        self.received = b""
        self.to_send = b""

    def read(self, size):
        data, self.to_send = self.to_send[:size], self.to_send[size:]
        return data or None

    def write(self, data):
        self.received += data
        return len(data)


@pytest.fixture
def line():
    clock, device = ManualClock(), Device()
    return clock, device, Uart(device, 115200, clock)


def test_octets_are_transferred_at_the_baud_rate(line):
    """115200 baud are 11520 octets a second, in each direction."""
    clock, device, uart = line
    assert uart.write(bytes(100)) == 100 and device.received == b""
    clock.advance(5_000)
    uart.any()
    assert len(device.received) == 57
    clock.advance(5_000)
    uart.any()
    assert len(device.received) == 100
    device.to_send = bytes(300)
    clock.advance(10_000)
    assert uart.any() == 115


def test_a_write_takes_what_fits_into_the_buffer(line):
    clock, device, uart = line
    assert uart.write(bytes(1000)) == 256 and uart.write(b"x") == 0
    clock.advance(1_000_000)
    assert uart.write(b"x") == 1
    assert len(device.received) == 256


def test_octets_for_a_full_buffer_are_lost_and_counted(line):
    clock, device, uart = line
    uart.init(115200, 64)
    device.to_send = bytes(range(100))
    clock.advance(1_000_000)
    assert uart.read(1000) == bytes(range(64)) and uart.overruns == 36


def test_at_another_baud_rate_both_ends_receive_noise(line):
    clock, device, uart = line
    uart.init(9600, 256)
    uart.write(b"AT\r\n")
    device.to_send = b"\r\nOK\r\n"
    clock.advance(1_000_000)
    assert uart.read(100) not in (b"", b"\r\nOK\r\n")
    assert len(device.received) == 4 and device.received != b"AT\r\n"


def test_a_rate_within_three_percent_is_understood(line):
    _, device, uart = line
    for baud, understood in ((111_860, True), (118_500, True), (111_000, False), (119_000, False)):
        uart.init(baud, 256)
        assert uart.understood() is understood, baud
        assert uart.rates() == (baud, 115200)


class Cable(Device):
    """A device at a rate that may change, which tells when there is something to read."""

    def __init__(self, clock):
        super().__init__()
        self.baud = 115200
        self.waits = []
        self._clock = clock

    def any(self):
        return len(self.to_send)

    def wait(self, seconds):
        self.waits.append(seconds)
        self._clock.sleep_world_us(round(seconds * 1e6))


def test_the_rate_of_a_cable_may_change_and_is_unknown_without_a_program():
    clock = ManualClock()
    cable = Cable(clock)
    uart = Uart(cable, 115200, clock, cable)
    for baud, understood in ((9600, False), (115200, True), (0, True)):
        cable.baud, cable.received = baud, b""
        uart.write(b"abc")
        clock.advance(1_000_000)
        uart.any()
        assert (cable.received == b"abc") is uart.understood() is understood, baud


def test_an_idle_cable_is_waited_for_once_and_other_devices_are_polled(line):
    clock = ManualClock()
    cable = Cable(clock)
    uart = Uart(cable, 115200, clock, cable)
    uart.pause(100_000)
    assert cable.waits == [0.1] and clock.world_us() == 100_000
    cable.to_send = bytes(20)
    # What began to come at the end of the wait has its time on the line, and so has what is sent.
    assert uart.any() == 0 and uart.under_way() == 20
    uart.pause(100_000)
    assert uart.any() == 20 and 101_700 < clock.world_us() < 101_800
    uart.write(bytes(40))
    uart.pause(100_000)
    uart.any()
    assert len(cable.received) == 40 and clock.world_us() < 105_500 and len(cable.waits) == 1
    other_clock, _, other = line
    other.pause(100_000)
    assert other_clock.world_us() == 1_000


@pytest.mark.parametrize(
    ("chosen", "sent", "received"),
    [
        (("17", "16"), b"to the device", b"to the board"),
        (("", ""), b"", b""),  # the default is elsewhere
        (("16", "17"), b"", b""),
        (("17", ""), b"to the device", b""),
        (("4", "16"), b"", b"to the board"),
    ],
)
def test_nothing_arrives_at_pins_that_are_not_those_of_the_device(chosen, sent, received):
    clock, device = ManualClock(), Device()
    uart = Uart(device, 115200, clock, pins=UartPins("17", "16"), default_pins=UartPins("10", "9"))
    uart.init(115200, 256, *chosen)
    uart.write(b"to the device")
    device.to_send = b"to the board"
    clock.advance(1_000_000)
    assert uart.read(100) == received and device.received == sent
    assert device.to_send == b""  # what is sent into the air is lost
    assert uart.write(bytes(200)) == 200  # and makes room


def test_a_long_message_leaves_room_in_the_receive_buffer():
    clock = ManualClock()
    cable = Cable(clock)
    uart = Uart(cable, 115200, clock, cable)
    cable.to_send = bytes(5000)
    received = 0
    while cable.any() or uart.any():
        while uart.any() >= 0 and uart.under_way():
            uart.pause(100_000)
        received += len(uart.read(256))
    assert received == 5000 and uart.overruns == 0


def test_a_bus_in_the_wrong_mode_or_without_selection_reads_ff():
    class Modem:
        written = b""

        def write(self, data):
            self.written += data

        def readinto(self, into, octet):
            into[:] = b"m" * len(into)

    modem = Modem()
    bus = Spi(modem)
    for mode in (0, 2, 3):
        bus.init(mode)
        bus.write(b"no")
        assert bus.read(2, 0) == b"\xff\xff"
    bus.init(1)
    bus.selected = False
    bus.write(b"no")
    assert bus.read(2, 0) == b"\xff\xff" and modem.written == b""
    bus.selected = True
    bus.write(b"yes")
    assert bus.read(2, 0) == b"mm" and modem.written == b"yes"


def test_a_radio_joins_after_a_moment():
    now = [0]
    radio = Radio(RadioNetwork({"robots": "secret99"}), lambda: now[0])
    assert radio.status() == Radio.IDLE
    for ssid, password, status in (
        ("robots", "no", Radio.WRONG_PASSWORD), ("cafe", "", Radio.NO_AP_FOUND),
        ("robots", "secret99", Radio.GOT_IP),
    ):  # fmt: skip
        radio.connect(ssid, password)
        assert radio.status() == Radio.CONNECTING
        now[0] += 1000
        assert radio.status() == status
    radio.faults.add("lost")
    assert radio.status() == Radio.NO_AP_FOUND
    radio.faults.clear()
    radio.disconnect()
    assert radio.status() == Radio.IDLE


def test_sockets_need_a_network_and_are_limited():
    radio = Radio(RadioNetwork({"robots": "secret99"}), lambda: 1000)
    handles = [radio.open(2) for _ in range(16)]
    assert len(set(handles)) == 16
    with pytest.raises(OSError, match="no room"):
        radio.open(1)
    with pytest.raises(OSError) as caught:
        radio.of(handles[0])
    assert caught.value.errno == errno.EHOSTUNREACH
    radio.reset()
    with pytest.raises(OSError) as caught:
        radio.of(handles[0])
    assert caught.value.errno == errno.EBADF and radio.fd(handles[0]) == -1


def test_faults_of_peripherals_are_faults_of_the_board():
    board = VirtualBoard(find(BOARD), ManualClock(), plugs=["esp8266:uart=1", "wlan"])
    try:
        modem = board.parts["esp8266"].device
        modem.joined = "robots"
        board.happen("esp8266:lost")
        board.happen("wlan:lost")
        assert modem.joined == "" and modem.network.access_points == {}
        active = {fault.spec for fault in board.faults() if fault.active}
        assert active == {"esp8266:lost", "wlan:lost"}
        board.happen("all:off")
        assert modem.network.access_points == {"robots": "secret99"}
        assert not [fault for fault in board.faults() if fault.active]
        with pytest.raises(FaultError, match="esp8266:dead"):
            board.happen("esp8266:nonsense")
    finally:
        board.close()


@pytest.mark.parametrize(
    ("spec", "error"),
    [
        ("nothing", "there are esp8266, gs2200, wlan"), ("esp8266", "say which"),
        ("esp8266:uart=-1", "no number"), ("gs2200:spi=1", "say which"),
        ("wlan:uart=1", "no option uart"),
    ],
)  # fmt: skip
def test_a_peripheral_that_cannot_be_attached_is_reported(spec, error):
    with pytest.raises(PeripheralError, match=error):
        VirtualBoard(find(BOARD), ManualClock(), plugs=[spec])


@pytest.mark.parametrize("fault", ["alone", "deaf", "lost"])
def test_no_station_joins_an_access_point_that_fails(fault):
    now = [0]
    radio = Radio(RadioNetwork({}), lambda: now[0])
    radio.start("board", "secret99")
    now[0] = 10_000
    assert radio.guests() == 1
    radio.faults.add(fault)
    assert radio.guests() == 0
    radio.faults.clear()
    assert radio.guests() == 1
