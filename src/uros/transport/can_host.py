"""Port of a :class:`~uros.transport.can.CanTransport` on CPython: python-can."""

from __future__ import annotations

import errno
from typing import Any

from ..agent.transports.can import CHANNEL_GONE, python_can


class CanPort:
    """A CAN interface; only :meth:`wait` waits.

    Args:
        channel: The interface's name, such as ``can0``.
        interface: The type of python-can's interface.
        options: More options of python-can; ``can_filters`` drops the frames of other boards.
    """

    def __init__(self, channel: str, interface: str = "socketcan", **options: Any) -> None:
        self._options = {"channel": channel, "interface": interface, "fd": True} | options
        self._can: Any = None
        self._bus: Any = None
        self._next: Any = None

    def open(self) -> None:
        """Open the bus. Raises OSError with the reason."""
        self.close()
        self._can = python_can()
        try:
            self._bus = self._can.Bus(**self._options)
        except Exception as error:  # drivers raise any exception
            raise OSError(
                getattr(error, "errno", None) or errno.ENODEV,
                f"{self._options['channel']}: {error}",
            ) from error

    def close(self) -> None:
        """Close the bus; idempotent."""
        bus, self._bus = self._bus, None
        self._next = None
        if bus is not None:
            bus.shutdown()

    def send(self, can_id: int, data: bytes | bytearray | memoryview) -> bool:
        """See :class:`~uros.transport.can.Port`."""
        try:
            self._bus.send(
                self._can.Message(
                    arbitration_id=can_id, is_extended_id=True, is_fd=True, data=data, check=False
                ),
                timeout=0,
            )
        except self._can.CanError as error:
            if error.error_code in CHANNEL_GONE:
                raise OSError(error.error_code, str(error)) from error
            return False
        return True

    def recv(self) -> tuple[int, bytearray] | None:
        """See :class:`~uros.transport.can.Port`."""
        self._fill(0)
        message, self._next = self._next, None
        return None if message is None else (message.arbitration_id, message.data)

    def wait(self, timeout_ms: int) -> None:
        """Wait until there is a frame, for ``timeout_ms`` at most."""
        self._fill(timeout_ms / 1000)

    def _fill(self, timeout: float) -> None:
        if self._next is None:
            try:
                message = self._bus.recv(timeout)
            except self._can.CanError as error:
                raise OSError(error.error_code or errno.EIO, str(error)) from error
            if (
                message is not None
                and message.is_extended_id
                and not message.is_remote_frame
                and not message.is_error_frame
            ):
                self._next = message
