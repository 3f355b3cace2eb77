"""Baud rates of serial devices: those that termios names, and any other.

Linux takes any number by TCSETS2, macOS by IOSSIOSPEED. On the BSDs the constants are the rates
themselves, so any number works. POSIX only: it imports termios.
"""

from __future__ import annotations

import errno
import fcntl
import os
import struct
import sys
import termios
from typing import Any, Final

from .base import TransportError

# No UART is faster; a number of over 32 bits would be a struct.error.
MAX_BAUD: Final = 50_000_000

BAUD_RATES: Final = {
    int(name[1:]): int(getattr(termios, name))
    for name in dir(termios)
    if name.startswith("B") and name[1:].isdigit() and name != "B0"
}

# struct termios2 of Linux's asm-generic: four flags, the discipline, 19 control characters,
# and the speeds in and out. Other architectures lay it out otherwise, or have none.
_TERMIOS2: Final = struct.Struct("=4I20s2I")
_TCGETS2: Final = 0x802C542A
_TCSETS2: Final = 0x402C542B
_CBAUD: Final = 0o010017
_IBSHIFT: Final = 16
_BOTHER: Final = 0o010000
_GENERIC: Final = ("x86_64", "amd64", "i386", "i486", "i586", "i686", "arm", "aarch64", "riscv",
                   "loongarch", "s390")  # fmt: skip
_IOSSIOSPEED: Final = 0x80045402
_PLATFORM: Final = str(sys.platform)

# A UART tolerates a rate that is so far off, in percent; beyond, bits are read wrong.
_TOLERANCE: Final = 3


class BaudRateError(OSError):
    """The device does not support this rate; the text has the remedy."""


def check_baud_rate(rate: int) -> int:
    """Return ``rate`` if this machine can set it; raises TransportError with the remedy."""
    if rate in BAUD_RATES:
        return rate
    if not 0 < rate <= MAX_BAUD:
        raise TransportError(
            errno.EINVAL,
            f"baud rate {rate} does not exist: 1 to {MAX_BAUD}, such as 115200 or 921600",
        )
    if _way() is None:
        rates = ", ".join(str(each) for each in sorted(BAUD_RATES))
        raise TransportError(
            errno.EINVAL,
            f"baud rate {rate} cannot be set on this machine ({_PLATFORM},"
            f" {os.uname().machine}); there are {rates}",
        )
    return rate


def _way() -> str | None:
    """Return how this system sets a rate without a constant; None if it cannot."""
    if _PLATFORM.startswith("linux"):
        return "termios2" if os.uname().machine.lower().startswith(_GENERIC) else None
    if _PLATFORM == "darwin":
        return "iossiospeed"
    return "number" if BAUD_RATES.get(115200) == 115200 else None


def set_baud_rate(fd: int, rate: int) -> None:
    """Set a rate that check_baud_rate returned, for input and output, and nothing else.

    It must be set last: on macOS, any later setting resets the rate. Raises OSError or
    termios.error; BaudRateError if the device set another rate.
    """
    way = None if rate in BAUD_RATES else _way()
    attributes: list[Any] = termios.tcgetattr(fd)
    if way == "termios2":
        _set_termios2(fd, rate)
        return
    # A separate input rate would stay: 0 means that of the output.
    attributes[2] &= ~getattr(termios, "CIBAUD", 0)
    if way == "iossiospeed":
        attributes[4] = attributes[5] = termios.B9600
    else:
        attributes[4] = attributes[5] = BAUD_RATES.get(rate, rate)
    termios.tcsetattr(fd, termios.TCSANOW, attributes)
    if way == "iossiospeed":
        try:
            fcntl.ioctl(fd, _IOSSIOSPEED, struct.pack("=I", rate))
        except OSError as error:
            raise _refused(rate, os.strerror(error.errno or 0)) from error


def _set_termios2(fd: int, rate: int) -> None:
    flags = list(_TERMIOS2.unpack(fcntl.ioctl(fd, _TCGETS2, bytes(_TERMIOS2.size))))
    flags[2] = flags[2] & ~(_CBAUD | _CBAUD << _IBSHIFT) | _BOTHER
    flags[5] = flags[6] = rate
    try:
        fcntl.ioctl(fd, _TCSETS2, _TERMIOS2.pack(*flags))
    except OSError as error:
        raise _refused(rate, os.strerror(error.errno or 0)) from error
    took = baud_rate(fd)
    if abs(took - rate) * 100 > rate * _TOLERANCE:
        raise _refused(rate, f"it took {took}")


def baud_rate(fd: int) -> int:
    """Return the rate of a Linux device; raises OSError if it has none."""
    return int(_TERMIOS2.unpack(fcntl.ioctl(fd, _TCGETS2, bytes(_TERMIOS2.size)))[6])


def _refused(rate: int, why: str) -> BaudRateError:
    return BaudRateError(
        errno.EINVAL, f"the device does not support {rate} baud ({why}): choose a rate that it has"
    )
