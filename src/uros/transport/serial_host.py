"""Port of a :class:`~uros.transport.serial.StreamTransport` on CPython: a serial device."""

from __future__ import annotations

import errno
import os
import select
from typing import Protocol

from ..agent.transports.serial import has_termios, is_url

if has_termios():
    import termios

    from ..agent.transports.baud import check_baud_rate
    from ..agent.transports.terminal import open_device, reason


class OpenPort(Protocol):
    """A :class:`~uros.transport.serial.Port` with its optional methods."""

    def open(self) -> None:
        """Open the device. Raises OSError."""

    def close(self) -> None:
        """Close the device; idempotent."""

    def read(self, size: int) -> bytes | None:
        """See :class:`~uros.transport.serial.Port`."""

    def write(self, data: bytes | bytearray | memoryview) -> int:
        """See :class:`~uros.transport.serial.Port`."""

    def wait(self, timeout_ms: int) -> None:
        """Wait until there is something to read, for ``timeout_ms`` at most."""


def device_port(path: str, baud: int = 115200) -> OpenPort:
    """Return the port for ``path``: pyserial's for a URL or on systems without termios.

    Raises:
        TransportError: The path or baud rate can never work.
    """
    if has_termios() and not is_url(path):
        return DevicePort(path, baud)
    from ..agent.transports.portable_serial import PySerialPort

    return PySerialPort(path, baud)


class DevicePort:
    """A serial device, by termios; only :meth:`wait` waits.

    Raises:
        TransportError: The baud rate is not possible.
    """

    def __init__(self, path: str, baud: int = 115200) -> None:
        self.path = path
        self.fd = -1
        self._baud = check_baud_rate(baud)
        self._poll = select.poll()

    def open(self) -> None:
        """Open the device. Raises OSError with the remedy."""
        self.close()
        try:
            self.fd = open_device(self.path, self._baud)
        except (OSError, termios.error) as error:
            raise OSError(error.args[0], reason(self.path, error)) from error
        self._poll.register(self.fd, select.POLLIN)

    def close(self) -> None:
        """Close the device; idempotent."""
        if self.fd >= 0:
            self._poll.unregister(self.fd)
            os.close(self.fd)
            self.fd = -1

    def read(self, size: int) -> bytes | None:
        """See :class:`~uros.transport.serial.Port`."""
        try:
            data = os.read(self.fd, size)
        except BlockingIOError:
            return None
        if not data:
            raise OSError(errno.EIO, f"{self.path}: the line has ended")
        return data

    def write(self, data: bytes | bytearray | memoryview) -> int:
        """See :class:`~uros.transport.serial.Port`."""
        try:
            return os.write(self.fd, data)
        except BlockingIOError:
            return 0

    def wait(self, timeout_ms: int) -> None:
        """Wait until there is something to read, for ``timeout_ms`` at most."""
        self._poll.poll(timeout_ms)
