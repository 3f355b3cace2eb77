"""The port of a board's program that runs on CPython and is at a terminal: a serial device."""

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
    """A :class:`~uros.transport.serial.Port` with everything that it may have."""

    def open(self) -> None: ...
    def close(self) -> None: ...
    def read(self, size: int) -> bytes | None: ...
    def write(self, data: bytes | bytearray | memoryview) -> int: ...
    def wait(self, timeout_ms: int) -> None: ...


def device_port(path: str, baud: int = 115200) -> OpenPort:
    """The port for ``path``: pyserial's for a URL or where there is no termios.

    Raises TransportError for what will never work.
    """
    if has_termios() and not is_url(path):
        return DevicePort(path, baud)
    from ..agent.transports.portable_serial import PySerialPort

    return PySerialPort(path, baud)


class DevicePort:
    """For a :class:`~uros.transport.serial.StreamTransport`; nothing waits but :meth:`wait`.

    Raises TransportError for a baud rate that cannot be.
    """

    def __init__(self, path: str, baud: int = 115200) -> None:
        self.path = path
        self.fd = -1
        self._baud = check_baud_rate(baud)
        self._poll = select.poll()

    def open(self) -> None:
        """Raises OSError with a text that says what to do."""
        self.close()
        try:
            self.fd = open_device(self.path, self._baud)
        except (OSError, termios.error) as error:
            raise OSError(error.args[0], reason(self.path, error)) from error
        self._poll.register(self.fd, select.POLLIN)

    def close(self) -> None:
        """Twice is once."""
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
        """Until there is something to read, or that long."""
        self._poll.poll(timeout_ms)
