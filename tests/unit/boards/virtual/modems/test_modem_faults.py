"""The faults and events of a modem that is attached to a virtual board."""

import pytest

from uros.boards.virtual.hardware.board import FaultError, VirtualBoard
from uros.boards.virtual.hardware.clock import ManualClock
from uros.boards.virtual.models.catalog import find


@pytest.fixture
def board(tmp_path):
    virtual_board = VirtualBoard(find("spresense_publisher_wifi"), ManualClock(), tmp_path / "tty")
    yield virtual_board
    virtual_board.close()


def output(board, uart=2):
    """Return what the ESP8266 has sent within the next 0.8 s."""
    out = b""
    for _ in range(400):
        board.clock.advance(2_000)
        out += board.uarts[uart].read(256)
    return out


def command(board, line):
    board.uarts[2].write(line + b"\r\n")
    return output(board)


def test_a_busy_esp8266_responds_busy_to_each_command(board):
    assert b"OK" in command(board, b"AT")
    board.happen("esp8266:busy")
    assert command(board, b"AT").endswith(b"busy p...\r\n")
    assert command(board, b"ATE0").endswith(b"busy p...\r\n")
    board.happen("esp8266:off")
    assert b"OK" in command(board, b"AT")


def test_momentary_events_are_not_active_faults(board):
    board.happen("esp8266:chatty")
    board.happen("gs2200:chatty")
    assert b"WIFI GOT IP" in output(board)
    assert board.pins["14"].value() == 1  # the GS2200 has data to fetch
    board.happen("esp8266:closed")
    assert output(board) == b""  # there is no link
    assert not [fault.spec for fault in board.faults() if fault.active]
    with pytest.raises(FaultError, match="esp8266:closed"):
        board.happen("esp8266:open")


def test_closing_the_link_is_reported(board):
    for line in (b"AT+CWMODE=1", b'AT+CWJAP="robots","secret99"'):
        assert b"OK" in command(board, line)
    assert b"CONNECT" in command(board, b'AT+CIPSTART="UDP","127.0.0.1",9')
    board.happen("esp8266:closed")
    assert output(board) == b"CLOSED\r\n"
    assert board.parts["esp8266"].shows() == "in robots"
