"""Errors of opening a line name the remedy."""

import errno
import os

import pytest

from uros.agent.transports import remedies
from uros.agent.transports.remedies import bluetooth_trouble, socket_trouble, trouble


def test_serial_devices():
    assert trouble("/dev/x", errno.EACCES).startswith("errno: 13, not permitted")
    assert trouble("/dev/x", errno.EIO) == f"errno: {errno.EIO}, {os.strerror(errno.EIO)}"
    assert "fuser -v /dev/x" in trouble("/dev/x", errno.EBUSY)


def test_serial_devices_of_windows(monkeypatch):
    monkeypatch.setattr(remedies.sys, "platform", "win32")
    assert "serial.tools.list_ports" in trouble("COM9", errno.ENOENT)
    assert "in use by another program" in trouble("COM9", errno.EACCES)
    assert trouble("COM9", errno.EIO).startswith(f"errno: {errno.EIO}, ")


@pytest.mark.parametrize(
    ("number", "remedy"),
    [
        (errno.EAFNOSUPPORT, "modprobe"),
        (errno.EHOSTDOWN, "switch it on"),
        (errno.EHOSTUNREACH, "bluetoothctl power on"),
        (errno.ENODEV, "bluetoothctl power on"),
        (errno.ECONNREFUSED, "sdptool browse"),
        (errno.EADDRINUSE, "another channel"),
        (132, "rfkill unblock"),
    ],
)
def test_bluetooth(number, remedy):
    assert bluetooth_trouble(number).startswith(f"errno: {number}, ")
    assert remedy in bluetooth_trouble(number)


def test_errors_without_a_remedy_have_their_name():
    for explain in (bluetooth_trouble, socket_trouble):
        assert explain(errno.EIO) == f"errno: {errno.EIO}, {os.strerror(errno.EIO)}"
    assert "start the program" in socket_trouble(errno.ECONNREFUSED)
