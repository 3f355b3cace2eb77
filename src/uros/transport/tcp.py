"""Client transport over TCP: each message is preceded by its length.

Runs on MicroPython ports that have a network.
"""

import errno
import select
import socket

from ..ticks import ticks_add, ticks_diff, ticks_ms
from ..wire.framing import LengthDeframer

try:
    from typing import Any, Final

    from ..wire.cdr import Buffer
except ImportError:  # MicroPython
    pass

_CHUNK: Final = 1024
# Most chunks read after the timeout: an agent that never stops must not block the program.
_CHUNKS: Final = 16
# The errors of systems for "not now".
_LATER: Final = (errno.EAGAIN, getattr(errno, "EWOULDBLOCK", errno.EAGAIN), errno.EINPROGRESS)


class TcpTransport:
    """Messages to and from the agent at ``host``, ``port``, of at most ``mtu`` bytes.

    ``host`` is a name, or an address of IPv4 or IPv6; if nobody answers at one of a name's
    addresses, the next one is tried. Only the look-up of a name waits. A message of which only a
    part is sent is kept, and its rest is sent first; messages sent meanwhile are lost and counted
    in ``dropped``; reliable ones are sent again. OSError is raised when the agent does not answer
    or cannot be reached for ``patience_ms``.
    """

    def __init__(
        self, host: str, port: int = 8888, mtu: int = 512, patience_ms: int = 10000
    ) -> None:
        self.mtu = mtu
        self.dropped = 0
        self._host = host
        self._port = port
        self._patience_ms = patience_ms
        self._turn = -1  # index of the address in use
        self._heard = False  # whether anything was received from it
        self._socket: "Any" = None
        self._line: "Any" = None  # the socket or its TLS object, once it is connected
        self._poll: "Any" = None
        self._until: "int | None" = None  # when the agent counts as lost
        self._out = bytearray(mtu + 2)
        self._from = 0  # _out[_from:_to] is not sent yet
        self._to = 0
        self._writing = False  # it waits for the network to accept more
        self._deframer = LengthDeframer()
        self._messages: "list[bytes]" = []

    def open(self) -> None:
        """Begin to connect. Raises OSError if the host is unknown or the network is down."""
        self.close()
        addresses = socket.getaddrinfo(self._host, self._port, 0, socket.SOCK_STREAM)
        if not self._heard:
            self._turn += 1
        self._heard = False
        address = addresses[self._turn % len(addresses)]
        self._deframer = LengthDeframer()
        self._from = self._to = 0
        self._messages.clear()
        self._until = ticks_add(ticks_ms(), self._patience_ms)
        self._socket = sock = socket.socket(address[0], socket.SOCK_STREAM)
        try:
            sock.setblocking(False)
            if hasattr(socket, "TCP_NODELAY"):
                sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            sock.connect(address[-1])
        except OSError as error:
            if error.errno not in _LATER:
                self.close()
                raise
        self._watch(sock, select.POLLOUT)

    def _watch(self, line: "Any", events: int) -> None:
        self._poll = select.poll()
        self._poll.register(line, events)

    def close(self) -> None:
        """Close the transport; idempotent."""
        line, sock = self._line, self._socket
        self._line = self._socket = self._poll = None
        # Both: after a failure of TLS, MicroPython's TLS object does not close its socket.
        for closable in (line, sock):
            if closable is not None:
                try:
                    closable.close()
                except OSError:
                    pass

    def send(self, message: "Buffer", size: int = -1) -> None:
        """See :class:`uros.client.protocols.Transport`. Without ``size``, all of the message.

        A message sent before there is a connection is kept until there is one.
        """
        if self._line is not None:
            self._push()
        if size < 0:
            size = len(message)
        if self._from < self._to or size > self.mtu:
            self.dropped += 1
            return
        self._out[0] = size & 0xFF
        self._out[1] = size >> 8
        self._out[2 : 2 + size] = memoryview(message)[:size]
        self._from = 0
        self._to = size + 2
        if self._line is not None:
            if self._until is None:
                self._until = ticks_add(ticks_ms(), self._patience_ms)
            self._push()

    def receive(self, timeout_ms: int) -> "bytes | None":
        """See :class:`uros.client.protocols.Transport`."""
        if self._messages:
            return self._messages.pop(0)
        end = ticks_add(ticks_ms(), timeout_ms)
        chunks = 0
        while True:
            data = self._take() if self._line is not None or self._connected() else None
            if data:
                self._heard = True
                self._until = None
                self._messages = self._deframer.feed(data)
                if self._messages:
                    return self._messages.pop(0)
                chunks += 1
                if chunks < _CHUNKS:
                    continue
            now = ticks_ms()
            if self._until is not None and ticks_diff(self._until, now) <= 0:
                raise OSError(errno.ETIMEDOUT, "no answer from " + self._where())
            left = ticks_diff(end, now)
            if left <= 0:
                return None
            if not data:
                self._poll.poll(left)

    def _where(self) -> str:
        return "%s, port %d" % (self._host, self._port)

    def _connected(self) -> bool:
        """Return whether the connection is established."""
        for _, events in self._poll.poll(0):
            if events & (select.POLLERR | select.POLLHUP):
                raise OSError(errno.ECONNREFUSED, "nobody answers at " + self._where())
            self._line = self._begin(self._socket)
            self._watch(self._line, select.POLLIN)
        return self._line is not None

    def _take(self) -> "bytes | None":
        """Send unsent bytes; return the bytes received, or None if there are none."""
        self._push()
        data: "bytes | None" = self._read()
        if data is not None and not data:
            raise OSError(errno.ECONNRESET, "the connection was closed by " + self._where())
        if not data:
            events = select.POLLIN | (select.POLLOUT if self._writing else 0)
            self._poll.modify(self._line, events)
        return data

    def _push(self) -> None:
        self._writing = False
        if self._from < self._to:
            sent = self._write(memoryview(self._out)[self._from : self._to])
            if sent is not None:
                self._from += sent
                self._writing = self._from < self._to

    # --- overridden by TLS ------------------------------------------------------------------

    def _begin(self, sock: "Any") -> "Any":
        """Return the object that reads and writes on the connection."""
        return sock

    def _read(self) -> "bytes | None":
        """Return the bytes received; None: none yet, b"": the connection was closed."""
        try:
            data: bytes = self._line.recv(_CHUNK)
            return data
        except OSError as error:
            if error.errno in _LATER:
                return None
            raise

    def _write(self, data: "Buffer") -> "int | None":
        """Return the number of bytes written; None: the peer must send something first."""
        try:
            sent: int = self._line.send(data)
            return sent
        except OSError as error:
            if error.errno in _LATER:
                return 0
            raise
