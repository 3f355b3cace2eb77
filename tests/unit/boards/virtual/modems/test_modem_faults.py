"""What can happen to a modem that is plugged in, and what it then says."""

import pytest

from uros.boards.virtual.hardware.board import FaultError, VirtualBoard
from uros.boards.virtual.hardware.clock import ManualClock


@pytest.fixture
def board(tmp_path):
    made = VirtualBoard("spresense_publisher_wifi", ManualClock(), tmp_path / "tty")
    yield made
    made.close()


def said(board, uart=2):
    """What the ESP8266 has to say by now."""
    out = b""
    for _ in range(400):
        board.clock.advance(2_000)
        out += board.uarts[uart].read(256)
    return out


def told(board, line):
    board.uarts[2].write(line + b"\r\n")
    return said(board)


def test_an_esp8266_that_is_busy_says_so_to_each_command(board):
    assert b"OK" in told(board, b"AT")
    board.happen("esp8266:busy")
    assert told(board, b"AT").endswith(b"busy p...\r\n")
    assert told(board, b"ATE0").endswith(b"busy p...\r\n")
    board.happen("esp8266:off")
    assert b"OK" in told(board, b"AT")


def test_what_is_over_at_once_is_no_fault_that_stays(board):
    board.happen("esp8266:chatty")
    board.happen("gs2200:chatty")
    assert b"WIFI GOT IP" in said(board)
    assert board.pins["14"].value() == 1  # the GS2200 has something to say
    board.happen("esp8266:closed")
    assert said(board) == b""  # there is no link
    assert not [it.spec for it in board.faults() if it.active]
    with pytest.raises(FaultError, match="esp8266:closed"):
        board.happen("esp8266:open")


def test_a_link_that_is_closed_is_told(board):
    for line in (b"AT+CWMODE=1", b'AT+CWJAP="robots","secret99"'):
        assert b"OK" in told(board, line)
    assert b"CONNECT" in told(board, b'AT+CIPSTART="UDP","127.0.0.1",9')
    board.happen("esp8266:closed")
    assert said(board) == b"CLOSED\r\n"
    assert board.parts["esp8266"].shows() == "in robots"
