"""TCP faults: split and endless lengths, closed and full connections."""

import errno
import random
import select
import socket
import struct

import pytest
from support.agent import running_agent
from support.lines import SECONDS
from unit.agent.helpers import create_client, get_info, message
from unit.agent.transports.faults import (
    check_a_client_that_does_not_read_is_disconnected,
    wait_for,
)

from uros.agent.clock import Clock
from uros.agent.transports import tcp as module
from uros.agent.transports.base import TransportError
from uros.agent.transports.tcp import TcpServer
from uros.wire import ids
from uros.wire.framing import LengthDeframer

PING = message([get_info()], 0, 0, 0x80)


@pytest.fixture(scope="module")
def agent():
    with running_agent("tcp", "memory") as running:
        yield running


def framed(datagram):
    return len(datagram).to_bytes(2, "little") + datagram


def answers(sock, count):
    deframer, messages = LengthDeframer(), []
    while len(messages) < count:
        chunk = sock.recv(65536)
        assert chunk, "the agent closed the connection"
        messages += deframer.feed(chunk)
    return messages


def test_a_message_in_single_bytes(raw):
    for byte in framed(PING):
        raw.sendall(bytes([byte]))
    assert answers(raw, 1)[0][4] == ids.INFO


def test_messages_cut_anywhere(raw):
    rng = random.Random(3)
    stream = framed(PING) * 200
    while stream:
        size = rng.randrange(1, 60)
        raw.sendall(stream[:size])
        stream = stream[size:]
    assert len(answers(raw, 200)) == 200


def test_empty_messages_are_passed_over(raw):
    raw.sendall(b"\0\0" * 10_000 + framed(PING))
    assert len(answers(raw, 1)) == 1


def test_an_announced_length_that_never_arrives(raw, bystanders):
    raw.sendall(b"\xff\xff" + bytes(60_000))
    bystanders.check()
    raw.sendall(bytes(5535) + framed(PING))
    assert len(answers(raw, 1)) == 1


def test_random_bytes(raw):
    rng = random.Random(4)
    for _ in range(50):
        raw.sendall(rng.randbytes(4000))


@pytest.mark.parametrize("sent", [b"", b"\x10", framed(PING)[:-3]])
def test_an_abrupt_end(agent, bystanders, sent):
    sock = socket.create_connection(("127.0.0.1", agent.transport.port), SECONDS)
    sock.sendall(framed(create_client(0x77)) + sent)
    answers(sock, 1)
    closed = agent.said.getvalue().count("session closed")
    sock.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
    sock.close()  # RST
    wait_for(agent.said.getvalue, "session closed", closed + 1)
    bystanders.check()


def test_a_half_closed_connection_ends_its_session(agent, raw):
    raw.sendall(framed(create_client(0x78)))
    answers(raw, 1)
    raw.shutdown(socket.SHUT_WR)
    assert raw.recv(10) == b""
    wait_for(
        agent.said.getvalue, "client_key: 0x00000078", 4
    )  # the last line is the end of the session
    assert 0x78 not in agent.agent.clients


def test_a_client_that_does_not_read_is_disconnected_alone(agent, bystanders, monkeypatch):
    monkeypatch.setattr(module, "MAX_UNSENT", 200_000)
    check_a_client_that_does_not_read_is_disconnected(agent, bystanders)


def test_connections_over_the_limit_are_refused(agent, raw, monkeypatch):
    raw.sendall(framed(PING))
    answers(raw, 1)
    monkeypatch.setattr(module, "MAX_CONNECTIONS", len(agent.transport._connections))
    with socket.create_connection(("127.0.0.1", agent.transport.port), SECONDS) as second_socket:
        assert second_socket.recv(1) == b""
    wait_for(agent.said.getvalue, "connection refused", 1)  # said once the socket is closed
    monkeypatch.undo()
    with socket.create_connection(("127.0.0.1", agent.transport.port), SECONDS) as second_socket:
        second_socket.sendall(framed(PING))
        assert answers(second_socket, 1)


def test_connections_over_the_limit_write_few_log_lines(agent, raw, monkeypatch):
    before = agent.said.getvalue().count("connection refused")
    monkeypatch.setattr(module, "MAX_CONNECTIONS", len(agent.transport._connections))
    for _ in range(64):
        with socket.create_connection(
            ("127.0.0.1", agent.transport.port), SECONDS
        ) as second_socket:
            assert second_socket.recv(1) == b""
    assert agent.said.getvalue().count("connection refused") - before < 10


def test_messages_behind_the_one_that_ends_the_connection_are_not_handled(agent, raw, monkeypatch):
    """A session on a closed connection would never be deleted."""
    monkeypatch.setattr(module, "MAX_UNSENT", 0)  # the first answer is one too many
    raw.sendall(framed(PING) + framed(create_client(0x7C)))
    assert raw.recv(1) == b""
    assert 0x7C not in agent.agent.clients


def test_without_descriptors_the_listener_waits_and_does_not_spin():
    """accept() keeps failing; the listener is not polled for a while."""

    class Host:
        clock = Clock()

        def __init__(self):
            self.watched, self.later, self.said = [], [], []

        def watch(self, fileno, ready, writing=False):
            self.watched.append(fileno)

        def unwatch(self, fileno):
            self.watched.remove(fileno)

        def wake_at(self, seconds, call):
            self.later.append(call)

        def note(self, *words):
            self.said.append(words)

    class Full:
        def __init__(self, sock):
            self.sock = sock

        def accept(self):
            raise OSError(errno.EMFILE, "Too many open files")

        def __getattr__(self, name):
            return getattr(self.sock, name)

    host = Host()
    server = TcpServer(0, "127.0.0.1")
    server.open(host)
    try:
        listener = server._socket
        server._socket = Full(listener)
        server._accept()
        assert host.watched == []
        assert "Too many open files; connections wait" in host.said[-1][-1]
        server._socket = listener
        host.later.pop()()
        assert host.watched == [listener.fileno()]
    finally:
        server.close()
    assert not select.select([], [], [], 0)[0]


def test_a_port_in_use_says_what_to_do():
    with socket.create_server(("127.0.0.1", 0)) as port_owner:
        port = port_owner.getsockname()[1]
        with pytest.raises(TransportError) as caught:
            TcpServer(port, "127.0.0.1").open(None)
    assert f"TCP port {port} is in use" in str(caught.value)
