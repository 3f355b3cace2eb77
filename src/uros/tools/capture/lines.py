"""The boards' ends of lines to an agent, for playing several boards in one thread."""

from __future__ import annotations

import os
import socket
from typing import Final, Protocol
from urllib.parse import parse_qs, urlsplit

from ...wire.framing import Deframer, LengthDeframer, frame, frame_size
from ..errors import ToolError

_LARGEST: Final = 65536
_SECONDS: Final = 5.0
_FORMS: Final = (
    "udp4://127.0.0.1:8888, udp6://[::1]:8888, tcp4://127.0.0.1:8888, tcp6://[::1]:8888 or"
    " serial:///dev/ttyUSB0?baudrate=115200"
)


class Line(Protocol):
    """One board's. ``read`` gives what there is, and waits for nothing."""

    def fileno(self) -> int: ...

    def send(self, message: bytes) -> None: ...

    def waits(self) -> bool:
        """Whether something was read already that :meth:`read` has not given."""

    def read(self) -> list[bytes]: ...

    def close(self) -> None: ...


class UdpLine:
    def __init__(self, family: socket.AddressFamily, address: tuple[str, int]) -> None:
        self._socket = socket.socket(family, socket.SOCK_DGRAM)
        self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4 << 20)
        self._socket.connect(address)
        self._socket.setblocking(False)

    def fileno(self) -> int:
        return self._socket.fileno()

    def send(self, message: bytes) -> None:
        try:
            self._socket.send(message)
        except OSError:
            pass  # nobody is there yet, or no room: what matters comes again

    def waits(self) -> bool:
        return False

    def read(self) -> list[bytes]:
        try:
            return [self._socket.recv(_LARGEST)]
        except OSError:
            return []

    def close(self) -> None:
        self._socket.close()


class TcpLine:
    def __init__(self, address: tuple[str, int]) -> None:
        self._socket = socket.create_connection(address, _SECONDS)
        self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._deframer = LengthDeframer()

    def fileno(self) -> int:
        return self._socket.fileno()

    def send(self, message: bytes) -> None:
        if len(message) > 0xFFFF:
            return
        try:
            self._socket.sendall(len(message).to_bytes(2, "little") + message)
        except OSError as error:
            raise ToolError(f"the agent takes nothing any more: {error.strerror}") from error

    def waits(self) -> bool:
        return False

    def read(self) -> list[bytes]:
        try:
            chunk = self._socket.recv(_LARGEST)
        except OSError:
            chunk = b""
        if not chunk:
            raise ToolError("the agent has closed the connection")
        return self._deframer.feed(chunk)

    def close(self) -> None:
        self._socket.close()


class SerialLine:
    """One serial line, which all boards share: each has an address on it, from 1 on."""

    def __init__(self, device: str, baudrate: int) -> None:
        from ...agent.transports.terminal import open_device

        self._fd = open_device(device, baudrate)
        self._boards: dict[int, SharedLine] = {}

    def board(self, address: int) -> SharedLine:
        """The line of one board."""
        found = self._boards[address] = SharedLine(self, address)
        return found

    def fileno(self) -> int:
        return self._fd

    def send(self, address: int, message: bytes) -> None:
        import select

        out = bytearray(frame_size(message))
        left = memoryview(out)[: frame(message, address, 0, out)]
        while left:
            if not select.select([], [self._fd], [], _SECONDS)[1]:
                raise ToolError("the serial line takes nothing: does the agent read there?")
            try:
                left = left[os.write(self._fd, left) :]
            except OSError as error:
                raise ToolError(f"the serial line is gone: {error.strerror}") from error

    def read(self) -> None:
        """Hand what has come to the boards."""
        try:
            chunk = os.read(self._fd, _LARGEST)
        except BlockingIOError:
            return
        except OSError:
            chunk = b""
        if not chunk:
            raise ToolError("the serial line has ended")
        for board in self._boards.values():
            board.messages.extend(board.deframer.feed(chunk))

    def close(self) -> None:
        if self._fd >= 0:
            os.close(self._fd)
            self._fd = -1


class SharedLine:
    """One board on a serial line."""

    def __init__(self, line: SerialLine, address: int) -> None:
        self._line = line
        self._address = address
        self.deframer = Deframer(address)
        self.messages: list[bytes] = []

    def fileno(self) -> int:
        return self._line.fileno()

    def send(self, message: bytes) -> None:
        if len(message) <= 0xFFFF:
            self._line.send(self._address, message)

    def waits(self) -> bool:
        return bool(self.messages)

    def read(self) -> list[bytes]:
        if not self.messages:
            self._line.read()
        found, self.messages = self.messages, []
        return found

    def close(self) -> None:
        self._line.close()


class Lines:
    """Makes the lines to the agent at ``where``. Raises ToolError."""

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
                raise self._no_address("its baudrate is no number")
        elif self._kind not in known or not self._host or not self._port:
            raise self._no_address("it says not which transport, host and port")
        self._baudrate = int(baudrate)
        self._serial: SerialLine | None = None

    def _no_address(self, why: str) -> ToolError:
        return ToolError(f"{self.where!r} is no address of an agent ({why}): write {_FORMS}")

    def line(self, client: int) -> Line:
        """A line for one more board. Raises ToolError."""
        try:
            if self._kind == "serial":
                return self._serial_line().board(client % 255 + 1)
            six = self._kind.endswith("6")
            family = socket.AF_INET6 if six else socket.AF_INET
            found = socket.getaddrinfo(self._host, self._port, family, socket.SOCK_DGRAM)
            address = found[0][4][:2]
            where = (str(address[0]), int(address[1]))
            return UdpLine(family, where) if self._kind.startswith("udp") else TcpLine(where)
        except (OSError, UnicodeError) as error:
            why = getattr(error, "strerror", None) or str(error)
            raise ToolError(
                f"there is no way to {self.where}: {why} (is the agent there?)"
            ) from error

    def _serial_line(self) -> SerialLine:
        if self._serial is None:
            import termios

            try:
                self._serial = SerialLine(self._device, self._baudrate)
            except termios.error as error:
                raise OSError(error.args[0], error.args[-1]) from error
        return self._serial
