"""Serial lines at the agent's end: serial devices, and a pseudo-terminal.

A device that is missing, not permitted or unplugged is opened again and again: a board that is
plugged in again continues its session. :func:`serial_server` chooses the transport of a device;
this module can be imported on systems without termios.
"""

from __future__ import annotations

import errno
import os
from collections.abc import Callable
from importlib.util import find_spec

from .base import INFO, Host, ServerTransport, TransportError
from .line import FileStream, LineServer
from .serial_device import DeviceServer as DeviceServer
from .serial_device import is_url as is_url

if find_spec("termios") is not None:
    import termios
    import tty

    from .baud import check_baud_rate
    from .terminal import open_device, open_pseudo_terminal, reason, set_modem_lines


def has_termios() -> bool:
    """Return whether this system has termios: all but Windows."""
    return find_spec("termios") is not None


def serial_server(
    device: str, baud: int = 115200, is_file: bool = False, dtr: bool | None = None,
    rts: bool | None = None,
) -> ServerTransport:  # fmt: skip
    """Make the transport for a serial device or URL.

    ``socket://`` uses a TCP socket, other URLs and systems without termios need pyserial, anything
    else is a :class:`SerialServer`. A device that is missing is opened later.

    Args:
        device: A path, or a URL.
        baud: Baud rate.
        is_file: Whether ``device`` is a file that holds the name of the device.
        dtr: Raise (True) or drop (False) DTR after opening; None leaves it to the system.
        rts: The same for RTS.

    Raises:
        TransportError: The device can never be opened with these arguments.
    """
    if not is_file and device.startswith("socket://"):
        from .sockets import tcp_line

        return tcp_line(device)
    if has_termios() and (is_file or not is_url(device)):
        return SerialServer(device, baud, is_file, dtr, rts)
    from .portable_serial import PySerialServer

    return PySerialServer(device, baud, is_file, dtr, rts)


class SerialServer(DeviceServer):
    """A serial device by termios; see :class:`DeviceServer`."""

    def __init__(
        self, device: str, baud: int = 115200, is_file: bool = False, dtr: bool | None = None,
        rts: bool | None = None,
    ) -> None:  # fmt: skip
        if not has_termios():
            raise TransportError(
                errno.ENOSYS, "this system has no termios: use serial_server, and install pyserial"
            )
        super().__init__(device, check_baud_rate(baud), is_file, dtr, rts)

    def _begin(self, host: Host) -> None:
        try:
            path = self._path()
            fd = open_device(path, self._baud)
            try:
                lines = set_modem_lines(fd, self._dtr, self._rts)
            except OSError:
                os.close(fd)
                raise
        except ValueError:  # a NUL in the name
            self._wait(errno.EINVAL, reason(self.device, OSError(errno.EINVAL, "")))
            return
        except (OSError, termios.error) as error:
            number = error.args[0] if error.args and isinstance(error.args[0], int) else 0
            self._wait(number, reason(self.device, error))
            return
        about = f"dev: {path}, baudrate: {self._baud}"
        self._opened(FileStream(fd), f"{about}, {lines}" if lines else about)


class _Master(FileStream):
    """The master of a pseudo-terminal, which stays open when programs close the other end.

    ``opened`` is called when bytes arrive, ``closed`` when no program has it open any more.
    """

    __slots__ = ("_closed", "_opened")

    def __init__(self, fd: int, opened: Callable[[], None], closed: Callable[[], None]) -> None:
        super().__init__(fd)
        self._opened = opened
        self._closed = closed

    def read(self, size: int) -> bytes:
        try:
            chunk = super().read(size)
        except BlockingIOError:
            raise
        except OSError as error:
            if error.errno != errno.EIO:
                raise
            chunk = b""  # Linux raises EIO, other systems return the end of file
        if not chunk:
            self._closed()
            raise BlockingIOError
        self._opened()
        return chunk


class PseudoTerminalServer(LineServer):
    """A pseudo-terminal: a program opens the device whose name is in the log.

    While no program has it open the agent holds it open, so that it stays the same device. When
    bytes arrive the agent closes its own descriptor, as only then the system reports when the
    program closes the device.
    """

    name = "PseudoTtyAgent"
    lasting = False  # the device has another name each time

    def __init__(self, baud: int = 115200) -> None:
        super().__init__("")
        if not hasattr(os, "openpty"):
            raise TransportError(
                errno.ENOSYS,
                "this system has no pseudo-terminals: use udp4, tcp4 or serial (on Windows a"
                " pair of virtual COM ports does the same)",
            )
        check_baud_rate(baud)
        self._slave = -1
        self._left = False  # a program opened it and has closed it

    def _begin(self, host: Host) -> None:
        try:
            master, slave = open_pseudo_terminal()
        except OSError as error:
            raise TransportError(
                error.errno, f"no pseudo-terminal can be opened: {error.strerror}"
            ) from error
        tty.setraw(slave)
        os.set_blocking(master, False)
        self._close_slave()
        self._slave = slave
        self.device = self.line.label = os.ttyname(slave)
        self._left = False
        stream = _Master(master, self._program_speaks, self._program_left)
        self._opened(stream, f"dev: {self.device}")

    def _program_speaks(self) -> None:
        self._left = False
        self._close_slave()

    def _program_left(self) -> None:
        self._slave = os.open(self.device, os.O_RDWR | os.O_NOCTTY)
        tty.setraw(self._slave)
        self._left = True
        if self._host is not None:
            self._host.note(
                INFO, self.name, "receive", "device closed",
                f"device: {self.device}, no program has it open; waiting for one",
            )  # fmt: skip
            self._host.lost(self)

    def is_away(self, peer: int) -> bool:
        """Return whether no program has the device open."""
        return self._left or super().is_away(peer)

    def close(self) -> None:
        """Close everything; idempotent."""
        super().close()
        self._close_slave()

    def _close_slave(self) -> None:
        if self._slave >= 0:
            os.close(self._slave)
            self._slave = -1
