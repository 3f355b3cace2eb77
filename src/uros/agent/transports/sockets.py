"""Serial frames over stream sockets: one that connects, and one that many connect to.

What the sockets are is the caller's: TCP for a serial line that another machine
offers, Bluetooth in :mod:`.rfcomm`. Nothing waits; what fails is tried again.
"""

from __future__ import annotations

import errno
import socket
import sys
from collections.abc import Callable
from typing import Any, Final
from urllib.parse import urlsplit

from .base import ERROR, INFO, WARNING, Host, ServerTransport, TransportError
from .fault_counter import FaultCounter
from .line import COUNTERS, Line, LineServer, SocketStream
from .remedies import socket_trouble

# Timeout of a connection attempt, in seconds.
PATIENCE: Final = 20.0
# The time between two tries to open a listening socket, in seconds.
RETRY: Final = 2.0
# The most connections, so that they do not take all descriptors. A Bluetooth adapter holds seven.
MAX_CONNECTIONS: Final = 64

_PENDING: Final = (
    (errno.EINPROGRESS, errno.EWOULDBLOCK) if sys.platform == "win32" else (errno.EINPROGRESS,)
)


class SocketLineServer(LineServer):
    """A line over a socket that connects, and connects again when it is lost.

    Args:
        device: Its name in the log.
        make: Makes sockets.
        address: The address to connect to.
        explain: Returns the text for an errno.
    """

    def __init__(
        self, device: str, make: Callable[[], socket.socket], address: Any,
        explain: Callable[[int], str],
    ) -> None:  # fmt: skip
        super().__init__(device)
        self._make = make
        self._address = address
        self._explain = explain
        self._pending: socket.socket | None = None

    def _begin(self, host: Host) -> None:
        try:
            sock = self._make()
        except OSError as error:
            self._give_up(error.errno or 0)
            return
        sock.setblocking(False)
        try:
            number = sock.connect_ex(self._address)
        except OSError as error:  # an address that this family has not
            number = error.errno or errno.EINVAL
        self._pending = sock
        if not number:
            self._connected(sock)
        elif number in _PENDING:
            host.watch(sock.fileno(), lambda: self._attempt_ended(sock), True)
            host.wake_at(PATIENCE, lambda: self._late(sock))
        else:
            self._give_up(number)

    def _attempt_ended(self, sock: socket.socket) -> None:
        """Handle the end of a connection attempt."""
        if self._pending is not sock:
            return
        number = sock.getsockopt(socket.SOL_SOCKET, socket.SO_ERROR)
        if not number:
            try:
                sock.getpeername()
            except OSError:
                return  # not yet
            self._connected(sock)
        else:
            self._give_up(number)

    def _late(self, sock: socket.socket) -> None:
        if self._pending is sock:
            self._give_up(errno.ETIMEDOUT)

    def _connected(self, sock: socket.socket) -> None:
        self._pending = None
        if self._host is not None:
            self._host.unwatch(sock.fileno())
        if sock.family in (socket.AF_INET, socket.AF_INET6):
            sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._opened(SocketStream(sock), f"dev: {self.device}")

    def _give_up(self, number: int) -> None:
        self._forget()
        away = number in (errno.EHOSTDOWN, errno.ECONNREFUSED, errno.ETIMEDOUT)
        self._failed(
            INFO if away else ERROR,
            "waiting for device" if away else "open device error",
            self._explain(number),
        )

    def _forget(self) -> None:
        sock, self._pending = self._pending, None
        if sock is not None:
            if self._host is not None:
                self._host.unwatch(sock.fileno())
            sock.close()

    def close(self) -> None:
        """Close everything; idempotent."""
        super().close()
        self._forget()


def tcp_line(url: str) -> SocketLineServer:
    """Make the line of ``socket://host:port``, offered by another machine (ser2net, esp-link).

    A name is resolved once, here, because resolving takes long if the network is down. Raises
    TransportError for another URL, or a name that cannot be resolved.
    """
    try:
        parts = urlsplit(url)
        host, port = parts.hostname, parts.port
    except ValueError:
        host = port = None
    if not host or not port:
        raise TransportError(
            errno.EINVAL, f"{url} is not valid: write socket://host:port, such as"
            " socket://192.168.1.20:3333"
        )  # fmt: skip
    try:
        addresses = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)
    except (OSError, UnicodeError) as error:
        raise TransportError(
            errno.EINVAL, f"{url}: {host} cannot be resolved ({error}): correct the name, or write"
            " the address"
        ) from error  # fmt: skip
    family, kind, protocol, _, address = addresses[0]
    return SocketLineServer(
        url, lambda: socket.socket(family, kind, protocol), address, socket_trouble
    )


class StreamListener(ServerTransport):
    """Accepts connections, each a line; a peer is (name, source address of its frames).

    A connection with the name of an earlier one replaces it and continues its sessions.

    Args:
        where: Its name in the log.
        make: Makes sockets.
        address: The address to listen on.
        name_of: Returns the name of an accepted address.
        explain: Returns the text for an errno.
    """

    def __init__(
        self, where: str, make: Callable[[], socket.socket], address: Any,
        name_of: Callable[[Any], str], explain: Callable[[int], str],
    ) -> None:  # fmt: skip
        super().__init__()
        self.where = where
        self.lines: dict[str, Line] = {}
        self._make = make
        self._address = address
        self._name_of = name_of
        self._explain = explain
        self._socket: socket.socket | None = None
        self._host: Host | None = None
        self._closed = False
        self._said = ""
        self._refused = FaultCounter()

    def open(self, host: Host) -> None:
        """Open and start watching; raises TransportError."""
        self._host = host
        self._try()

    def _try(self) -> None:
        host = self._host
        if self._closed or host is None:
            return
        try:
            sock = self._make()
            try:
                sock.setblocking(False)
                sock.bind(self._address)
                sock.listen(8)
            except BaseException:
                sock.close()
                raise
        except OSError as error:
            self._wait(host, error)
            return
        self._said = ""
        self._socket = sock
        host.watch(sock.fileno(), self._accept)
        host.note(INFO, self.name, "init", "running...", self.where)

    def _wait(self, host: Host, error: OSError) -> None:
        """Log a new reason once, and try again."""
        why = self._explain(error.errno or 0)
        if why != self._said:
            self._said = why
            host.note(ERROR, self.name, "init", "cannot listen", f"{self.where}, {why}")
        host.wake_at(RETRY, self._try)

    def _accept(self) -> None:
        host, listener = self._host, self._socket
        if listener is None or host is None:
            return
        try:
            sock, address = listener.accept()
        except (BlockingIOError, ConnectionError):
            return  # the connection was closed before it was accepted
        except OSError as error:
            # The adapter was unplugged, or there are no descriptors left: open again.
            self._stop(host)
            self._wait(host, error)
            return
        name = self._name_of(address)
        line = self.lines.get(name)
        if line is None:
            if self._connected() >= MAX_CONNECTIONS:
                sock.close()
                if self._refused.add():
                    host.note(
                        WARNING, self.name, "accept", "connection refused",
                        f"address: {name}, over {MAX_CONNECTIONS} connections,"
                        f" refused: {self._refused.count}",
                    )  # fmt: skip
                return
            line = self.lines[name] = self._line(name)
        sock.setblocking(False)
        line.open(host, SocketStream(sock))
        host.note(INFO, self.name, "accept", "connected", f"address: {name}")

    def _connected(self) -> int:
        """Return the number of connections; closed ones over the limit are dropped."""
        away = [name for name, line in self.lines.items() if line.stream is None]
        for name in away[: max(0, len(away) - MAX_CONNECTIONS + 1)]:
            del self.lines[name]
        return len(self.lines) - len(away)

    def _line(self, name: str) -> Line:
        def lost(why: str) -> None:
            if self._host is not None and not self._closed:
                self._host.note(
                    WARNING, self.name, "receive", "connection lost",
                    f"address: {name}, {why}; the board may connect again",
                )  # fmt: skip
                self._host.lost(self)

        return Line(self, name, lambda source: (name, source), lost)

    def send(self, peer: tuple[str, int], datagram: bytes) -> None:
        """Send one message; it is lost if it cannot be sent."""
        line = self.lines.get(peer[0])
        if line is not None:
            line.send(peer[1], datagram)

    def label(self) -> str:
        """Return what it listens on, as text."""
        return self.where

    def counters(self) -> dict[str, int]:
        """Return the counters."""
        lines = [line.counters() for line in self.lines.values()]
        return {
            **super().counters(),
            **{name: sum(line[name] for line in lines) for name in COUNTERS},
            "connections": sum(line.stream is not None for line in self.lines.values()),
            "refused": self._refused.count,
        }

    def address(self, peer: tuple[str, int]) -> str:
        """Return the peer as text."""
        return f"{peer[0]} ({peer[1]})"

    def is_away(self, peer: tuple[str, int]) -> bool:
        """Return whether the board was connected and is not any more.

        False for a restored board that has not connected since: it may connect at any time.
        """
        line = self.lines.get(peer[0])
        return line is not None and line.stream is None

    def _stop(self, host: Host) -> None:
        sock, self._socket = self._socket, None
        if sock is not None:
            host.unwatch(sock.fileno())
            sock.close()

    def close(self) -> None:
        """Close everything; idempotent."""
        self._closed = True
        for line in self.lines.values():
            line.close()
        if self._host is not None:
            self._stop(self._host)
