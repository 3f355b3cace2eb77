"""The server of pages, by a plain HTTP client: content policy, accepted requests, time limits."""

import http.client
import json
import re
import socket
import threading
from importlib import resources

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from support.examples import examples
from support.waiting import eventually

from uros import http_server as http_server
from uros.dashboard import serve
from uros.dashboard.serve import Answer, Newest, Pages, as_json, number

PAGES = resources.files("uros.dashboard").joinpath("pages")


def echo(query):
    return as_json(query)


@pytest.fixture
def pages():
    pages = Pages(
        "127.0.0.1", 0, ("image.html", "page.css", "image.js"),
        {"/echo": echo, "/empty": lambda _: Answer(200, b"", "text/plain", {"é": "\n"})},
        {"/post": lambda value: as_json({"received": value})},
    )  # fmt: skip
    yield pages
    pages.close()


def ask(pages, path, method="GET", body=None, **headers):
    connection = http.client.HTTPConnection("127.0.0.1", pages.port, timeout=10)
    try:
        connection.request(
            method, path, body, {name.replace("_", "-"): text for name, text in headers.items()}
        )
        answer = connection.getresponse()
        return answer.status, answer.read(), answer.headers
    finally:
        connection.close()


def test_the_pages(pages):
    for path, mime in (
        ("/", "text/html"), ("/image.html", "text/html"), ("/page.css", "text/css"),
        ("/image.js", "text/javascript"),
    ):  # fmt: skip
        status, body, headers = ask(pages, path)
        assert status == 200 and headers["Content-Type"] == f"{mime}; charset=utf-8"
        assert len(body) > 500
    assert pages.url == f"http://127.0.0.1:{pages.port}/"


@pytest.mark.parametrize("path", ["/nothing", "/pid.html", "/../serve.py", "/%2e%2e/serve.py"])
def test_other_paths_are_not_found(pages, path):
    assert ask(pages, path)[0] == 404


def test_the_query_is_passed_to_the_handler(pages):
    status, body, _ = ask(pages, "/echo?a=1&a=2&b=%20x")
    assert (status, json.loads(body)) == (200, {"a": "2", "b": " x"})


def test_values_in_a_header_beside_the_body(pages):
    status, body, headers = ask(pages, "/empty")
    assert (status, body) == (200, b"")
    assert json.loads(headers["X-About"]) == {"é": "\n"}


def test_the_policy_allows_no_other_origin(pages):
    headers = ask(pages, "/")[2]
    assert "default-src 'none'" in headers["Content-Security-Policy"]
    assert "unsafe" not in headers["Content-Security-Policy"]
    assert headers["X-Content-Type-Options"] == "nosniff"
    assert headers["Cache-Control"] == "no-store"


@pytest.mark.parametrize("file", [file.name for file in PAGES.iterdir()])
def test_no_file_needs_the_internet(file):
    text = PAGES.joinpath(file).read_text("utf-8")
    assert not re.findall(r"(?:https?:)?//[\w.]+\.\w+", text)
    assert "style=" not in text and not re.search(r"<script>|\son\w+=", text)  # the policy
    assert ".innerHTML" not in text  # text from outside is never HTML


@pytest.mark.parametrize(
    ("host", "status"),
    [
        ("127.0.0.1", 200), ("localhost:80", 200), ("[::1]:8", 200), ("192.168.1.7:8090", 200),
        (socket.gethostname(), 200), ("evil.example", 403), ("", 403), ("[x", 403),
    ],
)  # fmt: skip
def test_foreign_host_names_are_rejected(pages, host, status):
    assert ask(pages, "/echo", Host=host)[0] == status


def test_foreign_origins_are_rejected(pages):
    headers = {"Host": "127.0.0.1:5", "Content_Type": "application/json"}
    assert ask(pages, "/post", "POST", "{}", Origin="http://evil.example", **headers)[0] == 403
    assert ask(pages, "/post", "POST", "{}", Origin="null", **headers)[0] == 403
    assert ask(pages, "/post", "POST", "{}", Origin="http://127.0.0.1:5", **headers)[0] == 200


def test_only_json_changes_anything(pages):
    status, body, _ = ask(pages, "/post", "POST", '{"a": 1}', Content_Type="application/json")
    assert (status, json.loads(body)) == (200, {"received": {"a": 1}})
    assert ask(pages, "/post", "POST", "a=1")[0] == 415
    assert ask(pages, "/post", "POST", "{}", Content_Type="text/plain")[0] == 415
    json_type = {"Content_Type": "application/json; charset=utf-8"}
    assert ask(pages, "/post", "POST", "{", **json_type)[0] == 400
    assert ask(pages, "/post", "POST", "[" * 4000, **json_type)[0] == 400
    assert ask(pages, "/echo", "POST", "{}", **json_type)[0] == 404
    assert ask(pages, "/post", "POST", "1" * 5000, **json_type)[0] == 413
    assert ask(pages, "/post", "POST", None, Content_Length="x", **json_type)[0] == 413


@pytest.mark.parametrize(
    "octets", [b"", b"GET /ech", b"POST /post HTTP/1.1\r\nContent-Length: 9\r\n\r\n{"]
)
def test_connections_without_end(pages, octets):
    """A full request is answered although incomplete ones fill all connections."""
    connections = []
    for _ in range(2 * http_server.MAX_CONNECTIONS):
        connections.append(socket.create_connection(("127.0.0.1", pages.port)))
        connections[-1].sendall(octets)
    assert ask(pages, "/")[0] == 200
    assert pages._http.connections <= http_server.MAX_CONNECTIONS
    for connection in connections:
        connection.close()
    eventually(lambda: not pages._http.connections)


def test_further_connections_get_503_while_all_are_being_answered(monkeypatch):
    monkeypatch.setattr(http_server, "MAX_CONNECTIONS", 4)
    go_on = threading.Event()
    pages = Pages("127.0.0.1", 0, ("image.html",), {"/w": lambda _: go_on.wait(10) and as_json(1)})
    clients = []
    for _ in range(4):
        clients.append(socket.create_connection(("127.0.0.1", pages.port)))
        clients[-1].sendall(b"GET /w HTTP/1.1\r\nHost: localhost\r\n\r\n")
    eventually(lambda: len(pages._http._answering) == 4)
    with socket.create_connection(("127.0.0.1", pages.port)) as late:
        assert late.recv(100).startswith(b"HTTP/1.1 503 Busy")
    go_on.set()
    for client in clients:
        assert client.recv(100).startswith(b"HTTP/1.1 200 ")
        client.close()
    eventually(lambda: not pages._http.connections)
    pages.close()


@pytest.mark.parametrize("octets", [b"", b"GET /ech"])
def test_a_silent_connection_is_closed(octets, monkeypatch):
    monkeypatch.setattr(http_server, "ASK_SECONDS", 0.05)
    pages = Pages("127.0.0.1", 0, ("image.html",), {})
    with socket.create_connection(("127.0.0.1", pages.port)) as silent:
        silent.sendall(octets)
        silent.settimeout(10)
        assert silent.recv(100) == b""
    pages.close()


def test_a_client_that_does_not_read_is_disconnected(monkeypatch):
    monkeypatch.setattr(http_server, "ANSWER_SECONDS", 0.05)
    large = Answer(200, bytes(32 * 1024 * 1024), "text/plain")
    pages = Pages("127.0.0.1", 0, ("image.html",), {"/large": lambda _: large})
    with socket.create_connection(("127.0.0.1", pages.port)) as client:
        client.sendall(b"GET /large HTTP/1.1\r\nHost: localhost\r\n\r\n")
        eventually(lambda: pages._http._answering)
        eventually(lambda: not pages._http._answering)
    assert ask(pages, "/")[0] == 200
    pages.close()


def test_several_requests_on_one_connection_in_any_pieces(pages):
    request = b"GET /echo?a=%d HTTP/1.1\r\nHost: localhost\r\n\r\n"
    whole = b"".join(request % number for number in range(5))
    for size in (1, 7, len(whole)):
        with socket.create_connection(("127.0.0.1", pages.port)) as connection:
            for at in range(0, len(whole), size):
                connection.sendall(whole[at : at + size])
            connection.settimeout(10)
            replies = b""
            while replies.count(b'{"a": ') < 5:
                replies += connection.recv(4096)
            places = [replies.index(b'{"a": "%d"}' % number) for number in range(5)]
            assert places == sorted(places)


def test_a_query_of_many_fields_is_rejected(pages, capfd):
    query = "&".join(f"f{number}=1" for number in range(1000))
    status, body, _ = ask(pages, f"/echo?{query}")
    assert status == 400 and b"at most 8 fields" in body
    assert ask(pages, "/echo?" + "=&;%ff" * 100)[0] in (200, 400)
    assert ask(pages, "/post", "POST", None, Content_Length="9" * 5000)[0] == 413
    assert capfd.readouterr().err == ""


@settings(max_examples=examples(60), suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.binary(max_size=200), st.booleans())
def test_any_octets_are_answered_or_dropped(pages, octets, headed):
    with socket.create_connection(("127.0.0.1", pages.port)) as connection:
        head = b"GET /echo HTTP/1.1\r\nHost: localhost\r\n" if headed else b""
        connection.sendall(head + octets + b"\r\n\r\n")
        connection.shutdown(socket.SHUT_WR)
        connection.settimeout(10)
        while connection.recv(4096):
            pass


def test_any_request_line(pages):
    for line in (b"\xff\xfe\r\n\r\n", b"GET\r\n\r\n", b"GET / HTTP/9.9\r\n\r\n", b"\r\n\r\n"):
        with socket.create_connection(("127.0.0.1", pages.port)) as connection:
            connection.sendall(line)
            connection.shutdown(socket.SHUT_WR)
            connection.settimeout(10)
            while connection.recv(4096):
                pass
    assert ask(pages, "/")[0] == 200


def test_close_does_not_wait_for_open_requests():
    newest = Newest()

    def wait(_):
        with newest:
            newest.wait(newest.version, 5)
        return as_json({})

    pages = Pages("127.0.0.1", 0, ("image.html",), {"/wait": wait})
    with socket.create_connection(("127.0.0.1", pages.port)) as connection:
        connection.sendall(b"GET /wait HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n")
        eventually(lambda: pages._http._answering)
        pages.close()
        connection.settimeout(4)
        try:
            assert connection.recv(100) == b""
        except ConnectionResetError:
            pass
    with newest:
        newest.change()


def test_a_port_in_use():
    with socket.create_server(("127.0.0.1", 0)) as taken:
        with pytest.raises(OSError):
            Pages("127.0.0.1", taken.getsockname()[1], ("image.html",), {})


def test_a_new_version_ends_the_wait():
    newest, versions = Newest(), []

    def wait():
        with newest:
            newest.wait(0, 10)
            versions.append(newest.version)

    waiting = threading.Thread(target=wait)
    waiting.start()
    with newest:
        newest.change()
    waiting.join(10)
    assert versions == [1]
    with newest:
        newest.wait(1, 0.01)  # no new version: the timeout ends the wait
        newest.wait(0, 10)  # a newer version: no wait


def test_numbers_of_a_query():
    assert [number({"a": text}, "a") for text in ("7", "", "-1", "x", "9" * 20)] == [
        7,
        -1,
        -1,
        -1,
        -1,
    ]
    assert number({}, "a") == -1


def test_no_browser_takes_the_terminal(monkeypatch):
    import webbrowser

    opened = []
    monkeypatch.setattr(webbrowser, "open", lambda url: opened.append(url) or True)
    monkeypatch.setattr(serve.sys, "platform", "linux")
    for name in ("DISPLAY", "WAYLAND_DISPLAY", "BROWSER"):
        monkeypatch.delenv(name, raising=False)
    assert not serve.show("http://x") and not opened
    monkeypatch.setenv("DISPLAY", ":0")
    assert serve.show("http://x") and opened == ["http://x"]
