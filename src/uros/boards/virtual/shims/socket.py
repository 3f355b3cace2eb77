# mypy: disable-error-code="no-any-return"
"""MicroPython's ``socket`` on a board with a radio: clients of UDP and TCP that never wait."""

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
except OSError:  # such boards are built without it
    raise ImportError("no module named 'socket'")  # noqa: B904


def getaddrinfo(
    host: str, port: int, af: int = 0, type: int = 0, proto: int = 0, flags: int = 0
) -> "list[tuple[int, int, int, str, tuple[str, int]]]":
    """Names are looked up when a socket connects."""
    return [(AF_INET, type or SOCK_STREAM, proto, "", (host, port))]


class socket:
    def __init__(self, af: int = AF_INET, type: int = SOCK_STREAM, proto: int = 0) -> None:
        self._handle: int = _board.number(_board.NET_OPEN, bytes((type,)))

    def setblocking(self, flag: bool) -> None:
        if flag:
            raise OSError(22)

    def setsockopt(self, level: int, name: int, value: int) -> None:
        pass

    def connect(self, address: "tuple[str, int]") -> None:
        head = struct.pack("<BH", self._handle, address[1])
        _board.call(_board.NET_CONNECT, head + address[0].encode())

    def send(self, data: bytes) -> int:
        return _board.number(_board.NET_SEND, bytes((self._handle,)) + bytes(data))

    def recv(self, size: int) -> bytes:
        return _board.call(_board.NET_RECV, struct.pack("<BH", self._handle, size))

    def close(self) -> None:
        _board.call(_board.NET_CLOSE, bytes((self._handle,)))

    def net_wait(self, us: int, events: int) -> int:
        """The events that are there, waiting so long for one. MicroPython's have no such call."""
        return _board.number(_board.NET_WAIT, struct.pack("<IBB", us, self._handle, events))

    def ioctl(self, request: int, events: int) -> int:
        return self.net_wait(0, events) if request == _STREAM_POLL else 0
