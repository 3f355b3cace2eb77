"""An HTTP server on this machine for a few pages and the requests that they send.

Pages update by long polling: the handler of a request waits for new data, for up to about a second.
:mod:`uros.http_server` decides which requests are accepted. Against cross-site request forgery
(CSRF), a request that changes something must have the content type JSON, because browsers do not
let pages of other origins send that without permission.
"""

from __future__ import annotations

import json
import os
import sys
import threading
import time
import traceback
from collections.abc import Callable, Mapping
from importlib import resources
from typing import Any, Final, NamedTuple
from urllib.parse import parse_qs

from ..http_server import MAX_BODY, Handler, HttpServer

# The most requests that are answered at a time, because each takes a thread; others wait.
MAX_ANSWERS: Final = 32
# The most fields of a query; a query with more is refused before it is parsed.
_MAX_FIELDS: Final = 8
_WRONG_HOST: Final = "open this page by this machine's address, such as http://127.0.0.1\n"

_MIME: Final = {".html": "text/html", ".css": "text/css", ".js": "text/javascript"}
# No content from other origins, and no embedding in frames.
_POLICY: Final = (
    "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' blob: data:;"
    " connect-src 'self'; frame-ancestors 'none'; base-uri 'none'; form-action 'none'"
)
_HEADERS: Final = (
    ("Cache-Control", "no-store"),
    ("Content-Security-Policy", _POLICY),
    ("Referrer-Policy", "no-referrer"),
)


class Answer(NamedTuple):
    """An answer.

    Attributes:
        status: HTTP status.
        body: The body.
        mime: The body's media type.
        about: Small values in addition to the body, sent as JSON in the header ``X-About``.
    """

    status: int
    body: bytes
    mime: str
    about: Mapping[str, Any] | None = None


def as_json(value: Any, status: int = 200) -> Answer:
    """Make an answer with a JSON body."""
    return Answer(status, json.dumps(value).encode(), "application/json")


# Handlers of GET requests get the fields of the query, those of POST requests the decoded JSON.
Get = Callable[[dict[str, str]], Answer]
Post = Callable[[Any], Answer]


class Pages:
    """Serves files of ``pages/`` and answers their requests, until `close`.

    Args:
        host: The address to listen at.
        port: The TCP port; 0 for any free one.
        names: The files; the first is also at ``/``.
        get: Handlers of GET requests, by path. They are called in threads.
        post: Handlers of POST requests, by path. They are called in threads.

    Raises:
        OSError: The port cannot be used.
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
        self._http.get = dict(get)
        self._http.post = dict(post or {})
        for name in names:
            body = files.joinpath(name).read_bytes()
            self._http.files[f"/{name}"] = body, _MIME[os.path.splitext(name)[1]]
        self._http.files["/"] = self._http.files[f"/{names[0]}"]
        self.port = self._http.port
        shown = "127.0.0.1" if host in ("0.0.0.0", "") else host
        shown = "[::1]" if host == "::" else f"[{shown}]" if ":" in shown else shown
        self.url = f"http://{shown}:{self.port}/"
        self._http.start()

    def close(self) -> None:
        """Stop serving and close all connections."""
        self._http.close()


class _Http(HttpServer):
    def __init__(self, host: str, port: int) -> None:
        self.files: dict[str, tuple[bytes, str]] = {}
        self.get: dict[str, Get] = {}
        self.post: dict[str, Post] = {}
        super().__init__(host, port, _Handler, MAX_ANSWERS, _WRONG_HOST, _report)


def _report(error: Exception) -> None:
    traceback.print_exception(error)


class _Handler(Handler):
    server: _Http

    def do_GET(self) -> None:
        path, _, query = self.path.partition("?")
        file = self.server.files.get(path)
        if file is not None:
            self._send(Answer(200, *file))
        elif path in self.server.get:
            try:
                fields = parse_qs(query, max_num_fields=_MAX_FIELDS)
            except ValueError:
                self._refuse(400, f"ask with at most {_MAX_FIELDS} fields")
                return
            query_fields = {name: values[-1] for name, values in fields.items()}
            self._send(self.server.get[path](query_fields))
        else:
            self._refuse(404, "there is no such page; go to /")

    def do_POST(self) -> None:
        length = self.headers.get("Content-Length", "")
        if not length.isdecimal() or len(length) > 9 or int(length) > MAX_BODY:
            self.close_connection = True
            self._refuse(413, f"send at most {MAX_BODY} octets, and say how many")
            return
        if self.headers.get_content_type() != "application/json":
            self._refuse(415, "send JSON, as application/json")
            return
        call = self.server.post.get(self.path)
        if call is None:
            self._refuse(404, "there is nothing to send to here")
            return
        try:
            value = json.loads(self.rfile.read())
        except (ValueError, RecursionError):
            self._refuse(400, "this is no JSON")
            return
        self._send(call(value))

    def _refuse(self, status: int, text: str) -> None:
        self._send(Answer(status, f"{text}\n".encode(), "text/plain"))

    def _send(self, answer: Answer) -> None:
        text = answer.mime.startswith("text/")
        headers: tuple[tuple[str, str], ...] = _HEADERS
        if answer.about is not None:
            headers += (("X-About", json.dumps(answer.about)),)  # ASCII, as headers must be
        kind = f"{answer.mime}{'; charset=utf-8' if text else ''}"
        self.reply(answer.status, answer.body, kind, headers)


class Newest:
    """A version number for whose next change threads can wait; thread-safe."""

    def __init__(self) -> None:
        self._changed = threading.Condition()
        self.version = 0

    def __enter__(self) -> None:
        self._changed.acquire()

    def __exit__(self, *_: object) -> None:
        self._changed.release()

    def change(self) -> None:
        """Count a new version; call within ``with``."""
        self.version += 1
        self._changed.notify_all()

    def wait(self, version: int, seconds: float) -> None:
        """Wait up to ``seconds`` until the version is not ``version``; call within ``with``."""
        end = time.monotonic() + seconds
        while self.version == version and (left := end - time.monotonic()) > 0:
            self._changed.wait(left)


def number(query: dict[str, str], name: str) -> int:
    """Return a field of a query as a whole number; -1 if it is missing or is no such number."""
    text = query.get(name, "")
    return int(text) if text.isdecimal() and len(text) < 16 else -1


def show(url: str) -> bool:
    """Open a graphical browser at a URL; return whether there is one and it probably opened."""
    windows = sys.platform in ("darwin", "win32") or any(
        os.environ.get(name) for name in ("DISPLAY", "WAYLAND_DISPLAY", "BROWSER")
    )
    if not windows:  # a text browser would use this terminal
        return False
    import webbrowser

    try:
        return webbrowser.open(url)
    except webbrowser.Error:
        return False
