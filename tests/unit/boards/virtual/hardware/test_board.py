"""Boards by name, their wiring, and faults by name."""

import errno

import pytest

from uros.boards.virtual.devices.sht3x import crc8
from uros.boards.virtual.hardware.board import FaultError, VirtualBoard
from uros.boards.virtual.hardware.clock import ManualClock
from uros.boards.virtual.hardware.i2c import BusError
from uros.boards.virtual.hardware.pins import IN, OUT
from uros.boards.virtual.hardware.usb import (
    CONFIGURATION_DESCRIPTOR,
    CONFIGURED,
    DETACHED,
    DEVICE_DESCRIPTOR,
    ENUMERATION_US,
    STRINGS,
)
from uros.boards.virtual.models.catalog import BOARDS, BoardError, find
from uros.boards.virtual.world.room import Room


@pytest.fixture
def board(tmp_path):
    clock = ManualClock()
    board = VirtualBoard(find("ra6m5_sensor_node"), clock, tmp_path / "line")
    clock.advance(10**6)
    yield board
    board.close()


def room_celsius(board):
    data = board.i2c[2].transfer(0x44, b"\x2c\x06", 6)
    assert crc8(data[:2]) == data[2] and crc8(data[3:5]) == data[5]
    return -45 + 175 * int.from_bytes(data[:2], "big") / 65535


def active(board):
    return {fault.spec for fault in board.faults() if fault.active}


@pytest.mark.parametrize("name", BOARDS)
def test_every_board_has_parts_faults_and_actions(name, tmp_path):
    spec = BOARDS[name]
    assert spec.name == name and spec.text and spec.mcu and spec.firmware and spec.ports
    board = VirtualBoard(find(name), ManualClock(), tmp_path / "line")
    try:
        assert board.name == spec.name and board.unique_id
        specs = [happening.spec for happening in (*board.faults(), *board.acts())]
        assert len(specs) == len(set(specs)) and "usb:unplug" in specs
        for fault in board.faults():
            assert fault.text and not fault.active
            board.happen(fault.spec)
        board.clock.advance(2_000_000)
        board.advance()
        board.reset()
        board.happen("all:off")
        assert not [fault for fault in board.faults() if fault.active]
        for part in board.parts:
            assert isinstance(part.shows(), str)
    finally:
        board.close()


@pytest.mark.parametrize("name", ["ra6m5_sensor_node", "ra6m5_usb_text"])
def test_both_boards_have_the_three_sensors(name, tmp_path):
    board = VirtualBoard(find(name), ManualClock(), tmp_path / "line")
    board.clock.advance(2000)
    assert board.i2c[2].scan() == [0x13, 0x44, 0x67]
    board.close()


def test_an_unknown_board():
    with pytest.raises(BoardError, match="no board esp; there are ra6m5_sensor_node, ra6m5_usb"):
        VirtualBoard(find("esp"))


def test_the_sensors_measure_the_room(board):
    room = board.room
    assert room_celsius(board) == pytest.approx(room.temperature(1), abs=0.1)
    hot = int.from_bytes(board.i2c[2].transfer(0x67, b"\x00", 2), "big") / 16
    assert hot == pytest.approx(room.hot(0.96), abs=0.4)
    board.i2c[2].transfer(0x13, b"\x80\x18", 0)
    board.clock.advance(100_000)
    data = board.i2c[2].transfer(0x13, b"\x85", 4)
    assert int.from_bytes(data[:2], "big") / 4 == pytest.approx(room.daylight(1.1), rel=0.05)
    assert int.from_bytes(data[2:], "big") > 10_000


def test_values_depend_on_the_room_and_the_seed(tmp_path):
    def values(seed, room=None):
        model = find("ra6m5_sensor_node")
        board = VirtualBoard(model, ManualClock(), tmp_path / "line", seed, room)
        board.clock.advance(2000)
        out = room_celsius(board)
        ids.add(board.unique_id)
        board.close()
        return out

    ids = set()
    assert values(1) == values(1) != values(2)
    assert values(1, Room(start_hour=15)) > values(1) + 1
    assert len(ids) == 2 and {len(unique_id) for unique_id in ids} == {16}


@pytest.mark.parametrize("device, address", [("sht3x", 0x44), ("mcp9600", 0x67), ("vcnl4010", 19)])
@pytest.mark.parametrize(
    "kind, number",
    [
        ("absent", errno.ENODEV),
        ("nack", errno.EIO),
        ("stretch", errno.ETIMEDOUT),
        ("stuck", errno.ETIMEDOUT),
    ],
)
def test_a_fault_of_a_sensor_can_be_cleared(board, device, address, kind, number):
    board.happen(f"{device}:{kind}")
    assert active(board) == {f"{device}:{kind}"}
    command = b"\x2c\x06" if device == "sht3x" else b"\x85"
    with pytest.raises(BusError) as caught:
        board.i2c[2].transfer(address, command, 2)
    assert caught.value.errno == number
    board.happen(f"{device}:off")
    board.clock.advance(100_000)
    assert not active(board)
    assert len(board.i2c[2].transfer(address, command, 2)) == 2


def test_faults_of_one_device_do_not_affect_the_others(board):
    board.happen("mcp9600:absent")
    board.happen("vcnl4010:nack")
    room_celsius(board)
    assert active(board) == {"mcp9600:absent", "vcnl4010:nack"}
    board.happen("all:off")
    assert not active(board)


def test_faults_of_one_device_add_up(board):
    board.happen("sht3x:noise")
    board.happen("sht3x:crc")
    assert active(board) == {"sht3x:noise", "sht3x:crc"}


def test_wrong_checksums_and_an_open_thermocouple_are_faults_of_one_sensor(board):
    board.happen("sht3x:crc")
    with pytest.raises(AssertionError):
        room_celsius(board)
    board.happen("mcp9600:open")
    with pytest.raises(FaultError, match="no vcnl4010:crc; there are vcnl4010:absent, "):
        board.happen("vcnl4010:crc")


def test_a_stuck_bus(board):
    board.happen("bus:stuck")
    assert active(board) == {"bus:stuck"}
    with pytest.raises(BusError) as caught:
        room_celsius(board)
    assert caught.value.errno == errno.ETIMEDOUT
    assert board.pins["P414"].value() == 0
    board.happen("bus:off")
    assert board.pins["P414"].value() == 1
    room_celsius(board)


@pytest.mark.parametrize("spec", ["", "sht3x", "sht:nack", ":", "nack", "all:nack", "usb:nack"])
def test_an_unknown_fault_lists_the_known_ones(board, spec):
    with pytest.raises(FaultError) as caught:
        board.happen(spec)
    assert "sht3x:" in str(caught.value) or "usb:unplug" in str(caught.value)
    assert not active(board)


@pytest.mark.parametrize(
    ("spec", "meant"),
    [
        ("sht3:nack", "sht3x:nack"),
        ("SHT3X:crc", "sht3x:crc"),
        ("sht3:off", "sht3x:off"),
        ("unplug", "usb:unplug or usb:plug"),
    ],
)
def test_a_misspelt_part_is_answered_with_what_was_meant(board, spec, meant):
    with pytest.raises(FaultError) as caught:
        board.happen(spec)
    assert str(caught.value) == f"there is no {spec}; did you mean {meant}?"


def test_a_misspelt_part_keeps_its_value():
    board = VirtualBoard(find("esp32_button_led"))
    try:
        for spec, meant in (("buton:tap", "button:tap"), ("knop:turn=30", "knob:turn=30")):
            with pytest.raises(FaultError, match=f"did you mean {meant}"):
                board.happen(spec)
            board.happen(meant)
    finally:
        board.close()


def test_every_listed_fault_can_be_injected_and_cleared(board):
    for fault in board.faults():
        assert fault.text
        board.happen(fault.spec)
    board.happen("all:off")
    assert not active(board)
    board.clock.advance(10**6)
    room_celsius(board)


def configure(board):
    board.usb.enable(DEVICE_DESCRIPTOR, CONFIGURATION_DESCRIPTOR, STRINGS)
    board.clock.advance(ENUMERATION_US)
    assert board.usb.state == CONFIGURED


def test_faults_of_usb(board):
    configure(board)
    board.happen("usb:suspend")
    assert active(board) == {"usb:suspend"} and board.usb.suspended
    board.happen("usb:resume")
    assert not active(board)
    board.happen("usb:unplug")
    assert active(board) == {"usb:unplug"} and board.usb.state == DETACHED
    for heals in ("usb:plug", "usb:off"):
        board.happen("usb:unplug")
        board.happen(heals)
        board.clock.advance(ENUMERATION_US)
        assert board.usb.state == CONFIGURED and not active(board)


def test_a_reset(board):
    configure(board)
    rtc = board.clock.epoch_ns()
    board.pins["P006"].mode = OUT
    board.reset()
    assert board.usb.state == DETACHED and not board.usb.path.is_symlink()
    assert board.clock.ticks_us() == 0 and board.clock.epoch_ns() == rtc
    assert board.pins["P006"].mode == IN
    configure(board)


def test_an_output_keeps_its_level_and_an_input_is_pulled_up(board):
    led, button = board.pins["P006"], board.pins["P005"]
    led.mode = OUT
    assert [led.value(), led.value(5), led.value(), led.value(0)] == [0, 1, 1, 0]
    assert button.value() == 1


def test_a_program_frees_a_stuck_bus_by_its_pins(board):
    bus = board.i2c[2]
    board.happen("sht3x:stuck")
    with pytest.raises(BusError):
        room_celsius(board)
    sda, scl = board.pins["P414"], board.pins["P415"]
    assert (sda.value(), scl.value()) == (0, 1)
    scl.mode = OUT
    for _ in range(9):
        scl.value(0)
        assert scl.value() == 0
        scl.value(1)
    assert sda.value() == 1
    assert bus.transfer(0x13, b"\x81", 1) == b"\x21"
