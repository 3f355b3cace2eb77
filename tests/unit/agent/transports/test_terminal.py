"""Opening a device: its settings, earlier input, and the modem lines."""

import errno
import fcntl
import os
import struct
import termios
import tty

import pytest

from uros.agent.transports import terminal as module
from uros.agent.transports.baud import BaudRateError
from uros.agent.transports.terminal import open_device, reason, set_modem_lines

DTR, RTS = termios.TIOCM_DTR, termios.TIOCM_RTS


@pytest.fixture
def device():
    """(master, slave, path)"""
    master, slave = os.openpty()
    tty.setraw(slave)
    yield master, slave, os.ttyname(slave)
    os.close(master)
    os.close(slave)


def test_the_terminal_settings(device):
    attributes = termios.tcgetattr(device[1])
    attributes[2] |= termios.HUPCL | termios.PARENB | termios.CSTOPB
    attributes[3] |= termios.ECHO | termios.ICANON
    termios.tcsetattr(device[1], termios.TCSANOW, attributes)
    assert termios.tcgetattr(device[1])[2] & termios.HUPCL
    fd = open_device(device[2], 57600)
    try:
        attributes = termios.tcgetattr(fd)
        assert not attributes[2] & (termios.HUPCL | termios.PARENB | termios.CSTOPB)
        assert attributes[2] & termios.CSIZE == termios.CS8
        assert attributes[2] & termios.CLOCAL and attributes[2] & termios.CREAD
        assert not attributes[3] & (termios.ECHO | termios.ICANON)
        assert attributes[4] == attributes[5] == termios.B57600
        assert not os.get_blocking(fd)
    finally:
        os.close(fd)


def test_earlier_input_is_dropped(device):
    os.write(device[0], b"stale")
    fd = open_device(device[2], 115200)
    try:
        with pytest.raises(BlockingIOError):
            os.read(fd, 100)
        os.write(device[0], b"fresh")
        os.set_blocking(fd, True)
        assert os.read(fd, 100) == b"fresh"
    finally:
        os.close(fd)


def test_a_failed_open_leaves_no_descriptor_open(device, monkeypatch):
    def refuse(fd, rate):
        raise BaudRateError(errno.EINVAL, f"descriptor {fd}")

    monkeypatch.setattr(module, "set_baud_rate", refuse)
    with pytest.raises(BaudRateError) as caught:
        open_device(device[2], 250_000)
    with pytest.raises(OSError):
        os.fstat(int(caught.value.strerror.split()[1]))
    assert reason(device[2], caught.value) == caught.value.strerror
    monkeypatch.undo()
    os.close(open_device(device[2], 250_000))  # and the lock is free


def test_a_pseudo_terminal_has_no_modem_lines_and_works_without(device):
    text = set_modem_lines(device[1], True, False)
    assert text == "dtr and rts as they are: this line has none"
    assert set_modem_lines(device[1], None, None) == ""


class Uart:
    """fcntl.ioctl of a UART whose lines are both up, as the system's open leaves them."""

    def __init__(self, number=0):
        self.lines, self.calls, self.number = DTR | RTS, 0, number

    def __call__(self, fd, request, data):
        self.calls += 1
        if self.number:
            raise OSError(self.number, os.strerror(self.number))
        (bits,) = struct.unpack("=I", data)
        if request == termios.TIOCMBIS:
            self.lines |= bits
        else:
            assert request == termios.TIOCMBIC
            self.lines &= ~bits
        return data


@pytest.mark.parametrize(
    ("dtr", "rts", "lines", "calls"),
    [
        (None, None, DTR | RTS, 0),
        (True, True, DTR | RTS, 1),
        (False, False, 0, 1),  # in one call: changing one line first resets an ESP32
        (False, None, RTS, 1),
        (True, False, DTR, 2),
        (None, True, DTR | RTS, 1),
    ],
)
def test_modem_lines(monkeypatch, dtr, rts, lines, calls):
    uart = Uart()
    monkeypatch.setattr(fcntl, "ioctl", uart)
    assert set_modem_lines(0, dtr, rts) == ""
    assert (uart.lines, uart.calls) == (lines, calls)


def test_a_removed_device_is_an_error(monkeypatch):
    monkeypatch.setattr(fcntl, "ioctl", Uart(errno.EIO))
    with pytest.raises(OSError):
        set_modem_lines(0, True, None)


def test_reasons():
    assert reason("/dev/x", OSError(errno.ENOENT, "")).startswith("errno: 2, it is not there")
    removed_error = termios.error(errno.ENOTTY, "x")
    assert reason("/dev/x", removed_error) == "errno: 25, this is not a serial device"
