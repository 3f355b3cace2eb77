"""Bad datagrams for a real UDP server; other clients are served after each of them."""

import random
import socket

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from support.agent import running_agent
from support.client import XrceClient
from support.examples import examples
from unit.agent.helpers import (
    PARTICIPANT,
    READER,
    REPLIER,
    REQUESTER,
    SUBSCRIBER,
    TOPIC,
    WRITER,
    acknack,
    create,
    create_client,
    delete,
    endpoint,
    fragment,
    get_info,
    group,
    heartbeat,
    message,
    participant,
    read_data,
    service,
    sub,
    topic,
    whole,
    write_data,
)
from unit.agent.transports.bare_host import BareHost
from unit.agent.transports.faults import TYPE

from uros.agent.transports.base import TransportError
from uros.agent.transports.udp import UdpServer
from uros.wire import ids
from uros.wire.streams import MAX_MESSAGE

KEY = 0xBADBAD01
EVERYTHING = [
    participant(), topic(), group(), group(SUBSCRIBER), endpoint(),
    endpoint(READER, parent=SUBSCRIBER), service(), service(REPLIER),
]  # fmt: skip


@pytest.fixture(scope="module")
def agent():
    with running_agent("udp", "memory") as running:
        yield running


class Villain:
    """A client that sends arbitrary datagrams, over a line of its own or over ``line``."""

    def __init__(self, agent, session_id=0x81, line=None):
        self.line = line or agent.line()
        self.session_id = session_id
        self.sequence = 0
        self.client = XrceClient(self.line, KEY, session_id)
        assert self.client.open() == ids.STATUS_OK

    def raw(self, datagram):
        self.line.send_raw(datagram)

    def send(self, *submessages, stream=0x80):
        self.raw(message(submessages, stream, self.sequence, self.session_id, KEY))
        self.sequence = (self.sequence + 1) & 0xFFFF


@pytest.fixture
def villain(agent, bystanders):
    attacker = Villain(agent)
    attacker.send(*EVERYTHING)
    yield attacker
    bystanders.check()
    # The client itself can connect again. It does so from its own address: from another one the
    # agent would probe the known address for half a second first.
    again = Villain(agent, session_id=0x82, line=attacker.line)
    assert again.client.delete(PARTICIPANT) in (0, ids.STATUS_ERR_UNKNOWN_REFERENCE)
    assert again.client.close() == ids.STATUS_OK


# --- what ends eProsima's agent ------------------------------------------------------------


def creation(**more):
    return create_client(KEY + 1, **more)


def with_byte(datagram, at, value):
    changed = bytearray(datagram)
    changed[at] = value
    return bytes(changed)


KILLERS = {
    "the optional flag is 2": with_byte(creation(), 21, 2),
    "the optional flag is 255": with_byte(creation(properties=[("a", "b")]), 21, 255),
    "MTU 0": creation(mtu=0),
    **{f"MTU {mtu}": creation(mtu=mtu) for mtu in (1, 3, 4, 7, 8, 9, 11, 12, 16)},
    "MTU 0 with key": creation(mtu=0, session_id=1),
    "uxr_hl is a word": creation(properties=[("uxr_hl", "soon")]),
    "uxr_hl is nothing": creation(properties=[("uxr_hl", "")]),
    "uxr_hl is huge": creation(properties=[("uxr_hl", "9" * 40)]),
    "uxr_sm is a word": creation(properties=[("uxr_sm", "x")]),
    "key 0": create_client(0),
    "bad cookie": creation(cookie=b"DDDD"),
    "wrong version": creation(version=(9, 9)),
}


@pytest.mark.parametrize("name", KILLERS)
def test_a_create_client_that_ends_the_cpp_agent(agent, bystanders, name):
    line = agent.line()
    line.send_raw(KILLERS[name])
    bystanders.check()


def test_the_offset_of_the_flag_is_right():
    assert creation()[21] == 0 and creation(properties=[])[21] == 1


@pytest.mark.parametrize("size", range(6))
@pytest.mark.parametrize("object_id", [WRITER, REQUESTER, REPLIER, READER, 0x0FF5, 0xFFFF])
@pytest.mark.parametrize("stream", [0, 1, 0x80])
def test_short_write_data(villain, size, object_id, stream):
    payload = (b"\0\1" + object_id.to_bytes(2, "big") + b"\0")[:size]
    villain.send(sub(ids.WRITE_DATA, payload), stream=stream)


def test_over_64_kilobytes_towards_a_client(villain, bystanders, agent):
    reader = XrceClient(agent.line(), KEY + 2)
    assert reader.open() == 0
    reading = reader.reader("reader", "rt/large", TYPE)
    reader.read(reading)
    writer = bystanders.publisher.writer("publisher", "rt/large", TYPE)
    for size in (65_527, 65_528, 65_535, 65_536, 65_540, 131_072, 300_000):
        sample = bytes(i * 13 & 0xFF for i in range(size))
        bystanders.publisher.write(writer, sample)
        assert reader.sample(reading) == sample
    assert reader.close() == 0


def test_an_endless_fragmented_message(villain, agent):
    part = fragment(bytes(65_400))
    for _ in range(MAX_MESSAGE // 65_400 + 3):
        villain.send(part)
        if villain.sequence % 16 == 0:  # no more than the socket buffer holds
            assert villain.client.ping() == 1
    assert villain.client.ping() == 1
    session = agent.agent.clients[KEY].session
    assert session._in[0x80].fragments.pending <= MAX_MESSAGE


def test_half_a_fragment_left_by_a_reset(villain):
    raw = whole(write_data(WRITER, b"x" * 400))
    villain.send(fragment(raw[:200]))
    villain.send(sub(ids.RESET))
    villain.sequence = 0
    villain.send(fragment(raw[200:], True))
    villain.send(fragment(b"", True))
    villain.send(write_data(WRITER, b"sound"))


def test_fragments_within_fragments(villain):
    nest = whole(get_info())
    while len(nest) < 60_000:
        nest = whole(fragment(nest, True))
    villain.send(fragment(nest, True))


# --- datagrams of all sizes and orders -------------------------------------------------------


@pytest.mark.parametrize("size", [0, 1, 2, 3, 4, 7, 8, 100, 1472, 9000, 65_507])
@pytest.mark.parametrize("filler", [b"\0", b"\x81", b"\xff", b"\x80\0\0\0"])
def test_sizes(villain, size, filler):
    villain.raw((filler * size)[:size])


@pytest.mark.parametrize(
    "submessage",
    [
        write_data(WRITER, bytes(65_000)),
        write_data(0x0FF5, bytes(65_000)),
        sub(ids.CREATE, bytes(65_000)),
        sub(ids.HEARTBEAT, bytes(65_000)),
        create(TOPIC, ids.AS_XML, "<a>" * 21_000, PARTICIPANT),
        create(TOPIC, ids.BY_REFERENCE, "x" * 60_000, PARTICIPANT),
        create(TOPIC, ids.IN_BINARY, b"\xff" * 60_000, PARTICIPANT),
    ],
    ids=["write", "unknown", "create", "heartbeat", "xml", "reference", "binary"],
)
def test_large_submessages(villain, submessage):
    for stream in (0, 1, 0x80):
        villain.send(submessage, stream=stream)


def test_as_many_submessages_as_fit(villain):
    for submessage in (get_info(), delete(0x0992), acknack(9, 0xFFFF), heartbeat(0, 9), sub(7)):
        size = len(submessage[2]) + 8
        villain.send(*[submessage] * (65_000 // size), stream=1)
        assert villain.client.ping() == 1


def test_every_submessage_truncated_at_every_byte(villain):
    for submessage in [*EVERYTHING, get_info(), read_data(READER), delete(TOPIC), acknack(0)]:
        datagram = message([submessage], 0, 0, 0x81)
        for size in range(len(datagram)):
            villain.raw(datagram[:size])
        assert villain.client.ping() == 1
        kind, flags, payload = submessage
        for size in range(len(payload)):
            villain.send((kind, flags, payload[:size]), stream=0)
        assert villain.client.ping() == 1


def test_every_kind_and_flag(villain):
    for kind in range(256):
        for flags in (0, 1, 7, 0xFF):
            villain.send(sub(kind, bytes(12), flags), stream=0)
        if kind % 8 == 0:
            villain.client.infos.clear()
            assert villain.client.ping() == 1


def test_reordered_and_duplicate_samples_arrive_in_order_once(agent, villain, bystanders):
    """A reliable stream delivers everything although the network reorders and repeats datagrams."""
    client = XrceClient(agent.line(), KEY + 3)
    assert client.open() == 0
    writer = client.writer("shuffler", "rt/shuffled", TYPE)
    subscriber = bystanders.subscriber
    reader = subscriber.reader("subscriber", "rt/shuffled", TYPE, depth=200)
    subscriber.read(reader)
    rng = random.Random(7)
    start = client._out.next
    for base in range(0, 160, 16):
        burst = [
            message(
                [write_data(writer, (base + i).to_bytes(4, "big"))], 0x80, start + base + i, 0x81
            )
            for i in range(16)
        ] * 3
        rng.shuffle(burst)
        for datagram in burst:
            client.line.send(datagram)
        samples = [subscriber.sample(reader) for _ in range(16)]
        assert samples == [(base + i).to_bytes(4, "big") for i in range(16)]
    assert not subscriber.samples[reader]
    assert subscriber.delete(reader) == 0


def test_best_effort_samples_are_never_old_or_duplicate(agent, bystanders):
    client = XrceClient(agent.line(), KEY + 4)
    assert client.open() == 0
    writer = client.writer("shuffler", "rt/best", TYPE)
    subscriber = bystanders.subscriber
    reader = subscriber.reader("subscriber", "rt/best", TYPE, depth=200)
    subscriber.read(reader)
    rng = random.Random(8)
    numbers = list(range(100)) * 2
    rng.shuffle(numbers)
    for number in numbers:
        client.line.send(message([write_data(writer, bytes([number]))], 1, number, 0x81))
    expected = [n for i, n in enumerate(numbers) if n > max(numbers[:i], default=-1)]
    assert [subscriber.sample(reader)[0] for _ in expected] == expected
    assert not subscriber.wait_sample(reader, 0.0)
    assert subscriber.delete(reader) == 0


# --- whatever comes --------------------------------------------------------------------------

SUBMESSAGES = [
    *EVERYTHING, get_info(), read_data(READER), delete(TOPIC), acknack(0, 3), heartbeat(0, 5),
    write_data(WRITER, b"sample"), write_data(REQUESTER, b"ask"), fragment(b"abcdefgh"),
    fragment(b"abcd", True), sub(ids.RESET), sub(ids.TIMESTAMP, bytes(8)),
    write_data(REPLIER, bytes(32)), delete(ids.OBJECT_CLIENT),
]  # fmt: skip
SEEDS = [message([submessage], 0x80, 1) for submessage in SUBMESSAGES] + [
    create_client(KEY), create_client(KEY, 0x05), message([get_info()], 0, 0, 0x80),
]  # fmt: skip

anything = st.binary(max_size=200)
header = st.tuples(
    st.sampled_from([0x00, 0x05, 0x80, 0x81, 0xFF]), st.sampled_from([0, 1, 0x7F, 0x80, 0xFF]),
    st.integers(0, 40) | st.integers(0, 0xFFFF),
)  # fmt: skip
submessage = st.sampled_from(SUBMESSAGES) | st.tuples(
    st.integers(0, 20), st.integers(0, 255), st.binary(max_size=60)
)


@st.composite
def messages(draw):
    session_id, stream, sequence = draw(header)
    return message(draw(st.lists(submessage, max_size=5)), stream, sequence, session_id)


@given(st.lists(messages() | anything, max_size=20))
@settings(
    max_examples=examples(150), deadline=None, derandomize=True,
    suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow],
)  # fmt: skip
def test_any_datagrams(agent, bystanders, datagrams):
    line = agent.line()
    try:
        line.send_raw(create_client(KEY))
        for datagram in datagrams:
            line.send_raw(datagram)
        bystanders.check()
    finally:
        line.close()
        agent.lines.remove(line)


@pytest.mark.parametrize("seed", range(5))
def test_mutated_datagrams(agent, bystanders, seed):
    rng = random.Random(seed)
    line = agent.line()
    for turn in range(3000):
        if turn % 30 == 0:
            line.send_raw(create_client(KEY))
            line.send_raw(message(EVERYTHING, 0x80, 0))
        datagram = bytearray(rng.choice(SEEDS))
        for _ in range(rng.choice((0, 1, 1, 2, 5))):
            act = rng.randrange(4)
            at = rng.randrange(len(datagram) + 1)
            if act == 0 and at < len(datagram):
                datagram[at] = rng.choice((0, 1, 0x7F, 0x80, 0xFF, rng.randrange(256)))
            elif act == 1:
                del datagram[at:]
            elif act == 2:
                datagram[at:at] = bytes(rng.randrange(256) for _ in range(rng.randrange(9)))
            else:
                datagram += rng.choice(SEEDS)[4:]
            if not datagram:
                break
        line.send_raw(bytes(datagram))
        if turn % 100 == 99:
            bystanders.check()


# --- the port -------------------------------------------------------------------------------


def test_a_port_in_use_says_what_to_do():
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as port_owner:
        port_owner.bind(("127.0.0.1", 0))
        port = port_owner.getsockname()[1]
        with pytest.raises(TransportError) as caught:
            UdpServer(port, "127.0.0.1").open(None)
    assert f"UDP port {port} is in use" in str(caught.value)
    assert "choose another port with --port" in str(caught.value)


def test_an_address_that_is_not_ours():
    with pytest.raises(TransportError, match="UDP port 0 cannot be opened"):
        UdpServer(0, "192.0.2.1").open(None)


def test_sending_where_nothing_can_be_sent(agent):
    for peer in (("127.0.0.1", 0), ("255.255.255.255", 9), ("192.0.2.1", 9)):
        agent.transport.send(peer, b"x")
    agent.transport.send(("127.0.0.1", 9), bytes(70_000))


def test_a_burst_after_single_messages_takes_few_turns():
    """After many bursts of one message, the socket is not asked for a second one each time."""
    host, server = BareHost(), UdpServer(0, "127.0.0.1")
    server.open(host)

    def turns_for(count):
        for number in range(count):
            sender.send(b"message %d" % number)
        turns, whole = 0, len(host.messages) + count
        while len(host.messages) < whole:
            host.turn(10.0)
            turns += 1
        return turns

    with socket.socket(type=socket.SOCK_DGRAM) as sender:
        sender.connect(("127.0.0.1", server.port))
        assert [turns_for(1) for _ in range(30)] == [1] * 30
        assert 1 <= turns_for(40) <= 4
        assert turns_for(40) == 1
        assert [turns_for(1) for _ in range(3)] == [1] * 3
        assert turns_for(40) == 1
    assert (server.messages, server.bytes) == (153, sum(len(text) for _, text in host.messages))
    server.close()
    host.close()
