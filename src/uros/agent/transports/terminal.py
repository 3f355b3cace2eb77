"""Serial devices by termios: opening them, and their modem lines. POSIX only.

Effects on a board: opening a device raises DTR and RTS (the system does that, and it cannot be
prevented), and they stay up when it is closed, because HUPCL is cleared, as in the C++ agent. An
Arduino-style board is reset when DTR rises: once, when the device is opened for the first time
after it was plugged in or after a program that lets DTR fall, and not each time that the agent is
started. ESP32 boards with the usual two transistors run as long as both are equal, so both up is
right for them. Boards with native USB (RA4M1, RP2040, TinyUSB) send only while DTR is up.

So leave ``dtr`` and ``rts`` None unless a board needs otherwise: False for a circuit
that holds the board in reset or in its bootloader while the line is up.
"""

from __future__ import annotations

import errno
import fcntl
import os
import struct
import termios
import tty
from typing import Any

from .baud import BaudRateError, set_baud_rate
from .remedies import trouble


def open_device(path: str, baud: int) -> int:
    """Open a serial device exclusively, raw and non-blocking; return its descriptor.

    Bytes received before are dropped. ``baud`` is a result of check_baud_rate. Raises OSError or
    termios.error, which :func:`reason` explains.
    """
    fd = os.open(path, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
    try:
        fcntl.flock(fd, fcntl.LOCK_EX | fcntl.LOCK_NB)
        tty.setraw(fd)
        attributes: list[Any] = termios.tcgetattr(fd)
        attributes[2] |= termios.CREAD | termios.CLOCAL | termios.CS8
        attributes[2] &= ~(
            termios.PARENB | termios.CSTOPB | termios.HUPCL | getattr(termios, "CRTSCTS", 0)
        )
        termios.tcsetattr(fd, termios.TCSANOW, attributes)
        set_baud_rate(fd, baud)
        termios.tcflush(fd, termios.TCIOFLUSH)
    except BaseException:
        os.close(fd)
        raise
    return fd


def open_pseudo_terminal() -> tuple[int, int]:
    """Open a pseudo-terminal; return the descriptors of its master and its slave.

    Raises:
        OSError: There is none to open. Linux says ENODEV where /dev/pts is not mounted, of which
            the text names the remedy.
    """
    try:
        return os.openpty()
    except OSError as error:
        if error.errno != errno.ENODEV:
            raise
        raise FileNotFoundError(
            errno.ENOENT, "pseudo-terminals are not mounted at /dev/pts; in a chroot: mount --bind"
            " /dev/pts FOLDER/dev/pts"
        ) from error  # fmt: skip


def set_modem_lines(fd: int, dtr: bool | None, rts: bool | None) -> str:
    """Raise (True) or drop (False) DTR and RTS; None leaves a line as it is.

    Devices without modem lines (a pseudo-terminal, some USB devices) work, so that is no error.
    Returns a text for the log about that, "" if the lines were set. Raises OSError when the
    device was removed.
    """
    up = down = 0
    for raised, bit in ((dtr, termios.TIOCM_DTR), (rts, termios.TIOCM_RTS)):
        if raised is not None:
            up |= bit if raised else 0
            down |= 0 if raised else bit
    try:
        # One call changes both lines, because an ESP32's circuit resets the board if one line
        # changes before the other.
        if up:
            fcntl.ioctl(fd, termios.TIOCMBIS, struct.pack("=I", up))
        if down:
            fcntl.ioctl(fd, termios.TIOCMBIC, struct.pack("=I", down))
    except OSError as error:
        if error.errno in (errno.ENOTTY, errno.EINVAL):
            return "dtr and rts as they are: this line has none"
        raise
    return ""


def reason(device: str, error: Exception) -> str:
    """Explain an error of opening ``device``, with its remedy."""
    if isinstance(error, BaudRateError):
        return str(error.strerror)
    number = error.args[0] if error.args and isinstance(error.args[0], int) else 0
    return trouble(device, number)
