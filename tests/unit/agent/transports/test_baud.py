"""Baud rates that termios names, and others, read back from a pseudo-terminal."""

import errno
import os
import struct
import termios
import tty

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from support.examples import examples

from uros.agent.transports import baud as module
from uros.agent.transports.base import TransportError
from uros.agent.transports.baud import (
    BAUD_RATES,
    MAX_BAUD,
    BaudRateError,
    check_baud_rate,
    set_baud_rate,
)

on_linux = pytest.mark.skipif(
    module._way() != "termios2", reason="not on this platform: Linux with termios2"
)


@pytest.fixture
def line():
    master, slave = os.openpty()
    tty.setraw(slave)
    yield slave
    os.close(master)
    os.close(slave)


def rates(fd):
    """Return the kernel's input and output rate."""
    flags = module._TERMIOS2.unpack(module.fcntl.ioctl(fd, module._TCGETS2, bytes(44)))
    return flags[5], flags[6]


@pytest.mark.parametrize("rate", [9600, 115200, 921600])
def test_a_rate_that_termios_names(line, rate):
    assert check_baud_rate(rate) == rate
    set_baud_rate(line, rate)
    attributes = termios.tcgetattr(line)
    assert attributes[4] == attributes[5] == BAUD_RATES[rate]


@on_linux
@pytest.mark.parametrize("rate", [250_000, 123_456, 7, MAX_BAUD])
def test_any_other_rate_and_back(line, rate):
    before = termios.tcgetattr(line)
    set_baud_rate(line, check_baud_rate(rate))
    assert rates(line) == (rate, rate)
    set_baud_rate(line, 115200)
    assert rates(line) == (115200, 115200)
    after = termios.tcgetattr(line)
    assert after[:2] == before[:2] and after[3] == before[3] and after[6] == before[6]
    assert after[2] & termios.CSIZE == before[2] & termios.CSIZE


@on_linux
def test_an_earlier_separate_input_rate_is_replaced(line):
    flags = list(module._TERMIOS2.unpack(module.fcntl.ioctl(line, module._TCGETS2, bytes(44))))
    custom_both = module._BOTHER | module._BOTHER << module._IBSHIFT
    flags[2] = flags[2] & ~(module._CBAUD | module._CBAUD << module._IBSHIFT) | custom_both
    flags[5] = flags[6] = 4321
    module.fcntl.ioctl(line, module._TCSETS2, module._TERMIOS2.pack(*flags))
    set_baud_rate(line, 57600)
    assert rates(line) == (57600, 57600)


@on_linux
@settings(max_examples=examples(100))
@given(st.integers())
def test_every_number_is_set_as_a_rate_or_refused(rate):
    if 0 < rate <= MAX_BAUD or rate in BAUD_RATES:
        assert check_baud_rate(rate) == rate
    else:
        with pytest.raises(TransportError, match=f"baud rate {rate} does not exist"):
            check_baud_rate(rate)


def test_a_machine_of_another_layout_lists_its_rates(monkeypatch):
    monkeypatch.setattr(module, "_PLATFORM", "linux")
    monkeypatch.setattr(module.os, "uname", lambda: os.uname_result(("Linux", "", "", "", "mips")))
    with pytest.raises(TransportError) as caught:
        check_baud_rate(250_000)
    assert "baud rate 250000 cannot be set on this machine (linux, mips); there are " in str(
        caught.value
    )
    assert "115200" in str(caught.value)
    assert check_baud_rate(115200) == 115200


class Kernel:
    """fcntl.ioctl of a driver that takes the rate ``took``, or refuses with ``number``."""

    def __init__(self, took=None, number=0):
        self.took, self.number, self.calls = took, number, []

    def __call__(self, fd, request, data):
        self.calls.append((request, bytes(data)))
        if self.number and request != module._TCGETS2:
            raise OSError(self.number, os.strerror(self.number))
        return struct.pack("=4I20s2I", 0, 0, 0, 0, bytes(20), self.took or 0, self.took or 0)


@pytest.mark.parametrize(("took", "fine"), [(250_000, True), (256_000, True), (115_200, False)])
def test_a_driver_that_sets_another_rate(line, monkeypatch, took, fine):
    monkeypatch.setattr(module, "_way", lambda: "termios2")
    monkeypatch.setattr(module.fcntl, "ioctl", Kernel(took))
    if fine:
        set_baud_rate(line, 250_000)
        return
    with pytest.raises(BaudRateError) as caught:
        set_baud_rate(line, 250_000)
    assert caught.value.strerror == (
        "the device does not support 250000 baud (it took 115200): choose a rate that it has"
    )


@pytest.mark.parametrize("way", ["termios2", "iossiospeed"])
def test_a_driver_that_refuses(line, monkeypatch, way):
    monkeypatch.setattr(module, "_way", lambda: way)
    monkeypatch.setattr(module.fcntl, "ioctl", Kernel(number=errno.EINVAL))
    with pytest.raises(BaudRateError, match="Invalid argument.*choose a rate"):
        set_baud_rate(line, 250_000)


def test_the_calls_on_macos(line, monkeypatch):
    kernel = Kernel()
    monkeypatch.setattr(module, "_PLATFORM", "darwin")
    monkeypatch.setattr(module.fcntl, "ioctl", kernel)
    set_baud_rate(line, check_baud_rate(250_000))
    assert kernel.calls == [(0x80045402, struct.pack("=I", 250_000))]


def test_a_system_whose_constants_are_the_rates(line, monkeypatch):
    calls = []
    monkeypatch.setattr(module, "_PLATFORM", "freebsd14")
    monkeypatch.setattr(module, "BAUD_RATES", {115200: 115200})
    monkeypatch.setattr(
        module.termios, "tcsetattr", lambda fd, when, attributes: calls.append(attributes)
    )
    set_baud_rate(line, check_baud_rate(250_000))
    assert calls[0][4] == calls[0][5] == 250_000
