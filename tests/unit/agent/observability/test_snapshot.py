"""Counters and snapshots, and that taking a snapshot does not delay boards."""

import json
import socket
import time

import pytest
from support.agent import running_agent
from support.client import XrceClient
from unit.agent.helpers import (
    KEY,
    PUBLISHER,
    READER,
    SESSION,
    TOPIC,
    WRITER,
    Board,
    Desk,
    acknack,
    built,
    endpoint,
    fragment,
    message,
    of,
    oid,
    publisher_entities,
    read_data,
    service,
    sub,
    subscriber_entities,
    topic,
    whole,
    write_data,
)
from unit.agent.transports.bare_host import BareHost

from uros.agent.observability import snapshot as module
from uros.agent.observability.snapshot import Rates, gather, pieces, snapshot
from uros.agent.transports.base import MAX_BURST
from uros.agent.transports.udp import UdpServer
from uros.ticks import TIME_MASK
from uros.wire import ids
from uros.wire.session import push_timestamp

TYPE = "std_msgs::msg::dds_::UInt8MultiArray_"
SAMPLE = b"\x07\0\0\0"


class Owner:
    """A desk with the interface of a server, and its clock."""

    def __init__(self, **more):
        self.desk = Desk(**more)
        self.agent = self.desk.agent
        self.clock = self.agent.clock
        self.transports = [self.desk.place]
        self.started = time.monotonic()
        self.middleware_fails = False
        self.config_file = ""
        self.troubles = []
        self.calls = []

    def wake_at(self, seconds, call):
        assert seconds == 0.0
        self.calls.append(call)

    def see(self):
        return snapshot(self)

    def client(self):
        (client_entry,) = self.see()["clients"]
        return client_entry


@pytest.fixture
def owner():
    new_owner = Owner()
    yield new_owner
    new_owner.desk.close()


# --- all of it ----------------------------------------------------------------------


def test_a_board_with_a_publisher_and_a_subscription(owner):
    board = Board(owner.desk)
    board.ask(*publisher_entities(name="rt/out", domain=7))
    board.ask(
        topic(oid(2, ids.KIND_TOPIC), "rt/in", "std_msgs::msg::dds_::String_"),
        *subscriber_entities()[2:3],
        endpoint(READER, oid(2, ids.KIND_TOPIC), oid(1, ids.KIND_SUBSCRIBER)),
        service(),
    )
    for _ in range(3):
        board.send(write_data(WRITER, SAMPLE))
    snapshot_taken = owner.see()
    assert set(snapshot_taken) == {
        "version", "pid", "config", "uptime", "middleware", "rss", "cpu", "fds", "limits",
        "max_clients", "memory_full", "ready", "problems", "refusals", "transports", "clients",
        "refused",
    }  # fmt: skip
    assert (snapshot_taken["version"], snapshot_taken["middleware"], snapshot_taken["refused"]) == (
        1,
        "memory",
        [],
    )
    assert (
        snapshot_taken["rss"] > 1_000_000
        and snapshot_taken["fds"] > 2
        and snapshot_taken["limits"]["objects"] == 4096
    )
    (transport,) = snapshot_taken["transports"]
    assert (transport["name"], transport["kind"], transport["label"]) == ("TestAgent", "TEST", "")
    (client,) = snapshot_taken["clients"]
    assert set(client) == {
        "key", "session_id", "transport", "address", "mtu", "age", "heard_ago",
        "heard_since_restart", "line_lost", "unanswered", "nodes", "objects", "refused_objects",
        "held", "received", "sent", "recent", "rate_over", "round_trip", "unacknowledged_for",
        "queues", "endpoints", "clock_offset",
    }  # fmt: skip
    assert (client["key"], client["session_id"]) == (f"0x{KEY:08X}", f"0x{SESSION:02X}")
    assert (client["transport"], client["address"], client["mtu"]) == ("TestAgent", "peer 1", 512)
    assert client["nodes"] == [{"name": "/ns/board", "domain": 7}]
    assert client["objects"] == {
        "participant": 1, "topic": 2, "publisher": 1, "subscriber": 1, "datawriter": 1,
        "datareader": 1, "requester": 1,
    }  # fmt: skip
    assert client["endpoints"] == [
        {"object": "0x001(5)", "kind": "datawriter", "topic": "/out",
         "type": "std_msgs/msg/Int32", "samples": 3},
        {"object": "0x001(6)", "kind": "datareader", "topic": "/in",
         "type": "std_msgs/msg/String", "samples": 0},
        {"object": "0x001(7)", "kind": "requester", "topic": "/add",
         "type": "example/srv/Add", "samples": 0},
    ]  # fmt: skip


def test_topics_are_those_of_the_network_after_the_rules():
    from uros.agent.policy.rules import Rules

    rules = Rules()
    rules.add({"namespace": "/hall", "remap": {"/ns/board/x": "/y"}})
    owner = Owner(rules=rules)
    Board(owner.desk).ask(*publisher_entities(name="rt/out"))
    client = owner.client()
    assert client["nodes"] == [{"name": "/hall/ns/board", "domain": 0}]
    assert client["endpoints"][0]["topic"] == "/hall/out"
    owner.desk.close()


def test_samples_of_a_reader_are_counted(owner):
    first, second = Board(owner.desk), Board(owner.desk, 2, KEY + 1)
    first.ask(*publisher_entities())
    second.ask(*subscriber_entities())
    second.send(read_data(READER))
    for _ in range(5):
        first.send(write_data(WRITER, SAMPLE))
    assert [client["endpoints"][0]["samples"] for client in owner.see()["clients"]] == [5, 5]


def test_refused_clients_with_their_reasons(owner):
    Board(owner.desk, key=5)
    owner.agent.refusals.note(5, "client key in use", "somewhere", time.monotonic() - 3, 4)
    (refusal,) = owner.see()["refused"]
    assert 2.9 < refusal.pop("ago") < 30
    assert refusal == {
        "key": "0x00000005", "why": "client key in use", "address": "somewhere", "times": 4
    }  # fmt: skip


def test_each_kind_of_refusal_has_its_latest_address_and_age(owner):
    owner.agent.refusals.count("connection", "tls", "192.168.1.9:1", "no TLS", time.monotonic() - 3)
    (refusal,) = owner.see()["refusals"]
    assert 2.9 < refusal.pop("ago") < 30
    assert refusal == {
        "kind": "connection", "rule": "tls", "times": 1, "address": "192.168.1.9:1", "why": "no TLS"
    }  # fmt: skip


def test_the_configuration_file_of_an_agent(owner):
    assert owner.see()["config"] is None
    owner.config_file = "/etc/uros/hall.toml"
    assert owner.see()["config"] == "/etc/uros/hall.toml"


def test_a_clients_clock(owner):
    board = Board(owner.desk)
    assert owner.client()["clock_offset"] is None
    now = time.time_ns() + 2_500_000_000
    stamp = divmod(now, 1_000_000_000)
    board.send(sub(ids.TIMESTAMP, built(push_timestamp, *stamp)))
    assert 2.0 < owner.client()["clock_offset"] <= 2.5
    board.send(sub(ids.TIMESTAMP, built(push_timestamp, 12, 0)))  # since its start, in C
    assert owner.client()["clock_offset"] == pytest.approx(12 - time.time(), abs=5)


# --- counters -----------------------------------------------------------------------


def best_effort(owner, number, stream=1):
    owner.desk.hear(message([write_data(WRITER, SAMPLE)], stream, number, SESSION, KEY), 1)


@pytest.mark.parametrize(
    "numbers, lost, accepted",
    [
        ([0, 1, 2], 0, 3),
        ([0, 3], 2, 2),
        ([2], 2, 1),
        ([0, 2, 1], 1, 2),  # late messages count as lost: they are not delivered
        ([0, 0, 1], 0, 2),
        ([0x7FFE, 0xFFFD, 0xFFFF, 0, 1], 0x7FFE + 0x7FFE + 1, 5),  # the numbers wrap
        ([0x7FFE, 0xFFFD, 3], 0x7FFE + 0x7FFE + 5, 3),
    ],
)
def test_lost_best_effort_messages_are_counted(owner, numbers, lost, accepted):
    Board(owner.desk).ask(*publisher_entities())
    before = owner.client()["received"]
    for number in numbers:
        best_effort(owner, number)
    client = owner.client()
    assert client["received"]["lost"] == lost
    assert client["received"]["messages"] == before["messages"] + len(numbers)
    size = len(message([write_data(WRITER, SAMPLE)], 1, 0, SESSION, KEY))
    assert client["received"]["bytes"] == before["bytes"] + len(numbers) * size
    assert client["endpoints"][0]["samples"] == accepted


def test_counters_of_sent_unacknowledged_and_repeated_messages(owner):
    board = Board(owner.desk, polite=False)
    board.send(*publisher_entities())
    sent = owner.client()["sent"]
    # STATUS_AGENT belongs to no session; four answers and an acknowledgement do.
    assert (sent["messages"], sent["resent"]) == (5, 0)
    assert owner.client()["queues"]["unacknowledged"] == 4
    owner.desk.clock += 50
    owner.desk.hear(message([acknack(1, 0b101)], 0, 0, SESSION, KEY))
    client = owner.client()
    assert client["sent"]["resent"] == 2
    assert client["sent"]["messages"] == 7
    assert client["sent"]["bytes"] > sent["bytes"]
    assert client["queues"]["unacknowledged"] == 3


def test_messages_sent_for_the_first_time_are_no_repetitions(owner):
    """Messages that waited for the window are sent for the first time."""
    board = Board(owner.desk, polite=False)
    for number in range(20):
        board.send(topic(oid(number, ids.KIND_TOPIC)))
    assert owner.client()["queues"]["unacknowledged"] == 20
    board.send(acknack(10), stream=0)
    assert owner.client()["sent"]["resent"] == 0
    assert owner.client()["queues"]["unacknowledged"] == 10


def test_counters_of_early_stalled_dropped_and_incomplete_messages(owner):
    board = Board(owner.desk)
    board.ask(*publisher_entities())
    number = board.sequence[ids.STREAM_RELIABLE]
    for ahead in (2, 3):
        datagram = message(
            [write_data(WRITER, SAMPLE)], ids.STREAM_RELIABLE, number + ahead, SESSION, KEY
        )
        owner.desk.hear(datagram)
    assert owner.client()["queues"] == {
        "unacknowledged": 0, "stalled": 0, "early": 2, "fragments": 0
    }  # fmt: skip
    owner.desk.hear(message([fragment(b"\7" * 24)], ids.STREAM_RELIABLE, number, SESSION, KEY))
    assert owner.client()["queues"]["fragments"] == 24
    of(board).session.writers[WRITER] = lambda view: False
    best_effort(owner, 0)
    assert owner.client()["sent"]["dropped"] == 1
    owner.desk.hear(message([write_data(WRITER, SAMPLE)], 0x81, 0, SESSION, KEY))
    assert owner.client()["queues"]["stalled"] == 1


def test_an_abandoned_long_message_is_counted(owner):
    board = Board(owner.desk)
    board.ask(*publisher_entities())
    assert owner.client()["received"]["given_up"] == 0
    half = whole(write_data(WRITER, bytes(100)))
    board.send(fragment(half[:60]))
    board.send(write_data(WRITER, SAMPLE))
    board.send(fragment(half[:60]))  # the rest of the first message would have arrived before
    assert owner.client()["received"]["given_up"] == 1
    board.send(fragment(half[:60]))
    board.send(fragment(half[60:], True))
    assert owner.client()["received"]["given_up"] == 2


# --- rates and times ----------------------------------------------------------------


def rates_of(rates, client, now):
    """Messages received and sent a second, and over how many seconds."""
    recent, over = rates.recent(client, now)
    return recent.received / over, recent.sent / over, over


def test_rates_are_over_a_client_s_life_and_then_over_the_last_marks(owner):
    board = Board(owner.desk)
    board.ask(*publisher_entities())
    client = of(board)
    client.born = 100.0
    client.session.received, client.session.sent = 50, 10
    rates = Rates(owner.agent.clients)
    assert rates_of(rates, client, 110.0) == (5.0, 1.0, 10.0)
    rates.mark(110.0)
    client.session.received += 100
    assert rates_of(rates, client, 110.5) == (
        150 / 10.5,
        10 / 10.5,
        10.5,
    )  # the interval is too short
    assert rates_of(rates, client, 120.0) == (10.0, 0.0, 10.0)
    rates.mark(115.0)
    assert rates_of(rates, client, 120.0) == (10.0, 0.0, 10.0)
    rates.mark(120.0)
    client.session.received += 20
    assert rates_of(rates, client, 125.0) == (2.0, 0.0, 10.0)
    # Another board with the key, or the same board after a reset.
    client.born, client.session.received = 124.0, 3
    assert rates_of(rates, client, 125.0) == (3.0, 10.0, 1.0)


def test_creations_at_the_start_of_a_client_are_no_rate(owner):
    board = Board(owner.desk)
    board.ask(*publisher_entities())
    client = of(board)
    client.born = 100.0
    client.session.received = 20
    rates = Rates(owner.agent.clients)
    rates.mark(100.5)  # in the middle of a snapshot
    client.session.received = 40
    assert rates_of(rates, client, 105.0) == (40 / 5, client.session.sent / 5, 5.0)
    rates.mark(105.5)
    client.session.received = 80
    assert rates_of(rates, client, 109.5)[::2] == (10.0, 4.0)
    rates.mark(110.5)
    assert rates_of(rates, client, 113.5)[2] == 8.0


def test_all_counts_of_the_last_seconds(owner):
    board = Board(owner.desk)
    client = of(board)
    client.born = 100.0
    session = client.session
    names = ("received", "sent", "lost", "given_up", "resent", "dropped", "acknowledged",
             "round_trips_ms")  # fmt: skip
    for number, name in enumerate(names):
        setattr(session, name, 10 * number)
    rates = Rates(owner.agent.clients)
    rates.mark(110.0)
    for number, name in enumerate(names):
        setattr(session, name, 11 * number)
    recent, over = rates.recent(client, 117.0)
    assert (recent._asdict(), over) == ({name: i for i, name in enumerate(names)}, 7.0)


def test_a_lost_line_and_the_memory_held_for_a_client(owner, monkeypatch):
    board = Board(owner.desk)
    board.ask(*publisher_entities())
    assert not owner.client()["line_lost"]
    assert owner.client()["held"] == of(board).held() > 0
    monkeypatch.setattr(owner.desk.place, "is_away", lambda peer: peer == 1)
    assert owner.client()["line_lost"]


def test_the_places_and_the_memory_of_the_agent(owner):
    assert (owner.see()["max_clients"], owner.see()["memory_full"]) == (4096, False)
    owner.agent.budget.full = True
    assert owner.see()["memory_full"]


def test_the_time_until_a_message_is_acknowledged(owner):
    board = Board(owner.desk, polite=False)
    assert (owner.client()["round_trip"], owner.client()["unacknowledged_for"]) == (None, 0.0)
    board.ask(*publisher_entities())  # four answers on the reliable stream
    owner.desk.wait(30)
    assert (owner.client()["round_trip"], owner.client()["unacknowledged_for"]) == (None, 0.03)
    board.send(acknack(2), stream=0)
    assert owner.client()["round_trip"] == 0.03
    owner.desk.wait(30)
    board.send(acknack(2), stream=0)  # says nothing new
    assert (owner.client()["round_trip"], owner.client()["unacknowledged_for"]) == (0.03, 0.06)
    board.send(acknack(4), stream=0)
    assert owner.client()["round_trip"] == 0.045  # the mean of 30 and 60 ms
    assert owner.client()["unacknowledged_for"] == 0.0


def test_silence_is_correct_after_ticks_have_wrapped(owner):
    board = Board(owner.desk)
    client, rates = of(board), Rates(owner.agent.clients)
    last_message_at = client.session.heard
    rates.mark(1000.0)
    assert rates.heard_ago(client, 1001.0, last_message_at + 1000) == 1.0
    week = 7 * 86_400
    rates.mark(1000.0 + week)
    ticks = (last_message_at + week * 1000) & TIME_MASK
    assert rates.heard_ago(client, 1000.0 + week, ticks) == week


# --- bounded ------------------------------------------------------------------------


def test_long_names_and_many_endpoints_are_cut(owner):
    board = Board(owner.desk, mtu=60_000)
    board.ask(*publisher_entities(name="rt/" + "x" * 246))
    for number in range(2, 400):
        board.send(endpoint(oid(number, ids.KIND_DATAWRITER), TOPIC, PUBLISHER))
    client = owner.client()
    assert client["objects"]["datawriter"] == 399
    assert len(client["endpoints"]) == module.MAX_ENDPOINTS
    assert client["endpoints_left_out"] == 399 - module.MAX_ENDPOINTS
    assert all(len(entry["topic"]) == module.MAX_TEXT for entry in client["endpoints"])


def test_a_snapshot_is_gathered_in_pieces_between_which_boards_may_leave(owner):
    boards = [Board(owner.desk, 1 + index, KEY + index) for index in range(10)]
    texts = []
    for piece in pieces(owner):
        texts.append(piece)
        if len(texts) == 4:
            owner.agent.delete_client(boards[5].key)
    snapshot_taken = json.loads("".join(texts))
    assert len(texts) == 11 and texts[-1].endswith("}\n") and "".join(texts).count("\n") == 1
    assert [int(index["key"], 16) - KEY for index in snapshot_taken["clients"]] == [
        0,
        1,
        2,
        3,
        4,
        6,
        7,
        8,
        9,
    ]


def test_boards_are_served_while_a_snapshot_is_gathered(owner, monkeypatch):
    for index in range(10):
        Board(owner.desk, 1 + index, KEY + index)
    monkeypatch.setattr(module, "SLICE", 0.0)
    pieces = []
    gather(owner, pieces.append, lambda: True)
    turns = 0
    while owner.calls:
        turns += 1
        owner.calls.pop()()
    assert turns == 12 and len(json.loads(pieces[0])["clients"]) == 10
    waiting = True
    gather(owner, pieces.append, lambda: waiting)
    waiting = False  # no request waits any more
    owner.calls.pop()()
    assert not owner.calls and len(pieces) == 1


# --- transports ---------------------------------------------------------------------


@pytest.mark.parametrize(
    "transport, own",
    [
        ("udp", {}),
        ("tcp", {"connections": 1, "refused": 0}),
        ("serial", {"frames": 9, "crc_errors": 0, "foreign": 0, "skipped": 0, "dropped": 0}),
        ("custom", {"malformed": 0, "dropped": 0}),
    ],
)
def test_transports_count_received_messages(transport, own):
    with running_agent(transport, "memory") as running:
        client = XrceClient(running.line(), 0x77)
        assert client.open() == ids.STATUS_OK
        writer = client.writer("talker", "rt/numbers", TYPE)
        for _ in range(3):
            client.write(writer, b"\0" * 8)
        client.ping()
        snapshot_taken = running.snapshot()
        (transport_entry,) = snapshot_taken["transports"]
        (board,) = snapshot_taken["clients"]
        # CREATE_CLIENT belongs to no session.
        assert transport_entry["messages"] == board["received"]["messages"] + 1
        assert transport_entry["bytes"] > board["received"]["bytes"] > 100
        common = {"name", "kind", "label", "not_after", "messages", "bytes"}
        extra = {name: count for name, count in transport_entry.items() if name not in common}
        if "frames" in own:
            own = {**own, "frames": transport_entry["messages"]}
        assert extra == own
        assert board["endpoints"][0]["samples"] == 3


def test_a_burst_of_datagrams_is_counted_to_the_last():
    host, server = BareHost(), UdpServer(0, "127.0.0.1")
    server.open(host)
    try:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sock:
            sock.connect(("127.0.0.1", server.port))
            for _ in range(MAX_BURST + 10):
                sock.send(b"\0" * 10)
            counted = []
            for _ in range(3):
                server._drain()
                counted.append(server.messages)
            for _ in range(2):
                sock.send(b"\0" * 60_000)  # two fill a burst by their bytes
            server._drain()
        assert counted == [MAX_BURST, MAX_BURST + 10, MAX_BURST + 10]
        assert server.counters() == {
            "messages": MAX_BURST + 12, "bytes": 10 * (MAX_BURST + 10) + 120_000
        }  # fmt: skip
    finally:
        server.close()
