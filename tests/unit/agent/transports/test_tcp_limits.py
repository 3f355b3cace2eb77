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

# One that no message of these tests is for.
SESSION = SimpleNamespace(session_id=0xFE)


class Host(BareHost):
    """Sessions of low ids are those that ``residents`` names."""

    def __init__(self, clock):
        super().__init__(clock)
        self.residents = []

    def gone(self, transport, peer):
        transport.sessions.pop(peer, None)

    def has_client(self, transport, peer):
        return peer in self.residents


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
        """Our end and the server's."""
        before = set(self.server._connections)
        sock = socket.create_connection(("127.0.0.1", self.server.port), SECONDS)
        self.ends.append(sock)
        self.host.until(lambda: set(self.server._connections) - before)
        (one,) = set(self.server._connections) - before
        self.say(sock, sent, one, messages)
        return sock, one

    def say(self, sock, sent, one, messages=0):
        """The server has it all when this returns."""
        there = len(self.host.messages) + messages
        if sent:
            fed = []
            feed = one.deframer.feed
            one.deframer = type("Seen", (), {
                "feed": lambda _, chunk: fed.append(len(chunk)) or feed(chunk),
                "pending": property(lambda _: inner.pending),
            })()  # fmt: skip
            inner = feed.__self__
            sock.sendall(sent)
            self.host.until(lambda: sum(fed) == len(sent))
            one.deframer = inner
        assert len(self.host.messages) == there

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
    one = Bench()
    yield one
    for sock in one.ends:
        sock.close()
    one.server.close()
    one.host.close()


def test_a_connection_that_says_nothing_is_closed(bench):
    silent, _ = bench.connect()
    bench.after(module.IDLE_SECONDS - 1)
    assert not bench.closed(silent)
    late, _ = bench.connect()
    bench.after(2)
    assert bench.closed(silent) and not bench.closed(late)
    assert "no session, and silent for 30 s" in bench.host.said()


def test_one_that_only_pings_is_served_as_long_as_it_pings(bench):
    sock, one = bench.connect(framed(PING), 1)
    for _ in range(5):
        bench.after(module.IDLE_SECONDS - 1)
        bench.say(sock, framed(PING), one, 1)
        assert not bench.closed(sock)
    bench.after(module.IDLE_SECONDS + 1)
    assert bench.closed(sock)


def test_sessions_may_be_silent(bench):
    """A subscriber says nothing for hours; the agent probes it."""
    high, there = bench.connect(framed(message([get_info()], 1, 0, 0x81)), 1)
    bench.server.sessions[there] = SESSION
    low, one = bench.connect(framed(message([get_info()], 1, 0, 0x01)), 1)
    bench.host.residents.append(one)
    liar, _ = bench.connect(framed(message([get_info()], 1, 0, 0x01)), 1)
    bench.after(100 * module.IDLE_SECONDS)
    assert not bench.closed(high) and not bench.closed(low)
    assert bench.closed(liar)


def test_a_message_that_never_is_whole_ends_its_connection_with_a_session_or_without(bench):
    whole = framed(message([get_info()], 1, 0, 0x81))
    sock, one = bench.connect(whole, 1)
    bench.server.sessions[one] = SESSION
    bench.say(sock, whole + b"\xff\xff" + bytes(10), one, 1)
    for _ in range(3):  # a byte now and then does not help
        bench.after(module.IDLE_SECONDS / 4)
        bench.say(sock, b"\0", one)
    assert not bench.closed(sock)
    bench.after(module.IDLE_SECONDS / 4 + 1)
    assert bench.closed(sock)
    assert "not whole after 30 s" in bench.host.said()
    assert not bench.server.sessions


def test_a_message_that_has_just_begun_after_a_long_silence_is_waited_for(bench):
    whole = framed(message([get_info()], 1, 0, 0x81))
    sock, one = bench.connect(whole, 1)
    bench.server.sessions[one] = SESSION
    bench.after(10 * module.IDLE_SECONDS)
    bench.say(sock, whole[:5], one)
    bench.after(1)
    assert not bench.closed(sock)
    bench.say(sock, whole[5:], one, 1)
    bench.after(10 * module.IDLE_SECONDS)
    assert not bench.closed(sock)


def test_a_flood_of_idle_connections_is_no_flood_of_lines(bench):
    for _ in range(40):
        bench.connect()
    bench.after(module.IDLE_SECONDS + 1)
    assert not bench.server._connections and not bench.server._from
    assert len(bench.host.warnings()) <= 6
    assert bench.host.calls == []  # nothing is looked at where nobody is
    bench.connect()
    assert len(bench.host.calls) == 1


def test_one_address_gets_its_share_and_others_theirs(bench, monkeypatch):
    monkeypatch.setattr(module, "MAX_FROM_ONE", 3)
    kept = [bench.connect()[0] for _ in range(3)]
    over = socket.create_connection(("127.0.0.1", bench.server.port), SECONDS)
    bench.ends.append(over)
    bench.host.until(lambda: "over 3 connections from one address" in bench.host.said())
    other = socket.create_connection(
        ("127.0.0.1", bench.server.port), SECONDS, source_address=("127.0.0.2", 0)
    )
    bench.ends.append(other)
    bench.host.until(lambda: len(bench.server._connections) == 4)
    kept.pop().close()
    bench.host.until(lambda: len(bench.server._connections) == 3)
    bench.connect()


@pytest.mark.parametrize(
    ("one", "other", "alike"),
    [
        ("192.0.2.1", "192.0.2.2", False),
        ("192.0.2.1", "::ffff:192.0.2.1", True),
        ("2001:db8::1", "2001:db8::ffff:1", True),
        ("2001:db8::1", "2001:db8:0:1::1", False),
        ("fe80::1%lo", "fe80::2", True),
    ],
)
def test_which_peers_share_an_origin(one, other, alike):
    networks = {module._network((it, 1, 0, 0)) for it in (one, other)}
    assert (len(networks) == 1) == alike


def test_what_waits_for_all_slow_readers_together_has_an_end(bench, monkeypatch):
    monkeypatch.setattr(module, "MAX_UNSENT_OF_ALL", 3_000_000)
    peers = []
    for _ in range(3):
        sock, one = bench.connect()
        sock.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        one.sock.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, 4096)
        peers.append((sock, one))
    others, worst = peers[:2], peers[2]
    for count, (_, one) in zip((15, 15, 40), (*others, worst), strict=True):
        for _ in range(count):
            bench.server.send(one, bytes(60_000))
            total = sum(len(it.unsent) for it in bench.server._connections)
            assert bench.server._unsent == total <= 3_000_000
    assert worst[1] not in bench.server._connections
    assert all(one in bench.server._connections for _, one in others)
    assert "3000000 bytes wait for clients that do not read" in bench.host.said()
    sock, one = others[0]
    before = len(one.unsent)
    while before - len(one.unsent) < 20_000:  # who reads after all gets it
        sock.recv(1 << 20)
        bench.host.turn(0.01)
    assert bench.server._unsent == sum(len(it.unsent) for _, it in others)
    for each, _ in others:
        each.close()
    bench.host.until(lambda: not bench.server._connections)
    assert bench.server._unsent == 0


@contextmanager
def connections(port, count):
    made = []
    try:
        for _ in range(count):
            made.append(socket.create_connection(("127.0.0.1", port), SECONDS))
        yield made
    finally:
        for sock in made:
            sock.close()


def test_as_many_connections_as_one_may_have_and_others_are_served(monkeypatch):
    """Slow ones: each sends a byte of a length that never comes."""
    with running_agent("tcp", "memory") as agent:
        bystanders = Bystanders(agent)
        port = agent.transport.port
        with connections(port, module.MAX_FROM_ONE + 20) as made:
            for number, sock in enumerate(made):
                try:
                    sock.sendall(b"\xff\xff" + bytes(number % 7))
                except OSError:
                    pass  # refused already
            bystanders.check()
            with socket.create_connection(
                ("127.0.0.1", port), SECONDS, source_address=("127.0.0.2", 0)
            ) as other:
                other.sendall(framed(PING))
                assert answers(other, 1)
        assert len(agent.transport._connections) <= module.MAX_FROM_ONE + 1


def test_a_session_on_tcp_goes_on_after_the_others_were_closed(monkeypatch):
    """The whole way: the server's timer, a real session that is silent, and a silent stranger."""
    monkeypatch.setattr(module, "IDLE_SECONDS", 0.2)
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
