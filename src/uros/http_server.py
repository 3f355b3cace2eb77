"""A bounded HTTP server for this machine: the agent's metrics and the pages of tools.

One thread holds the connections and reads until a request is complete; complete requests are
answered in threads, a limited number at a time. So a silent connection takes no thread, and is the
first to be closed when the limit of connections is reached.

A browser also shows foreign pages, which could send requests here by a name that resolves to this
machine (DNS rebinding). So the Host header must be an address of this machine, ``localhost``, its
host name or a configured name, and requests of pages of another origin are refused.
"""

from __future__ import annotations

import io
import ipaddress
import os
import re
import selectors
import socket
import threading
import time
from collections import Counter, deque
from collections.abc import Callable
from http.server import BaseHTTPRequestHandler
from typing import Any, Final
from urllib.parse import urlsplit

# The most connections that are being read or answered.
MAX_CONNECTIONS: Final = 64
# The most bytes of the head and the body of a request, and the seconds in which it must be
# complete, because a request may never end, or arrive byte by byte, or never be sent.
MAX_HEAD: Final = 16 * 1024
MAX_BODY: Final = 4096
ASK_SECONDS: Final = 5.0
# The seconds in which an answer must be sent, because a client may read it byte by byte.
ANSWER_SECONDS: Final = 15.0

_END: Final = re.compile(rb"\r?\n\r?\n")
_LENGTH: Final = re.compile(rb"\ncontent-length:[ \t]*([0-9]{1,5})[ \t]*\r?\n", re.IGNORECASE)
_CHUNK: Final = 65536
_NO_DESCRIPTOR_SECONDS: Final = 0.1
_BUSY: Final = b"HTTP/1.1 503 Busy\r\nRetry-After: 2\r\nConnection: close\r\n\r\n"


class _Connection:
    def __init__(self, sock: socket.socket, peer: Any) -> None:
        self.sock = sock
        self.peer = peer
        self.data = b""
        self.since = time.monotonic()
        self.ended = False  # all is said: what still comes is read, or it would not hear us out

    def take(self) -> bytes | None:
        """Return a complete request, or bytes that cannot become one; None until then."""
        end = _END.search(self.data)
        if end is None:
            return self._all() if len(self.data) > MAX_HEAD else None
        length = _LENGTH.search(self.data, 0, end.end())
        body = int(length[1]) if length else 0
        if body > MAX_BODY:  # its handler refuses it
            return self._all()
        stop = end.end() + body
        if len(self.data) < stop:
            return None
        request, self.data = self.data[:stop], self.data[stop:]
        return request

    def _all(self) -> bytes:
        request, self.data = self.data, b""
        return request


class Handler(BaseHTTPRequestHandler):
    """Answers one complete request whose Host header is this machine."""

    protocol_version = "HTTP/1.1"
    server: HttpServer  # type: ignore[assignment]

    def __init__(self, connection: _Connection, request: bytes, server: HttpServer) -> None:
        self._asked = request
        super().__init__(connection.sock, connection.peer, server)  # type: ignore[arg-type]

    def setup(self) -> None:
        """Read the request from memory, and write to the socket."""
        self.connection = self.request
        self.rfile = io.BytesIO(self._asked)
        self.wfile = _Out(self.request)

    def handle(self) -> None:
        """Answer the request."""
        self.close_connection = True
        self.handle_one_request()

    def finish(self) -> None:
        """Do nothing: the connection belongs to the server."""

    def parse_request(self) -> bool:
        """Parse the request and check its Host and Origin headers."""
        if not super().parse_request():
            return False
        host = self.headers.get("Host", "")
        if self.server.knows(host) and self.headers.get("Origin", "") in ("", f"http://{host}"):
            return True
        self.close_connection = True
        self.reply(403, self.server.wrong_host.encode(), "text/plain; charset=utf-8")
        return False

    def reply(
        self, status: int, body: bytes, kind: str, headers: tuple[tuple[str, str], ...] = ()
    ) -> None:
        """Send a complete answer.

        Args:
            status: HTTP status.
            body: The body.
            kind: Its content type.
            headers: Further headers.
        """
        self.send_response(status)
        if self.close_connection:
            self.send_header("Connection", "close")
        self.send_header("Content-Type", kind)
        self.send_header("Content-Length", str(len(body)))
        self.send_header("X-Content-Type-Options", "nosniff")
        for name, value in headers:
            self.send_header(name, value)
        self.end_headers()
        self.wfile.write(body)

    def version_string(self) -> str:
        """Return the Server header, without versions."""
        return "uros"

    def log_message(self, format: str, *args: Any) -> None:
        """Log nothing: a scrape every few seconds is no news."""


class _Out(io.BufferedIOBase):
    """Writes everything to a socket, and notes whether anything was written."""

    def __init__(self, sock: socket.socket) -> None:
        self._sock = sock

    def writable(self) -> bool:
        return True

    def write(self, data: Any) -> int:
        self._sock.sendall(data)
        return len(data)


class HttpServer:
    """A bounded HTTP server; it serves from :meth:`start` until :meth:`close`.

    Args:
        host: The address or name to listen on.
        port: TCP port; 0 for any.
        handler: The class that answers requests.
        threads: The most requests that are answered at a time.
        wrong_host: The text of the answer to requests with a wrong Host or Origin header.
        on_error: Called with exceptions of handlers, in their threads.

    Raises:
        OSError: The address cannot be used.
    """

    def __init__(
        self,
        host: str,
        port: int,
        handler: type[Handler],
        threads: int,
        wrong_host: str,
        on_error: Callable[[Exception], object],
    ) -> None:
        self.wrong_host = wrong_host
        self._handler = handler
        self._threads = threads
        self._on_error = on_error
        self._names = {"localhost", host.lower(), *_own_names()} - {""}
        self._listener = _listen(host, port)
        address = self._listener.getsockname()
        self.host, self.port = str(address[0]), int(address[1])
        self._wake, self._woken = socket.socketpair()
        self._woken.setblocking(False)
        self._selector = selectors.DefaultSelector()
        self._selector.register(self._listener, selectors.EVENT_READ)
        self._selector.register(self._woken, selectors.EVENT_READ)
        self._reading: dict[_Connection, None] = {}
        # Complete requests that wait for a thread.
        self._queue: deque[tuple[_Connection, bytes]] = deque()
        # Until when; None: it is over.
        self._answering: dict[_Connection, float | None] = {}
        # Connections answered by threads, and whether they stay open.
        self._answered: deque[tuple[_Connection, bool]] = deque()
        self._closed = False
        self._alone = False  # answering threads close their connections themselves
        self._thread = threading.Thread(target=self._run, name="uros-http", daemon=True)

    def start(self) -> None:
        """Start the thread."""
        self._thread.start()

    def close(self) -> None:
        """Stop serving and close all connections."""
        self._closed = True
        self._wake.send(b"x")
        self._thread.join()
        self._alone = True
        for connection in (*self._reading, *(connection for connection, _ in self._queue)):
            connection.sock.close()
        while self._answered:
            self._answered.popleft()[0].sock.close()
        for connection in self._answering:
            _shut(connection)
        self._selector.close()
        for sock in (self._listener, self._wake, self._woken):
            sock.close()

    def knows(self, host: str) -> bool:
        """Return whether a Host header, with or without a port, means this server."""
        try:
            name = urlsplit(f"//{host}").hostname or ""
            if name in self._names:
                return True
            ipaddress.ip_address(name)
        except ValueError:
            return False
        return True

    @property
    def connections(self) -> int:
        """Return the number of connections in all states."""
        return len(self._reading) + len(self._queue) + len(self._answering)

    # --- the thread that holds the connections -------------------------------------------------

    def _run(self) -> None:
        while not self._closed:
            for key, _ in self._selector.select(self._patience()):
                if key.fileobj is self._listener:
                    self._accept()
                elif key.fileobj is self._woken:
                    self._take_back()
                else:
                    self._read(key.data)
            self._end_late_ones()

    def _patience(self) -> float | None:
        """Return the seconds until the next connection times out; None lets an idle agent sleep."""
        ends = [connection.since + ASK_SECONDS for connection in self._reading]
        ends += [end for end in self._answering.values() if end is not None]
        return max(0.0, min(ends) - time.monotonic()) if ends else None

    def _accept(self) -> None:
        try:
            sock, peer = self._listener.accept()
        except OSError:  # closed again, or no descriptor left
            if not self._drop_one():
                time.sleep(_NO_DESCRIPTOR_SECONDS)
            return
        if self.connections >= MAX_CONNECTIONS and not self._drop_one():
            _refuse(sock)
            return
        self._watch(_Connection(sock, peer))

    def _drop_one(self) -> bool:
        """Close the longest silent connection, of the address with most without a request."""
        if not self._reading:
            return False
        counts = Counter(connection.peer[0] for connection in self._reading)
        most = counts.most_common(1)[0][1]
        self._drop(
            min(
                (connection for connection in self._reading if counts[connection.peer[0]] == most),
                key=lambda connection: connection.since,
            )
        )
        return True

    def _watch(self, connection: _Connection) -> None:
        connection.sock.setblocking(False)
        connection.since = time.monotonic()
        self._reading[connection] = None
        self._selector.register(connection.sock, selectors.EVENT_READ, connection)

    def _unwatch(self, connection: _Connection) -> None:
        del self._reading[connection]
        self._selector.unregister(connection.sock)

    def _drop(self, connection: _Connection) -> None:
        self._unwatch(connection)
        connection.sock.close()

    def _read(self, connection: _Connection) -> None:
        if connection not in self._reading:  # closed for another one in this turn
            return
        try:
            data = connection.sock.recv(_CHUNK)
        except BlockingIOError:
            return
        except OSError:
            data = b""
        if not data:
            self._drop(connection)
            return
        if connection.ended:
            return
        connection.data += data
        request = connection.take()
        if request is not None:
            self._unwatch(connection)
            self._queue.append((connection, request))
            self._answer_next()

    def _answer_next(self) -> None:
        while self._queue and len(self._answering) < self._threads:
            connection, request = self._queue.popleft()
            self._answering[connection] = time.monotonic() + ANSWER_SECONDS
            thread = threading.Thread(
                target=self._answer, args=(connection, request), name="uros-http-answer",
                daemon=True,
            )  # fmt: skip
            try:
                thread.start()
            except RuntimeError:  # no thread can be started
                del self._answering[connection]
                _refuse(connection.sock)

    def _take_back(self) -> None:
        """Handle connections whose answers were sent."""
        try:
            self._woken.recv(_CHUNK)
        except BlockingIOError:
            pass
        while self._answered:
            connection, goes_on = self._answered.popleft()
            self._answering.pop(connection, None)
            if not goes_on:
                connection.ended = True
                _shut(connection, socket.SHUT_WR)
            # A second request may have arrived already.
            request = None if connection.ended else connection.take()
            if request is not None:
                self._queue.append((connection, request))
            else:
                self._watch(connection)
        self._answer_next()

    def _end_late_ones(self) -> None:
        now = time.monotonic()
        late = [each for each in self._reading if each.since + ASK_SECONDS <= now]
        for connection in late:
            self._drop(connection)
        for connection, end in self._answering.items():
            if end is not None and end <= now:
                _shut(connection)  # this ends its thread
                self._answering[connection] = None

    # --- the threads that answer ------------------------------------------------------------------

    def _answer(self, connection: _Connection, request: bytes) -> None:
        goes_on = False
        try:
            connection.sock.settimeout(ANSWER_SECONDS)
            goes_on = not self._handler(connection, request, self).close_connection
        except OSError:
            pass  # the connection was closed
        except Exception as error:  # a fault of uros
            self._on_error(error)
        self._answered.append((connection, goes_on))
        try:
            self._wake.send(b"x")
        except OSError:
            pass  # closed meanwhile
        if self._alone:
            connection.sock.close()


def _listen(host: str, port: int) -> socket.socket:
    sock = socket.socket(socket.AF_INET6 if ":" in host else socket.AF_INET, socket.SOCK_STREAM)
    try:
        if os.name == "posix":  # on Windows it lets other programs take the port
            sock.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        if host == "::" and socket.has_dualstack_ipv6():
            sock.setsockopt(socket.IPPROTO_IPV6, socket.IPV6_V6ONLY, 0)
        sock.bind((host, port))
        sock.listen(MAX_CONNECTIONS)
        sock.setblocking(False)
    except BaseException:
        sock.close()
        raise
    return sock


def _own_names() -> set[str]:
    name = socket.gethostname().lower()
    return {name, f"{name}.local"}


def _refuse(sock: socket.socket) -> None:
    try:
        sock.setblocking(False)
        sock.send(_BUSY)
    except OSError:
        pass
    sock.close()


def _shut(connection: _Connection, how: int = socket.SHUT_RDWR) -> None:
    try:
        connection.sock.shutdown(how)
    except OSError:
        pass
