"""The TCP connection to the visualiser."""

import errno
import select
import socket
import time

try:
    from typing import Any
except ImportError:
    pass

AGAIN_MS = 1000
PATIENCE_MS = 5000
LATER = (errno.EAGAIN, errno.EINPROGRESS)


class Line:
    """A TCP connection to ``host``, ``port`` over ``link`` (see `uros.transport.wlan`).

    It reconnects by itself. Only `receive` waits. ``connected`` is the state, ``reason`` the cause
    of a failure.
    """

    def __init__(self, link: "Any", host: str, port: int) -> None:
        self.connected = False
        self.reason = ""
        self._link = link
        self._address = (host, port)
        self._socket: "Any" = None
        self._poll: "Any" = None
        self._since = time.ticks_add(time.ticks_ms(), -AGAIN_MS)  # time of the last attempt
        self._rest = b""  # unsent rest of a line

    def receive(self, timeout_ms: int) -> bytes:
        """Wait for data up to ``timeout_ms``, and return it; b"" if there is none."""
        try:
            if self._socket is None:
                self._open()
            if self._socket is not None:
                if self.connected:
                    return self._take(timeout_ms)
                self._look(timeout_ms)
                return b""
        except OSError as error:
            self._close(error)
        time.sleep_ms(timeout_ms)
        return b""

    def send(self, text: str) -> bool:
        """Send a line; return False if it is dropped without a connection or buffer space."""
        if not self.connected or not self._push():
            return False
        self._rest = text.encode() + b"\n"
        self._push()
        return True

    def _open(self) -> None:
        now = time.ticks_ms()
        if time.ticks_diff(now, self._since) < AGAIN_MS:
            return
        self._since = now
        self._link.check()
        address = socket.getaddrinfo(self._address[0], self._address[1], 0, socket.SOCK_STREAM)[0]
        self._socket = socket.socket(address[0], socket.SOCK_STREAM)
        self._socket.setblocking(False)
        self._poll = select.poll()
        self._poll.register(self._socket, select.POLLOUT)
        try:
            self._socket.connect(address[-1])
        except OSError as error:
            if error.errno not in LATER:
                raise

    def _look(self, timeout_ms: int) -> None:
        """Check whether the connection is established."""
        peer = "%s, port %d" % self._address
        for _, events in self._poll.poll(timeout_ms):
            if events & (select.POLLERR | select.POLLHUP):
                raise OSError(errno.ECONNREFUSED, "nobody listens at " + peer)
            self._poll.modify(self._socket, select.POLLIN)
            self.connected = True
            self.reason = ""
            return
        if time.ticks_diff(time.ticks_ms(), self._since) > PATIENCE_MS:
            raise OSError(errno.ETIMEDOUT, "no answer from " + peer)

    def _take(self, timeout_ms: int) -> bytes:
        for _ in self._poll.poll(timeout_ms):
            try:
                octets: bytes = self._socket.recv(256)
            except OSError as error:
                if error.errno not in LATER:
                    raise
                break
            if not octets:
                raise OSError(errno.ECONNRESET, "the visualiser has closed the connection")
            return octets
        return b""

    def _push(self) -> bool:
        """Send the rest of a line; return whether all of it is sent."""
        try:
            if self._rest:
                self._rest = self._rest[self._socket.send(self._rest) :]
        except OSError as error:
            if error.errno not in LATER:
                self._close(error)
        return self.connected and not self._rest

    def _close(self, error: OSError) -> None:
        self.connected = False
        self.reason = str(error.args[-1] if len(error.args) > 1 else error)
        self._rest = b""
        if self._socket is not None:
            self._socket.close()
            self._socket = None
