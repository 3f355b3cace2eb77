"""Discovery of the agent by a board: requests, answers, and missing answers.

The answers come from sockets of the test; contract/test_client_discovery.py has real agents.
"""

import errno
import socket
import struct
import threading

import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.lines import SECONDS
from unit.agent.transports.test_discovery import C_QUESTION

from uros.agent.transports import discovery
from uros.agent.transports.discovery import write_answer
from uros.ticks import ticks_diff, ticks_ms
from uros.transport import discovery as discoveryboard
from uros.transport.discovery import (
    AGENTS,
    QUESTION,
    DiscoveringTransport,
    agents_of,
    discover_agent,
)
from uros.wire import ids, session
from uros.wire.errors import DecodeError
from uros.wire.header import MessageWriter

ASKED = (ids.SESSION_NONE_WITHOUT_KEY, 0, 9, ids.OBJECT_AGENT)
# By hand, from the order and sizes of the fields in the specification: an agent at 192.0.2.7:8888.
BY_HAND = bytes.fromhex(
    "80 00 0000 06 01 2400 0009 fffd 00 00 01 0d 58524345 0100 010f 00 01 0d 00 0100 0000 01000000"
    "01 c0000207 00 b822"
)

MANY = [f"192.0.2.{i}" for i in range(30, 10, -1)]


def answer(*locators):
    octets = [(socket.inet_pton(socket.AF_INET6 if ":" in host else socket.AF_INET, host), port)
              for host, port in locators]  # fmt: skip
    return write_answer(ASKED, octets)


class Answering:
    """A socket that receives requests and sends the datagrams of the test."""

    def __init__(self):
        self.sock = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.sock.bind(("127.0.0.1", 0))
        self.sock.settimeout(SECONDS)
        self.port = self.sock.getsockname()[1]
        self.addresses = (("127.0.0.1", self.port),)

    def take(self):
        """Return the next datagram; keep its sender as ``peer``."""
        data, self.peer = self.sock.recvfrom(2000)
        return data

    def say(self, *datagrams):
        for datagram in datagrams:
            self.sock.sendto(datagram, self.peer)


@pytest.fixture
def place():
    responder = Answering()
    yield responder
    responder.sock.close()


@pytest.fixture
def make_transport():
    """Create transports, and close them at the end."""
    transports = []

    def make(*arguments, **options):
        transports.append(DiscoveringTransport(*arguments, **options))
        return transports[-1]

    yield make
    for transport in transports:
        transport.close()
        transport.close()


# --- the question and its answers ----------------------------------------------------------------


def test_the_question_is_that_of_the_c_client():
    w = MessageWriter(bytearray(64), ids.SESSION_NONE_WITHOUT_KEY, ids.STREAM_NONE, 0)
    w.begin(ids.GET_INFO)
    session.push_get_info(w, 9, ids.OBJECT_AGENT, ids.INFO_CONFIGURATION | ids.INFO_ACTIVITY)
    assert w.finish() == QUESTION == C_QUESTION
    assert discovery.read_question(QUESTION, len(QUESTION)) == ASKED


def test_requests_are_sent_where_agents_listen():
    assert AGENTS == ((discovery.GROUP, discovery.DEFAULT_PORT),)


def test_an_answer_by_hand():
    assert agents_of(BY_HAND) == [("192.0.2.7", 8888)]


def test_a_big_endian_answer():
    datagram = BY_HAND[:5] + b"\0" + BY_HAND[6:28] + struct.pack(">hxxI", 1, 1)
    datagram += BY_HAND[-8:-2] + BY_HAND[-1:] + BY_HAND[-2:-1]
    assert agents_of(datagram) == [("192.0.2.7", 8888)]


@pytest.mark.parametrize(
    ("locators", "source", "agents"),
    [
        # eProsima's agent sends all addresses of its machine, loopback first.
        (["127.0.0.1", "172.17.0.1", "192.0.2.7"], "192.0.2.7",
         ["192.0.2.7", "172.17.0.1", "127.0.0.1"]),
        (["127.0.0.1", "192.0.2.7", "172.17.0.1"], "", ["192.0.2.7", "172.17.0.1", "127.0.0.1"]),
        (["192.0.2.7", "127.0.0.1"], "127.0.0.1", ["127.0.0.1", "192.0.2.7"]),
        (["0.0.0.0"], "192.0.2.7", ["192.0.2.7"]),
        (["::"], "192.0.2.7", ["192.0.2.7"]),
        (["0.0.0.0"], "", []),
        (["2001:db8::2", "192.0.2.7"], "192.0.2.8", ["192.0.2.7", "2001:db8:0:0:0:0:0:2"]),
        (["::1"], "192.0.2.7", ["0:0:0:0:0:0:0:1"]),
        (["fe80::1", "ff02::1", "239.255.0.2", "255.255.255.255"], "192.0.2.7", []),
        (["192.0.2.7", "0.0.0.0", "192.0.2.7"], "192.0.2.7", ["192.0.2.7"]),
        (MANY, "192.0.2.7", MANY),
        ([], "192.0.2.7", []),
    ],
)  # fmt: skip
def test_locators_of_an_answer_are_ranked(locators, source, agents):
    w = MessageWriter(bytearray(1000), ids.SESSION_NONE_WITHOUT_KEY, ids.STREAM_NONE, 0)
    w.begin(ids.INFO)
    octets = [socket.inet_pton(socket.AF_INET6 if ":" in locator else socket.AF_INET, locator)
              for locator in locators]  # fmt: skip
    session.push_info(w, 9, ids.OBJECT_AGENT, 0, 0, [(address, 8888) for address in octets])
    assert agents_of(w.finish(), source) == [(agent, 8888) for agent in agents]


def test_invalid_ports_are_skipped():
    datagram = answer(("2001:db8::2", 8888), ("192.0.2.7", 0))
    with_large_port = datagram[:56] + struct.pack("<I", 70000) + datagram[60:]
    assert datagram[56:60] == struct.pack("<I", 8888)
    assert agents_of(datagram) == [("2001:db8:0:0:0:0:0:2", 8888)]
    assert agents_of(with_large_port) == []


@pytest.mark.parametrize(
    "datagram",
    [
        b"", b"\x80", b"hello, who is there?", QUESTION,
        BY_HAND[:-1],
        BY_HAND[:8] + b"\0\x0a" + BY_HAND[10:],  # the answer to a ping
        BY_HAND[:10] + b"\xff\xff" + BY_HAND[12:],  # about something else
        BY_HAND[:12] + b"\x83" + BY_HAND[13:],  # refused
        BY_HAND.replace(b"XRCE", b"RTPS"),
        BY_HAND.replace(b"\1\0\0\0\1\xc0", b"\xff\0\0\0\1\xc0"),  # more locators than there are
    ],
)  # fmt: skip
def test_other_datagrams_are_refused(datagram):
    with pytest.raises(DecodeError):
        agents_of(datagram, "192.0.2.7")


@given(st.binary(max_size=80) | st.binary(max_size=60).map(lambda octets: BY_HAND[:20] + octets),
       st.sampled_from(["", "127.0.0.1", "192.0.2.7"]))  # fmt: skip
def test_any_datagram_is_decoded_or_refused(datagram, source):
    try:
        agents = agents_of(datagram, source)
    except DecodeError:
        return
    for host, port in agents:
        assert 0 < port < 65536
        socket.inet_pton(socket.AF_INET6 if ":" in host else socket.AF_INET, host)


# --- waiting for an agent ------------------------------------------------------------------------


def answering(place, *bursts):
    """Answer the n-th request with the n-th burst of datagrams, in a thread."""

    def run():
        for burst in bursts:
            assert place.take() == QUESTION
            place.say(*burst)

    thread = threading.Thread(target=run, daemon=True)
    thread.start()
    return thread


def test_the_first_valid_answer_is_returned(place):
    answers = answer(("192.0.2.7", 8888)), answer(("192.0.2.8", 8889))
    thread = answering(place, (b"", b"hello", QUESTION, answers[0][:-3], *answers, answers[0]))
    assert discover_agent(10_000, place.addresses) == ("192.0.2.7", 8888)
    thread.join(SECONDS)


def test_a_lost_request_is_repeated(place):
    thread = answering(place, (), (answer(("0.0.0.0", 8888)),))
    assert discover_agent(10_000, place.addresses) == ("127.0.0.1", 8888)
    thread.join(SECONDS)


def test_discovery_ends_after_its_timeout(place):
    before = ticks_ms()
    assert discover_agent(300, place.addresses) is None
    assert 300 <= ticks_diff(ticks_ms(), before)
    assert place.take() == QUESTION


def test_answers_without_usable_locators_are_ignored(place):
    thread = answering(place, [answer(), answer(("239.1.2.3", 1))] * 40)
    assert discover_agent(200, place.addresses) is None
    thread.join(SECONDS)


def test_addresses_that_cannot_be_resolved_are_skipped(place):
    thread = answering(place, (answer(("192.0.2.7", 8888)),))
    nowhere = ("no.such.host.invalid", 7400), ("::1", 7400)
    assert discover_agent(10_000, nowhere + place.addresses) == ("192.0.2.7", 8888)
    thread.join(SECONDS)
    with pytest.raises(OSError, match="::1 has no address of IPv4"):
        discover_agent(10_000, nowhere[1:])


def test_a_request_that_cannot_be_sent_raises(monkeypatch):
    with pytest.raises(OSError, match="there is no address to ask"):
        discover_agent(10_000, ())
    with pytest.raises(OSError) as caught:
        discover_agent(10_000, interface="192.0.2.55")  # not an address of this machine
    assert caught.value.errno == errno.EADDRNOTAVAIL

    class Down(socket.socket):
        def sendto(self, *_):
            raise OSError(errno.ENETUNREACH, "Network is unreachable")

    monkeypatch.setattr(discoveryboard.socket, "socket", Down)
    with pytest.raises(OSError, match="Network is unreachable"):
        discover_agent(10_000)
    with pytest.raises(OSError, match="Network is unreachable"):
        DiscoveringTransport().open()


# --- the transport -------------------------------------------------------------------------------


def test_the_last_message_is_sent_to_the_agent_found(place, make_transport):
    agent = Answering()
    t = make_transport(place.addresses)
    t.open()
    assert place.take() == QUESTION and t.agent is None
    t.send(b"lost")
    t.send(bytearray(b"ping..."), 4)
    assert t.receive(0) is None
    place.say(answer(("127.0.0.1", agent.port)), answer(("127.0.0.1", 1)))
    assert t.receive(0) is None and t.agent == ("127.0.0.1", agent.port)
    assert agent.take() == b"ping"
    agent.say(b"pong")
    assert t.receive(1000) == b"pong"
    t.send(b"more", 4)
    t.send(b"all of it")
    assert agent.take() == b"more" and agent.take() == b"all of it"
    place.say(b"a late answer")  # to a socket that is closed
    assert t.receive(10) is None
    t.close()
    assert t.agent is None
    agent.sock.close()


def test_a_search_repeats_its_request_every_250_ms(place, make_transport, monkeypatch):
    now = [1000]
    monkeypatch.setattr(discoveryboard, "ticks_ms", lambda: now[0])
    t = make_transport(place.addresses)
    t.open()
    for _ in range(51):
        now[0] += 10
        t.send(b"ping")
    place.sock.setblocking(False)
    assert [place.take() for _ in range(3)] == [QUESTION] * 3
    with pytest.raises(BlockingIOError):
        place.take()


def test_a_transport_without_an_answer_raises_after_its_patience(place, make_transport):
    t = make_transport(place.addresses, patience_ms=20)
    for _ in range(2):
        t.open()
        with pytest.raises(OSError) as caught:
            while True:
                assert t.receive(10) is None
        assert f"no agent answers at 127.0.0.1 port {place.port}" in str(caught.value)
        assert "--discovery" in str(caught.value)


def test_a_silent_locator_is_followed_by_the_next(place, make_transport, monkeypatch):
    """The locator that answered is the first one in later searches."""
    now = [1000]
    monkeypatch.setattr(discoveryboard, "ticks_ms", lambda: now[0])
    agent, silent = Answering(), Answering()
    datagram = answer(("127.0.0.1", silent.port), ("127.0.0.1", agent.port))
    t = make_transport(place.addresses)
    for turn in range(3):
        t.open()
        assert place.take() == QUESTION
        place.say(datagram)
        t.send(b"ping")
        assert t.receive(0) is None
        if turn == 0:
            assert t.agent == ("127.0.0.1", silent.port) and silent.take() == b"ping"
            now[0] += 2999
            assert t.receive(0) is None
            now[0] += 1
            with pytest.raises(OSError, match="is silent there: look at firewalls"):
                t.receive(0)
            continue
        assert t.agent == ("127.0.0.1", agent.port) and agent.take() == b"ping"
        agent.say(b"pong")
        assert t.receive(1000) == b"pong"
        now[0] += 100_000
        assert t.receive(0) is None  # now the node detects the loss of the agent
    agent.sock.close()
    silent.sock.close()


def test_an_unreachable_locator_is_followed_by_the_next(place, make_transport):
    def make(host, port, mtu):
        assert mtu == 300
        tried.append(host)
        return Nowhere() if host == "192.0.2.7" else Line()

    class Line:
        def open(self):
            pass

        def close(self):
            tried.append("closed")

        def receive(self, timeout_ms):
            return b"pong"

    class Nowhere(Line):
        def open(self):
            raise OSError(errno.EHOSTUNREACH, "no way")

    tried = []
    t = make_transport(place.addresses, mtu=300, make=make)
    assert t.mtu == 300
    for _ in range(2):
        t.open()
        place.take()
        place.say(answer(("192.0.2.7", 8888), ("192.0.2.8", 8888)))
        try:
            assert t.receive(1000) == b"pong"
        except OSError as error:
            assert "no way" in str(error) and t.agent is None
        t.close()
    assert tried == ["192.0.2.7", "192.0.2.8", "closed"]


def test_a_flood_of_datagrams_does_not_block_receive(place, make_transport):
    t = make_transport(place.addresses)
    t.open()
    place.take()
    place.say(*[b"nonsense"] * 64, answer(("127.0.0.1", 8888)))
    turns = 1
    while t.agent is None:
        assert t.receive(0) is None
        turns += 1
        assert turns < 10
    assert turns > 4
