"""TCP connections that take resources: idle, slow, and many from one address."""

import socket
from contextlib import contextmanager
from types import SimpleNamespace

import pytest
from support.agent import running_agent
from support.client import XrceClient
from support.lines import SECONDS
from unit.agent.helpers import get_info, message
from unit.agent.transports.bare_host import BareHost
from unit.agent.transports.faults import Bystanders
from unit.agent.transports.test_tcp import PING, answers, framed

from uros.agent.transports import tcp as module
from uros.agent.transports.tcp import TcpServer
from uros.wire import ids

# A session that no message of these tests addresses.
SESSION = SimpleNamespace(session_id=0xFE)


class Host(BareHost):
    """Sessions with low ids exist for the peers in ``known_peers``."""

    def __init__(self, clock):
        super().__init__(clock)
        self.known_peers = []

    def gone(self, transport, peer):
        transport.sessions.pop(peer, None)

    def has_client(self, transport, peer):
        return peer in self.known_peers


class Clock:
    """The agent's clock, which a test sets."""

    def __init__(self):
        self.now = 1000.0

    def monotonic(self):
        return self.now


class Bench:
    def __init__(self):
        self.clock = Clock()
        self.host = Host(self.clock)
        self.server = TcpServer(0, "127.0.0.1")
        self.server.open(self.host)
        self.ends = []

    def connect(self, sent=b"", messages=0):
        """Connect; return the client's socket and the server's connection."""
        before = set(self.server._connections)
        sock = socket.create_connection(("127.0.0.1", self.server.port), SECONDS)
        self.ends.append(sock)
        self.host.until(lambda: set(self.server._connections) - before)
        (connection,) = set(self.server._connections) - before
        self.say(sock, sent, connection, messages)
        return sock, connection

    def say(self, sock, sent, connection, messages=0):
        """Send data; wait until the server has read all of it."""
        expected_count = len(self.host.messages) + messages
        if sent:
            fed = []
            feed = connection.deframer.feed
            connection.deframer = type("Seen", (), {
                "feed": lambda _, chunk: fed.append(len(chunk)) or feed(chunk),
                "pending": property(lambda _: inner.pending),
            })()  # fmt: skip
            inner = feed.__self__
            sock.sendall(sent)
            self.host.until(lambda: sum(fed) == len(sent))
            connection.deframer = inner
        assert len(self.host.messages) == expected_count

    def after(self, seconds):
        self.clock.now += seconds
        self.host.fire()

    def closed(self, sock):
        sock.setblocking(False)
        try:
            return sock.recv(1) == b""
        except BlockingIOError:
            return False


@pytest.fixture
def bench():
    new_bench = Bench()
    yield new_bench
    for sock in new_bench.ends:
        sock.close()
    new_bench.server.close()
    new_bench.host.close()


def test_a_silent_connection_is_closed(bench):
    silent, _ = bench.connect()
    bench.after(module.IDLE_SECONDS - 1)
    assert not bench.closed(silent)
    late_socket, _ = bench.connect()
    bench.after(2)
    assert bench.closed(silent) and not bench.closed(late_socket)
    assert "no session, and silent for 30 s" in bench.host.said()


def test_a_connection_that_only_pings_is_served_as_long_as_it_pings(bench):
    sock, connection = bench.connect(framed(PING), 1)
    for _ in range(5):
        bench.after(module.IDLE_SECONDS - 1)
        bench.say(sock, framed(PING), connection, 1)
        assert not bench.closed(sock)
    bench.after(module.IDLE_SECONDS + 1)
    assert bench.closed(sock)


def test_sessions_may_be_silent(bench):
    """A subscriber says nothing for hours; the agent probes it."""
    high, high_connection = bench.connect(framed(message([get_info()], 1, 0, 0x81)), 1)
    bench.server.sessions[high_connection] = SESSION
    low, low_connection = bench.connect(framed(message([get_info()], 1, 0, 0x01)), 1)
    bench.host.known_peers.append(low_connection)
    liar, _ = bench.connect(framed(message([get_info()], 1, 0, 0x01)), 1)
    bench.after(100 * module.IDLE_SECONDS)
    assert not bench.closed(high) and not bench.closed(low)
    assert bench.closed(liar)


def test_a_message_that_is_never_complete_ends_its_connection_with_or_without_a_session(bench):
    whole = framed(message([get_info()], 1, 0, 0x81))
    sock, connection = bench.connect(whole, 1)
    bench.server.sessions[connection] = SESSION
    bench.say(sock, whole + b"\xff\xff" + bytes(10), connection, 1)
    for _ in range(3):  # single bytes in between do not help
        bench.after(module.IDLE_SECONDS / 4)
        bench.say(sock, b"\0", connection)
    assert not bench.closed(sock)
    bench.after(module.IDLE_SECONDS / 4 + 1)
    assert bench.closed(sock)
    assert "not whole after 30 s" in bench.host.said()
    assert not bench.server.sessions


def test_a_message_that_begins_after_a_long_silence_gets_its_full_time(bench):
    whole = framed(message([get_info()], 1, 0, 0x81))
    sock, connection = bench.connect(whole, 1)
    bench.server.sessions[connection] = SESSION
    bench.after(10 * module.IDLE_SECONDS)
    bench.say(sock, whole[:5], connection)
    bench.after(1)
    assert not bench.closed(sock)
    bench.say(sock, whole[5:], connection, 1)
    bench.after(10 * module.IDLE_SECONDS)
    assert not bench.closed(sock)


def test_idle_connections_write_few_log_lines(bench):
    for _ in range(40):
        bench.connect()
    bench.after(module.IDLE_SECONDS + 1)
    assert not bench.server._connections and not bench.server._from
    assert len(bench.host.warnings()) <= 6
    assert bench.host.calls == []  # without connections, nothing is checked
    bench.connect()
    assert len(bench.host.calls) == 1


def test_one_address_has_a_limited_share_of_the_connections(bench, monkeypatch):
    monkeypatch.setattr(module, "MAX_FROM_ONE", 3)
    sockets = [bench.connect()[0] for _ in range(3)]
    over = socket.create_connection(("127.0.0.1", bench.server.port), SECONDS)
    bench.ends.append(over)
    bench.host.until(lambda: "over 3 connections from one address" in bench.host.said())
    other_socket = socket.create_connection(
        ("127.0.0.1", bench.server.port), SECONDS, source_address=("127.0.0.2", 0)
    )
    bench.ends.append(other_socket)
    bench.host.until(lambda: len(bench.server._connections) == 4)
    sockets.pop().close()
    bench.host.until(lambda: len(bench.server._connections) == 3)
    bench.connect()


@pytest.mark.parametrize(
    ("address", "other_address", "alike"),
    [
        ("192.0.2.1", "192.0.2.2", False),
        ("192.0.2.1", "::ffff:192.0.2.1", True),
        ("2001:db8::1", "2001:db8::ffff:1", True),
        ("2001:db8::1", "2001:db8:0:1::1", False),
        ("fe80::1%lo", "fe80::2", True),
    ],
)
def test_which_peers_share_an_origin(address, other_address, alike):
    networks = {module._network((host, 1, 0, 0)) for host in (address, other_address)}
    assert (len(networks) == 1) == alike


def test_unsent_messages_of_all_slow_readers_together_are_limited(bench, monkeypatch):
    monkeypatch.setattr(module, "MAX_UNSENT_OF_ALL", 3_000_000)
    peers = []
    for _ in range(3):
        sock, connection = bench.connect()
        sock.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        connection.sock.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, 4096)
        peers.append((sock, connection))
    small_peers, worst = peers[:2], peers[2]
    for count, (_, connection) in zip((15, 15, 40), (*small_peers, worst), strict=True):
        for _ in range(count):
            bench.server.send(connection, bytes(60_000))
            total = sum(
                len(peer_connection.unsent) for peer_connection in bench.server._connections
            )
            assert bench.server._unsent == total <= 3_000_000
    assert worst[1] not in bench.server._connections
    assert all(connection in bench.server._connections for _, connection in small_peers)
    assert "3000000 bytes wait for clients that do not read" in bench.host.said()
    sock, connection = small_peers[0]
    before = len(connection.unsent)
    while (
        before - len(connection.unsent) < 20_000
    ):  # a client that reads in the end gets its messages
        sock.recv(1 << 20)
        bench.host.turn(0.01)
    assert bench.server._unsent == sum(
        len(peer_connection.unsent) for _, peer_connection in small_peers
    )
    for each, _ in small_peers:
        each.close()
    bench.host.until(lambda: not bench.server._connections)
    assert bench.server._unsent == 0


@contextmanager
def connections(port, count):
    sockets = []
    try:
        for _ in range(count):
            sockets.append(socket.create_connection(("127.0.0.1", port), SECONDS))
        yield sockets
    finally:
        for sock in sockets:
            sock.close()


def test_the_connections_of_one_address_are_limited_and_others_are_served(monkeypatch):
    """Slow ones: each sends a byte of a length that never comes."""
    with running_agent("tcp", "memory") as agent:
        bystanders = Bystanders(agent)
        port = agent.transport.port
        with connections(port, module.MAX_FROM_ONE + 20) as sockets:
            for number, sock in enumerate(sockets):
                try:
                    sock.sendall(b"\xff\xff" + bytes(number % 7))
                except OSError:
                    pass  # already refused
            bystanders.check()
            with socket.create_connection(
                ("127.0.0.1", port), SECONDS, source_address=("127.0.0.2", 0)
            ) as other_socket:
                other_socket.sendall(framed(PING))
                assert answers(other_socket, 1)
        assert len(agent.transport._connections) <= module.MAX_FROM_ONE + 1


def test_a_session_on_tcp_goes_on_after_the_others_were_closed(monkeypatch):
    """End to end: the timer of the server, a silent session, and a silent bare connection."""
    monkeypatch.setattr(module, "IDLE_SECONDS", 1.0)
    monkeypatch.setattr(module, "_SWEEP_SECONDS", 0.05)
    with running_agent("tcp", "memory") as agent:
        high = XrceClient(agent.line(), 0x31)
        low = XrceClient(agent.line(), 0x32, session_id=0x02)
        assert high.open() == low.open() == ids.STATUS_OK
        writer = high.writer("a", "rt/a", "a::msg::dds_::A_")
        reader = low.reader("b", "rt/a", "a::msg::dds_::A_")
        low.read(reader)
        with socket.create_connection(("127.0.0.1", agent.transport.port), SECONDS) as silent:
            assert silent.recv(1) == b""
        high.write(writer, b"still here")
        assert low.sample(reader) == b"still here"
