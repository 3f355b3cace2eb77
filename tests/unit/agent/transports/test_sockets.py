"""Frames over stream sockets: connecting and listening, what fails, and coming back."""

import errno
import os
import socket

import pytest
from support.lines import SECONDS, SerialLine
from support.portable import framed
from unit.agent.transports.bare_host import BareHost

from uros.agent.transports import sockets as module
from uros.agent.transports.base import INFO, TransportError
from uros.agent.transports.remedies import socket_trouble
from uros.agent.transports.sockets import SocketLineServer, StreamListener, tcp_line


@pytest.fixture
def host():
    bare_host = BareHost()
    yield bare_host
    bare_host.close()


class Board:
    """The peer that the agent connects to, over TCP or a Unix socket."""

    def __init__(self, family, folder):
        self.family = family
        self.address = ("127.0.0.1", 0) if family == socket.AF_INET else str(folder / "line")
        self.listener = self.sock = None

    def listen(self):
        self.listener = socket.socket(self.family, socket.SOCK_STREAM)
        self.listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        if self.family != socket.AF_INET and os.path.exists(self.address):
            os.unlink(self.address)
        self.listener.bind(self.address)
        self.address = self.listener.getsockname()
        self.listener.listen()
        self.listener.settimeout(SECONDS)

    def accept(self):
        self.sock = self.listener.accept()[0]
        return SerialLine(self.sock.fileno(), owned=False)

    def close(self):
        for sock in (self.listener, self.sock):
            if sock is not None:
                sock.close()

    def server(self, make=None):
        make = make or (lambda: socket.socket(self.family, socket.SOCK_STREAM))
        return SocketLineServer("the line", make, self.address, socket_trouble)


@pytest.fixture(params=["AF_INET", "AF_UNIX"])
def board(request, tmp_path):
    peer = Board(getattr(socket, request.param), tmp_path)
    peer.listen()
    yield peer
    peer.close()


def exchange(host, server, line, text):
    """Exchange a message in both directions."""
    line.send(text)
    host.until(lambda: host.messages and host.messages[-1] == (1, text), text)
    server.send(1, text[::-1])
    assert line._read() == [text[::-1]]


def test_connecting_and_coming_back(host, board):
    server = board.server()
    server.open(host)
    host.until(lambda: server.line.stream is not None)
    exchange(host, server, board.accept(), b"first")
    assert server.address(1) == "the line (1)"
    for turn in range(3):
        board.close()
        host.until(lambda turn=turn: host.said().count("device lost") > turn)
        host.fire()  # no socket listens
        host.until(lambda turn=turn: host.said().count("waiting for device") > turn)
        board.listen()
        host.fire()
        host.until(lambda: server.line.stream is not None)
        exchange(host, server, board.accept(), b"again %d" % turn)
    server.close()
    assert board.sock.recv(10) == b""


def test_a_missing_peer_is_awaited_and_logged_once(host):
    with socket.create_server(("127.0.0.1", 0)) as free:
        port = free.getsockname()[1]
    server = tcp_line(f"socket://127.0.0.1:{port}")
    server.open(host)
    for _ in range(3):
        host.until(lambda: host.calls)
        if server._pending is not None:
            host.until(lambda: server._pending is None)
        host.fire()
    host.until(lambda: server._pending is None)
    assert host.said().count("waiting for device") == 1
    assert host.notes[0][0] == INFO
    assert (
        f"device: socket://127.0.0.1:{port}, errno: {errno.ECONNREFUSED}, nothing listens there:"
        " start the program" in host.said()
    )
    server.close()


class Silent(socket.socket):
    """A socket whose connect never completes."""

    def __init__(self):
        super().__init__(socket.AF_INET, socket.SOCK_STREAM)
        self.bind(("127.0.0.1", 0))
        self.listen()  # never readable, and not connected

    def connect_ex(self, address):
        return errno.EINPROGRESS


def test_a_connect_that_does_not_complete_is_abandoned_and_retried(host):
    sockets = []

    def make():
        sockets.append(Silent())
        return sockets[-1]

    server = SocketLineServer("the line", make, None, socket_trouble)
    server.open(host)
    host.turn()
    assert [call[0] for call in host.calls] == [module.PATIENCE]
    host.fire()
    assert "the machine does not answer" in host.said() and sockets[0].fileno() == -1
    host.fire()
    assert len(sockets) == 2 and sockets[1].fileno() >= 0
    server.close()
    assert sockets[1].fileno() == -1
    host.fire()
    assert len(sockets) == 2


@pytest.mark.parametrize("call", ["make", "connect"])
def test_errors_of_opening_name_the_remedy_and_are_retried(host, board, call):
    errors = [errno.EAFNOSUPPORT, errno.ENETUNREACH]

    class Failing(socket.socket):
        def connect_ex(self, address):
            return errors.pop(0) if call == "connect" and errors else super().connect_ex(address)

    def make():
        if call == "make" and errors:
            raise OSError(errors.pop(0), "injected")
        return Failing(board.family, socket.SOCK_STREAM)

    server = board.server(make)
    server.open(host)
    host.fire()
    host.fire()
    host.until(lambda: server.line.stream is not None)
    assert host.said().count("open device error") == 2
    assert "there is no route to it: check the network" in host.said()
    exchange(host, server, board.accept(), b"works")
    server.close()


@pytest.mark.parametrize(
    ("url", "why"),
    [
        ("socket://", "write socket://host:port"),
        ("socket://host", "write socket://host:port"),
        ("socket://host:99999", "write socket://host:port"),
        ("socket://[:1", "write socket://host:port"),
        ("socket://no.such.host.invalid:1", "no.such.host.invalid cannot be resolved"),
        ("socket://" + "a" * 70 + ":1", "cannot be resolved"),
    ],
)
def test_invalid_lines_are_refused(url, why):
    with pytest.raises(TransportError, match=why):
        tcp_line(url)


# --- listening ---------------------------------------------------------------------------


def listener(make=None, name_of=lambda address: "board"):
    make = make or (lambda: socket.socket(socket.AF_INET, socket.SOCK_STREAM))
    return StreamListener("here", make, ("127.0.0.1", 0), name_of, socket_trouble)


def connect(server):
    sock = socket.create_connection(server._socket.getsockname(), SECONDS)
    return sock, SerialLine(sock.fileno(), owned=False)


def check_received(host, line, peer, text):
    line.send(text)
    host.until(lambda: (peer, text) in host.messages, text)


def test_many_lines_with_the_same_addresses(host):
    names = iter(["one", "two"])
    server = listener(name_of=lambda address: next(names))
    server.open(host)
    socks = []
    for name in ("one", "two"):
        sock, line = connect(server)
        socks.append((sock, line, name))
        host.until(lambda name=name: name in server.lines)
        check_received(host, line, (name, 1), b"I am " + name.encode())
    for _, line, name in socks:
        server.send((name, 1), b"you are " + name.encode())
        assert line._read() == [b"you are " + name.encode()]
        assert server.lines[name].frames == 1
    assert server.address(("one", 1)) == "one (1)"
    server.send(("nobody", 1), b"lost")
    server.close()
    server.close()  # close() is idempotent
    for sock, _, _ in socks:
        assert sock.recv(10) == b""
        sock.close()


def test_a_reconnection_under_the_same_name_replaces_the_line(host):
    server = listener()
    server.open(host)
    first, line = connect(server)
    check_received(host, line, ("board", 1), b"first")
    first.close()
    host.until(lambda: "connection lost" in host.said())
    assert server.lines["board"].stream is None
    server.send(("board", 1), b"lost")
    second, line = connect(server)
    check_received(host, line, ("board", 1), b"second")
    third, line = connect(
        server
    )  # the second connection was cut, which neither end has detected yet
    check_received(host, line, ("board", 1), b"third")
    server.send(("board", 1), b"for the third")
    assert line._read() == [b"for the third"]
    assert second.recv(10) == b""
    assert server.lines["board"].frames == 3
    server.close()
    for sock in (second, third):
        sock.close()


def test_the_number_of_connections_is_limited(host, monkeypatch):
    monkeypatch.setattr(module, "MAX_CONNECTIONS", 2)
    numbers = iter(range(100))
    server = listener(name_of=lambda address: str(next(numbers)))
    server.open(host)
    socks = [connect(server)[0] for _ in range(3)]
    host.until(lambda: "connection refused" in host.said())
    assert "over 2 connections" in host.said()
    assert sum(1 for line in server.lines.values() if line.stream) == 2
    socks.pop().close()
    for _ in range(10):  # closed lines are not kept for ever
        socks.pop(0).close()
        host.until(lambda: any(connection.stream is None for connection in server.lines.values()))
        sock, line = connect(server)
        socks.append(sock)
        count = len(host.messages)
        line.send(b"hello")
        host.until(lambda count=count: len(host.messages) > count)
    assert len(server.lines) <= 4
    server.close()
    for sock in socks:
        sock.close()


def test_noise_on_one_connection(host):
    server = listener()
    server.open(host)
    sock, line = connect(server)
    line.send_raw(b"\x7e\x01\x00\xff\xff" + bytes(300) + framed(b"sound", 1))
    host.until(lambda: (("board", 1), b"sound") in host.messages)
    server.close()
    sock.close()


class Pulled(socket.socket):
    """A listening socket whose adapter is removed."""

    def accept(self):
        raise OSError(errno.ENODEV, "injected")


def test_a_listening_socket_that_fails_is_opened_anew(host):
    kinds = [Pulled, socket.socket]
    server = listener(lambda: kinds.pop(0)(socket.AF_INET, socket.SOCK_STREAM))
    server.open(host)
    sock, _ = connect(server)
    host.until(lambda: "cannot listen" in host.said())
    assert server._socket is None and [call[0] for call in host.calls] == [module.RETRY]
    sock.close()
    host.fire()
    sock, line = connect(server)
    check_received(host, line, ("board", 1), b"hello")
    server.close()
    sock.close()


def test_a_listening_socket_that_cannot_be_opened_is_retried(host):
    port_owner = socket.create_server(("127.0.0.1", 0))
    server = StreamListener(
        "here", lambda: socket.socket(socket.AF_INET, socket.SOCK_STREAM), port_owner.getsockname(),
        str, socket_trouble,
    )  # fmt: skip
    server.open(host)
    host.fire()
    assert host.said().count(f"cannot listen | here, errno: {errno.EADDRINUSE}") == 1
    port_owner.close()
    host.fire()
    assert "running..." in host.said()
    server.close()
    host.fire()
