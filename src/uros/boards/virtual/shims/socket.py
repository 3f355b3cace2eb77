# mypy: disable-error-code="no-any-return"
"""MicroPython's ``socket`` on a board with a radio: non-blocking UDP and TCP clients."""

import struct

import _board  # type: ignore[import-not-found]

AF_INET = 2
SOCK_STREAM = 1
SOCK_DGRAM = 2
IPPROTO_TCP = 6
TCP_NODELAY = 1
_STREAM_POLL = 3

try:
    _board.number(_board.WLAN_STATUS)
except OSError:  # firmware for boards without a radio lacks this module
    _why = _board.call(_board.ADVICE, bytes((_board.WLAN_STATUS,))).decode()
    raise ImportError("no module named 'socket': " + _why)  # noqa: B904


def getaddrinfo(
    host: str, port: int, af: int = 0, type: int = 0, proto: int = 0, flags: int = 0
) -> "list[tuple[int, int, int, str, tuple[str, int]]]":
    """Return the address as it is: names are resolved when a socket connects."""
    return [(AF_INET, type or SOCK_STREAM, proto, "", (host, port))]


class socket:
    """A TCP or UDP socket that never blocks."""

    def __init__(self, af: int = AF_INET, type: int = SOCK_STREAM, proto: int = 0) -> None:
        self._handle: int = _board.number(_board.NET_OPEN, bytes((type,)))

    def setblocking(self, flag: bool) -> None:
        """Raise OSError for a blocking socket, which the board does not have."""
        if flag:
            raise OSError(22)

    def setsockopt(self, level: int, name: int, value: int) -> None:
        """Set an option; does nothing here."""

    def bind(self, address: "tuple[str, int]") -> None:
        """Send from the port of (host, port); the host is ignored: there is one network."""
        _board.call(_board.NET_BIND, struct.pack("<BH", self._handle, address[1]))

    def connect(self, address: "tuple[str, int]") -> None:
        """Connect to (host, port)."""
        head = struct.pack("<BH", self._handle, address[1])
        _board.call(_board.NET_CONNECT, head + address[0].encode())

    def send(self, data: bytes) -> int:
        """Send octets; return how many were taken."""
        return _board.number(_board.NET_SEND, bytes((self._handle,)) + bytes(data))

    def recv(self, size: int) -> bytes:
        """Return at most ``size`` octets received."""
        return _board.call(_board.NET_RECV, struct.pack("<BH", self._handle, size))

    def close(self) -> None:
        """Close the socket."""
        _board.call(_board.NET_CLOSE, bytes((self._handle,)))

    def net_wait(self, us: int, events: int) -> int:
        """Wait for an event for ``us`` microseconds; return those that are ready.

        MicroPython's sockets do not have this method; :mod:`select` uses it.
        """
        return _board.number(_board.NET_WAIT, struct.pack("<IBB", us, self._handle, events))

    def ioctl(self, request: int, events: int) -> int:
        """Answer a poll request with the events that are ready."""
        return self.net_wait(0, events) if request == _STREAM_POLL else 0
