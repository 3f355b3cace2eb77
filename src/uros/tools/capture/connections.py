"""Connections of boards to an agent over UDP, TCP and serial lines, for several in one thread."""

from __future__ import annotations

import os
import socket
from typing import Final, Protocol
from urllib.parse import parse_qs, urlsplit

from ...wire.framing import Deframer, LengthDeframer, frame, frame_size
from ..errors import ToolError

_LARGEST: Final = 65536
_TIMEOUT: Final = 5.0  # of connecting and of writing, in seconds
_FORMS: Final = (
    "udp4://127.0.0.1:8888, udp6://[::1]:8888, tcp4://127.0.0.1:8888, tcp6://[::1]:8888 or"
    " serial:///dev/ttyUSB0?baudrate=115200"
)


class Connection(Protocol):
    """The connection of one board to the agent. No method blocks for a message."""

    def fileno(self) -> int:
        """The descriptor to select for reading."""

    def send(self, message: bytes) -> None:
        """Send one XRCE message.

        Raises:
            ToolError: The connection is lost.
        """

    def has_messages(self) -> bool:
        """Whether messages wait here that no descriptor announces."""

    def read(self) -> list[bytes]:
        """Return the messages that have arrived.

        Raises:
            ToolError: The connection is lost.
        """

    def close(self) -> None:
        """Close the connection."""


class UdpConnection:
    """A UDP socket: each datagram is a message. See :class:`Connection`."""

    def __init__(self, family: socket.AddressFamily, address: tuple[str, int]) -> None:
        self._socket = socket.socket(family, socket.SOCK_DGRAM)
        self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4 << 20)
        self._socket.connect(address)
        self._socket.setblocking(False)

    def fileno(self) -> int:
        """See :class:`Connection`."""
        return self._socket.fileno()

    def send(self, message: bytes) -> None:
        """See :class:`Connection`."""
        try:
            self._socket.send(message)
        except OSError:
            pass  # no agent yet, or a full buffer: reliable streams repeat what is lost

    def has_messages(self) -> bool:
        """See :class:`Connection`."""
        return False

    def read(self) -> list[bytes]:
        """See :class:`Connection`."""
        try:
            return [self._socket.recv(_LARGEST)]
        except OSError:
            return []

    def close(self) -> None:
        """See :class:`Connection`."""
        self._socket.close()


class TcpConnection:
    """A TCP connection: each message follows its length. See :class:`Connection`."""

    def __init__(self, address: tuple[str, int]) -> None:
        self._socket = socket.create_connection(address, _TIMEOUT)
        self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._deframer = LengthDeframer()

    def fileno(self) -> int:
        """See :class:`Connection`."""
        return self._socket.fileno()

    def send(self, message: bytes) -> None:
        """See :class:`Connection`."""
        if len(message) > 0xFFFF:
            return
        try:
            self._socket.sendall(len(message).to_bytes(2, "little") + message)
        except OSError as error:
            raise ToolError(f"the connection to the agent is lost: {error.strerror}") from error

    def has_messages(self) -> bool:
        """See :class:`Connection`."""
        return False

    def read(self) -> list[bytes]:
        """See :class:`Connection`."""
        try:
            chunk = self._socket.recv(_LARGEST)
        except OSError:
            chunk = b""
        if not chunk:
            raise ToolError("the agent has closed the connection")
        return self._deframer.feed(chunk)

    def close(self) -> None:
        """See :class:`Connection`."""
        self._socket.close()


class SerialPort:
    """A serial port that all boards share. Each has an address on it, from 1 on."""

    def __init__(self, device: str, baudrate: int) -> None:
        from ...agent.transports.terminal import open_device

        self._fd = open_device(device, baudrate)
        self._boards: dict[int, SerialConnection] = {}

    def board(self, address: int) -> SerialConnection:
        """Return the connection of the board with this address."""
        found = self._boards[address] = SerialConnection(self, address)
        return found

    def fileno(self) -> int:
        """See :class:`Connection`."""
        return self._fd

    def send(self, address: int, message: bytes) -> None:
        """See :class:`Connection`."""
        import select

        out = bytearray(frame_size(message))
        left = memoryview(out)[: frame(message, address, 0, out)]
        while left:
            if not select.select([], [self._fd], [], _TIMEOUT)[1]:
                raise ToolError("the serial line takes no more bytes: does the agent read from it?")
            try:
                left = left[os.write(self._fd, left) :]
            except OSError as error:
                raise ToolError(f"the serial line is lost: {error.strerror}") from error

    def read(self) -> None:
        """Read the port and hand the messages to the boards."""
        try:
            chunk = os.read(self._fd, _LARGEST)
        except BlockingIOError:
            return
        except OSError:
            chunk = b""
        if not chunk:
            raise ToolError("the serial line was closed")
        for board in self._boards.values():
            board.messages.extend(board.deframer.feed(chunk))

    def close(self) -> None:
        """See :class:`Connection`."""
        if self._fd >= 0:
            os.close(self._fd)
            self._fd = -1


class SerialConnection:
    """One board on a serial port. See :class:`Connection`."""

    def __init__(self, port: SerialPort, address: int) -> None:
        self._port = port
        self._address = address
        self.deframer = Deframer(address)
        self.messages: list[bytes] = []

    def fileno(self) -> int:
        """See :class:`Connection`."""
        return self._port.fileno()

    def send(self, message: bytes) -> None:
        """See :class:`Connection`."""
        if len(message) <= 0xFFFF:
            self._port.send(self._address, message)

    def has_messages(self) -> bool:
        """See :class:`Connection`."""
        return bool(self.messages)

    def read(self) -> list[bytes]:
        """See :class:`Connection`."""
        if not self.messages:
            self._port.read()
        found, self.messages = self.messages, []
        return found

    def close(self) -> None:
        """See :class:`Connection`."""
        self._port.close()


class Connections:
    """Opens connections to the agent at ``where``, an address such as ``udp4://127.0.0.1:8888``.

    Raises:
        ToolError: ``where`` is not an address of an agent.
    """

    def __init__(self, where: str) -> None:
        self.where = where
        try:
            parts = urlsplit(where)
            self._kind, self._host, self._port = parts.scheme, parts.hostname, parts.port
            self._device = parts.path
            baudrate = parse_qs(parts.query).get("baudrate", ["115200"])[0]
        except ValueError as error:
            raise self._no_address(str(error)) from error
        known = ("udp4", "udp6", "tcp4", "tcp6")
        if self._kind == "serial":
            if not self._device or self._host:
                raise self._no_address("it names no device")
            if not baudrate.isdecimal() or not 0 < int(baudrate) <= 50_000_000:
                raise self._no_address("its baudrate is not a number")
        elif self._kind not in known or not self._host or not self._port:
            raise self._no_address("transport, host or port is missing")
        self._baudrate = int(baudrate)
        self._serial: SerialPort | None = None

    def _no_address(self, why: str) -> ToolError:
        return ToolError(f"{self.where!r} is not an address of an agent ({why}): use {_FORMS}")

    def connect(self, client: int) -> Connection:
        """Connect one more board.

        Args:
            client: The client's number in the capture; it makes the address on a serial line.

        Raises:
            ToolError: The agent cannot be reached.
        """
        try:
            if self._kind == "serial":
                return self._serial_port().board(client % 255 + 1)
            six = self._kind.endswith("6")
            family = socket.AF_INET6 if six else socket.AF_INET
            found = socket.getaddrinfo(self._host, self._port, family, socket.SOCK_DGRAM)
            address = found[0][4][:2]
            where = (str(address[0]), int(address[1]))
            if self._kind.startswith("udp"):
                return UdpConnection(family, where)
            return TcpConnection(where)
        except (OSError, UnicodeError) as error:
            why = getattr(error, "strerror", None) or str(error)
            raise ToolError(
                f"cannot connect to {self.where}: {why}; is the agent running?"
            ) from error

    def _serial_port(self) -> SerialPort:
        if self._serial is None:
            import termios

            try:
                self._serial = SerialPort(self._device, self._baudrate)
            except termios.error as error:
                raise OSError(error.args[0], error.args[-1]) from error
        return self._serial
