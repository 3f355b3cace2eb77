"""UDP over IPv4 or IPv6 at the agent's end."""

from __future__ import annotations

import socket
from typing import Final

from ...poller import has_input
from .base import ERROR, INFO, MAX_BURST, MAX_BURST_BYTES, Host, ServerTransport
from .ip import Address, family_of, listening_socket, text_of, warn_without_ipv6

_LARGEST: Final = 65536
# The size of the socket's buffers in bytes: a burst of a hundred boards must fit. The kernel may
# grant less.
_SOCKET_BUFFER: Final = 4 * 1024 * 1024
# After so many bursts of one message each, the socket is asked for a second one after every fourth
# only. A burst that comes then takes up to three turns more than one.
_ALONE: Final = 8
_UNASKED: Final = 3


class UdpServer(ServerTransport):
    """Listens on a port of all IPv4 addresses ("0.0.0.0"), all of IPv6 ("::"), or of one."""

    kind = "UDP"

    def __init__(self, port: int, host: str = "0.0.0.0") -> None:
        super().__init__()
        self.name = "UDPv6Agent" if family_of(host) == socket.AF_INET6 else "UDPv4Agent"
        self.port = port
        self.listens_on = host
        self._socket: socket.socket | None = None
        self._alone = 0  # bursts of one message, in a row
        self._unasked = 0  # bursts for which it is not asked
        self._buf = bytearray(_LARGEST)
        self._view = memoryview(self._buf)

    def open(self, host: Host) -> None:
        """Open and start watching; raises TransportError."""
        sock = listening_socket("UDP", self.listens_on, self.port)
        for option in (socket.SO_RCVBUF, socket.SO_SNDBUF):
            sock.setsockopt(socket.SOL_SOCKET, option, _SOCKET_BUFFER)
        self.listens_on, self.port = sock.getsockname()[:2]
        self._socket = sock
        self._host = host
        host.watch(sock.fileno(), self._drain)
        host.note(INFO, self.name, "init", "running...", f"port: {self.port}")
        warn_without_ipv6(host, self.name, self.listens_on)

    def _drain(self) -> None:
        sock = self._socket
        if sock is None:
            return
        host, buf, view, sessions = self._host, self._buf, self._view, self.sessions
        recvfrom_into, now = sock.recvfrom_into, host.now()
        budget = MAX_BURST_BYTES
        count = 0
        try:
            for count in range(MAX_BURST):  # noqa: B007  received so far
                try:
                    length, peer = recvfrom_into(buf)
                except BlockingIOError:
                    return
                except OSError as error:  # an ICMP error of an earlier send, on some systems
                    host.note(ERROR, self.name, "receive", "socket error", str(error))
                    return
                session = sessions.get(peer)
                if session is not None and length > 7 and buf[0] == session.session_id:
                    host.received(self, session, buf, view, length, now)
                else:
                    host.unmatched(self, peer, buf, view, length)
                budget -= length
                if budget <= 0 or (not count and length and self._is_alone(sock)):
                    count += 1
                    return
            count = MAX_BURST
        finally:  # counted once a burst
            self.messages += count
            self.bytes += MAX_BURST_BYTES - budget

    def _is_alone(self, sock: socket.socket) -> bool:
        """Return whether a burst ends after its first message; a poll reports what is left."""
        if self._unasked:
            self._unasked -= 1
            return True
        if has_input(sock.fileno()):
            self._alone = 0
            return False
        self._alone += 1
        if self._alone >= _ALONE:
            self._unasked = _UNASKED
        return True

    def send(self, peer: Address, datagram: bytes) -> None:
        """Send one message; it is lost if it cannot be sent."""
        if self._socket is not None:
            try:
                self._socket.sendto(datagram, peer)
            except OSError:
                pass  # no room, no route, no receiver: reliable streams retransmit

    def label(self) -> str:
        """Return what it listens on, as text."""
        return f"port {self.port}"

    def host_of(self, peer: Address) -> str | None:
        """Return the peer's IP address."""
        return str(peer[0])

    def address(self, peer: Address) -> str:
        """Return the peer as text."""
        return text_of(peer)

    def close(self) -> None:
        """Close everything; idempotent."""
        if self._socket is not None:
            self._host.unwatch(self._socket.fileno())
            self._socket.close()
            self._socket = None
