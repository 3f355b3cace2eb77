"""The port of a board's program that runs on CPython and is at a terminal: a serial device."""

from __future__ import annotations

import errno
import os
import select
import termios

from .serial import check_baud_rate, open_device, trouble


class DevicePort:
    """For a :class:`~uros.transport.stream.StreamTransport`; nothing waits but :meth:`wait`.

    Raises TransportError for a baud rate that does not exist.
    """

    def __init__(self, path: str, baud: int = 115200) -> None:
        self.path = path
        self.fd = -1
        self._speed = check_baud_rate(baud)
        self._poll = select.poll()

    def open(self) -> None:
        """Raises OSError with a text that says what to do."""
        self.close()
        try:
            self.fd = open_device(self.path, self._speed)
        except (OSError, termios.error) as error:
            number = error.args[0] if error.args else 0
            raise OSError(number, trouble(self.path, number)) from error
        self._poll.register(self.fd, select.POLLIN)

    def close(self) -> None:
        """Twice is once."""
        if self.fd >= 0:
            self._poll.unregister(self.fd)
            os.close(self.fd)
            self.fd = -1

    def read(self, size: int) -> bytes | None:
        """See :class:`~uros.transport.stream.Port`."""
        try:
            data = os.read(self.fd, size)
        except BlockingIOError:
            return None
        if not data:
            raise OSError(errno.EIO, f"{self.path}: the line has ended")
        return data

    def write(self, data: bytes | bytearray | memoryview) -> int:
        """See :class:`~uros.transport.stream.Port`."""
        try:
            return os.write(self.fd, data)
        except BlockingIOError:
            return 0

    def wait(self, timeout_ms: int) -> None:
        """Until there is something to read, or that long."""
        self._poll.poll(timeout_ms)
