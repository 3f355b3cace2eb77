"""Explains errors of opening a line, with their remedies."""

from __future__ import annotations

import errno
import os
import sys

# Linux's; the module errno has no name for it before Python 3.14.
_ERFKILL = 132


def trouble(device: str, number: int) -> str:
    """Explain an errno of opening the serial device ``device``."""
    if sys.platform == "win32":
        return _windows(device, number)
    if number == errno.ENOENT:
        return "errno: 2, it is not there: plug the board in, or see what there is: ls /dev/tty*"
    if number == errno.EACCES:
        return (
            "errno: 13, not permitted: sudo usermod -aG dialout $USER, then log in again;"
            f" or for now: sudo chmod a+rw {device}"
        )
    if number in (errno.EBUSY, errno.EAGAIN):
        return (
            f"errno: {number}, in use by another program, perhaps a second agent:"
            f" see which with: fuser -v {device}"
        )
    if number in (errno.ENOTTY, errno.EINVAL, errno.EISDIR):
        return f"errno: {number}, this is not a serial device"
    return f"errno: {number}, {os.strerror(number)}"


def _windows(device: str, number: int) -> str:
    if number == errno.ENOENT:
        return (
            "errno: 2, it is not there: plug the board in, or see what there is:"
            " python -m serial.tools.list_ports"
        )
    if number == errno.EACCES:  # Windows: the port is open in another program
        return "errno: 13, in use by another program, perhaps a second agent: close it"
    return f"errno: {number}, {os.strerror(number)}"


def bluetooth_trouble(number: int) -> str:
    """Explain an errno of a Bluetooth socket."""
    text = {
        errno.EAFNOSUPPORT: "this kernel has no Bluetooth: sudo modprobe rfcomm (a container"
        " or a virtual machine may have none at all)",
        errno.EPROTONOSUPPORT: "this kernel has no RFCOMM: sudo modprobe rfcomm",
        errno.ENODEV: "no adapter: plug one in, and: bluetoothctl power on",
        errno.EADDRNOTAVAIL: "no such adapter: see what there is: bluetoothctl list",
        errno.ENETDOWN: "the adapter is off: bluetoothctl power on",
        errno.EHOSTUNREACH: "no adapter is on: bluetoothctl power on",
        _ERFKILL: "the adapter is blocked: rfkill unblock bluetooth",
        errno.EHOSTDOWN: "the board does not answer: switch it on, bring it near, and check that"
        " nothing else is connected to it",
        errno.ETIMEDOUT: "the board does not answer: switch it on, bring it near",
        errno.ECONNREFUSED: "nothing listens on this channel: see the board's: sdptool browse"
        " ADDRESS",
        errno.EACCES: "the board wants to be paired: bluetoothctl pair ADDRESS",
        errno.EPERM: "not permitted: pair the board first: bluetoothctl pair ADDRESS",
        errno.EADDRINUSE: "another program listens on this channel, perhaps a second agent:"
        " stop it, or choose another channel",
        errno.EBUSY: "another program is connected to this channel of the board: stop it",
    }.get(number)
    return f"errno: {number}, {text or os.strerror(number)}"


def socket_trouble(number: int) -> str:
    """Explain an errno of connecting to a serial line that another machine offers by TCP."""
    text = {
        errno.ECONNREFUSED: "nothing listens there: start the program that offers the line, or"
        " correct the port",
        errno.EHOSTUNREACH: "the machine does not answer: switch it on, or correct the address",
        errno.ENETUNREACH: "there is no route to it: check the network",
        errno.ETIMEDOUT: "the machine does not answer: switch it on, or correct the address",
    }.get(number)
    return f"errno: {number}, {text or os.strerror(number)}"
