"""HTTP for a few pages on this machine, and for what they ask for again and again.

A page's question may be left unanswered until there is news, for a second or so: that is how a page
is live. Each connection has a thread.

Who may ask: a browser shows pages of strangers too, and those could ask here, by a name that leads
to this machine. So a question must name this machine by its address, ``localhost`` or a name that
was given, and what changes something must be JSON, which pages of other origins may not send.
"""

from __future__ import annotations

import ipaddress
import json
import os
import socket
import sys
import threading
import time
from collections.abc import Callable, Mapping
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from importlib import resources
from socketserver import TCPServer
from typing import Any, Final, NamedTuple
from urllib.parse import parse_qs, urlsplit

# Attack: connections without end, and ones that say nothing.
MAX_CONNECTIONS: Final = 32
IDLE_SECONDS: Final = 15.0
# Attack: a body without end.
MAX_BODY: Final = 4096
_POLL: Final = 0.2

_MIME: Final = {".html": "text/html", ".css": "text/css", ".js": "text/javascript"}
# Nothing from elsewhere, and nobody's frame.
_POLICY: Final = (
    "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' blob: data:;"
    " connect-src 'self'; frame-ancestors 'none'; base-uri 'none'; form-action 'none'"
)


class Answer(NamedTuple):
    """What is sent back; ``about``: small facts that a page reads beside the body, as JSON."""

    status: int
    body: bytes
    mime: str
    about: Mapping[str, Any] | None = None


def as_json(value: Any, status: int = 200) -> Answer:
    return Answer(status, json.dumps(value).encode(), "application/json")


# Gets what stands behind "?", by name, or what was sent as JSON.
Get = Callable[[dict[str, str]], Answer]
Post = Callable[[Any], Answer]


class Pages:
    """The files ``names`` of ``pages/``, the first of them at ``/``, and what they ask for.

    ``get`` and ``post`` are by path, and are called in threads. Raises OSError where the port
    cannot be had; ``port`` 0 takes any. It serves until `close`.
    """

    def __init__(
        self,
        host: str,
        port: int,
        names: tuple[str, ...],
        get: Mapping[str, Get],
        post: Mapping[str, Post] | None = None,
    ) -> None:
        files = resources.files(__package__).joinpath("pages")
        self._http = _Http(host, port)
        self._http.named = host
        self._http.get = dict(get)
        self._http.post = dict(post or {})
        for name in names:
            body = files.joinpath(name).read_bytes()
            self._http.files[f"/{name}"] = body, _MIME[os.path.splitext(name)[1]]
        self._http.files["/"] = self._http.files[f"/{names[0]}"]
        self.port: int = self._http.server_address[1]
        shown = "127.0.0.1" if host in ("0.0.0.0", "") else host
        shown = "[::1]" if host == "::" else f"[{shown}]" if ":" in shown else shown
        self.url = f"http://{shown}:{self.port}/"
        self._thread = threading.Thread(
            target=self._http.serve_forever, args=(_POLL,), name="uros-pages", daemon=True
        )
        self._thread.start()

    def close(self) -> None:
        """No more answers. Those who wait for one are cut off."""
        self._http.shutdown()
        self._thread.join()
        self._http.server_close()


class _Http(ThreadingHTTPServer):
    daemon_threads = True
    block_on_close = False
    allow_reuse_port = False
    request_queue_size = MAX_CONNECTIONS

    def __init__(self, host: str, port: int) -> None:
        self.files: dict[str, tuple[bytes, str]] = {}
        self.get: dict[str, Get] = {}
        self.post: dict[str, Post] = {}
        self.named = ""
        self._free = threading.BoundedSemaphore(MAX_CONNECTIONS)
        self._lock = threading.Lock()
        self._open: set[Any] = set()
        if ":" in host:
            self.address_family = socket.AF_INET6
        super().__init__((host, port), _Handler)

    def server_bind(self) -> None:
        TCPServer.server_bind(self)  # HTTPServer's asks the network for our name
        self.server_name, self.server_port = str(self.server_address[0]), self.server_address[1]

    def process_request(self, request: Any, client_address: Any) -> None:
        if not self._free.acquire(blocking=False):
            try:
                request.setblocking(False)
                request.send(b"HTTP/1.0 503 Busy\r\nRetry-After: 2\r\n\r\n")
            except OSError:
                pass
            self.shutdown_request(request)
            return
        with self._lock:
            self._open.add(request)
        try:
            super().process_request(request, client_address)
        except BaseException:  # no thread could be had
            self._done(request)
            raise

    def process_request_thread(self, request: Any, client_address: Any) -> None:
        try:
            super().process_request_thread(request, client_address)
        finally:
            self._done(request)

    def _done(self, request: Any) -> None:
        with self._lock:
            self._open.discard(request)
        self._free.release()

    def server_close(self) -> None:
        super().server_close()
        with self._lock:
            for request in self._open:
                try:
                    request.shutdown(socket.SHUT_RDWR)
                except OSError:
                    pass

    def handle_error(self, request: Any, client_address: Any) -> None:
        """Browsers come and go; anything else is a fault of ours."""
        if not isinstance(sys.exc_info()[1], OSError):
            super().handle_error(request, client_address)

    def knows(self, host: str) -> bool:
        """Whether a question that is for ``host``, with a port or without, is for us."""
        name = urlsplit(f"//{host}").hostname or ""
        if name in ("localhost", self.named.lower(), socket.gethostname().lower()):
            return True
        try:
            ipaddress.ip_address(name)
        except ValueError:
            return False
        return True


class _Handler(BaseHTTPRequestHandler):
    protocol_version = "HTTP/1.1"
    timeout = IDLE_SECONDS
    server: _Http

    def do_GET(self) -> None:
        if not self._may_ask():
            return
        path, _, query = self.path.partition("?")
        known = self.server.files.get(path)
        if known is not None:
            self._send(Answer(200, *known))
        elif path in self.server.get:
            asked = {name: values[-1] for name, values in parse_qs(query, max_num_fields=8).items()}
            self._send(self.server.get[path](asked))
        else:
            self._refuse(404, "there is no such page; go to /")

    def do_POST(self) -> None:
        length = self.headers.get("Content-Length", "")
        if not length.isdecimal() or int(length) > MAX_BODY:
            self.close_connection = True
            self._refuse(413, f"send at most {MAX_BODY} octets, and say how many")
            return
        body = self.rfile.read(int(length))
        if not self._may_ask():
            return
        if self.headers.get_content_type() != "application/json":
            self._refuse(415, "send JSON, as application/json")
            return
        call = self.server.post.get(self.path)
        if call is None:
            self._refuse(404, "there is nothing to send to here")
            return
        try:
            value = json.loads(body)
        except (ValueError, RecursionError):
            self._refuse(400, "this is no JSON")
            return
        self._send(call(value))

    def _may_ask(self) -> bool:
        host = self.headers.get("Host", "")
        origin = self.headers.get("Origin", "")
        try:
            if self.server.knows(host) and origin in ("", f"http://{host}"):
                return True
        except ValueError:  # no address at all
            pass
        self.close_connection = True
        self._refuse(403, "open this page by this machine's address, such as http://127.0.0.1")
        return False

    def _refuse(self, status: int, text: str) -> None:
        self._send(Answer(status, f"{text}\n".encode(), "text/plain"))

    def _send(self, answer: Answer) -> None:
        self.send_response(answer.status)
        if answer.body or answer.status != 204:
            text = answer.mime.startswith("text/")
            self.send_header("Content-Type", f"{answer.mime}{'; charset=utf-8' if text else ''}")
            self.send_header("Content-Length", str(len(answer.body)))
        if answer.about is not None:
            self.send_header("X-About", json.dumps(answer.about))  # ASCII
        self.send_header("Cache-Control", "no-store")
        self.send_header("Content-Security-Policy", _POLICY)
        self.send_header("X-Content-Type-Options", "nosniff")
        self.send_header("Referrer-Policy", "no-referrer")
        self.end_headers()
        self.wfile.write(answer.body)

    def version_string(self) -> str:
        return "uros"

    def log_message(self, format: str, *args: Any) -> None:
        """A page that asks ten times a second is no news."""


class Newest:
    """What changes, and those who wait for it to change. Use it from any thread."""

    def __init__(self) -> None:
        self._changed = threading.Condition()
        self.version = 0

    def __enter__(self) -> None:
        self._changed.acquire()

    def __exit__(self, *_: object) -> None:
        self._changed.release()

    def change(self) -> None:
        """Within ``with``: something is new."""
        self.version += 1
        self._changed.notify_all()

    def wait(self, seen: int, seconds: float) -> None:
        """Within ``with``: until there is another version than ``seen``, for so long at most."""
        end = time.monotonic() + seconds
        while self.version == seen and (left := end - time.monotonic()) > 0:
            self._changed.wait(left)


def number(asked: dict[str, str], name: str) -> int:
    """A whole number that was asked with; -1 where there is none."""
    text = asked.get(name, "")
    return int(text) if text.isdecimal() and len(text) < 16 else -1


def show(url: str) -> bool:
    """Open a browser at it, where there is one with windows; whether it seems so."""
    windows = sys.platform in ("darwin", "win32") or any(
        os.environ.get(name) for name in ("DISPLAY", "WAYLAND_DISPLAY", "BROWSER")
    )
    if not windows:  # a browser for terminals would take this one
        return False
    import webbrowser

    try:
        return webbrowser.open(url)
    except webbrowser.Error:
        return False
