"""Conversations of the real C client with loss, or with values whose octets all differ.

``captures/loss`` was recorded between the C client and the C++ agent; ``lost`` marks messages that
did not arrive. The expected values come from the messages that arrived, or from the source of the
recorded program, never from a codec of uros: so the tests detect octets that both ends swap.
"""

import json
import struct

import pytest
from support.replay import CAPTURES
from unit.agent.helpers import Desk
from unit.agent.session.test_session import Handler
from unit.client.portable_session import Bench, sequences

from uros.agent.session.session import Session
from uros.wire import data, ids, session
from uros.wire.cdr import Reader, Writer
from uros.wire.header import pull_header, push_header
from uros.wire.streams import ReliableIn, ReliableOut

STREAM = 0x80
SECONDS_BEFORE = 0.004
LOSSY = [
    ("subscribe", "client"),
    ("publish", "agent"),
]  # name, and the end that acknowledges with gaps


class Row:
    """A line of a capture with the values of its header."""

    def __init__(self, line):
        fields = json.loads(line)
        self.sender, self.client = fields["from"], fields["client"]
        self.time = fields["t"]
        self.raw = bytes.fromhex(fields["hex"])
        self.lost = fields.get("lost", False)
        self.stream = self.raw[1]
        self.number = struct.unpack_from("<H", self.raw, 2)[0]
        self.at = 4 if self.raw[0] >= 0x80 else 8
        self.kind = self.raw[self.at]
        self.payload = self.raw[self.at + 4 :]

    def reader(self):
        size = struct.unpack_from("<H", self.raw, self.at + 2)[0]
        return Reader(self.payload, 0, size, bool(self.raw[self.at + 1] & 1))


def rows(name):
    with open(CAPTURES / "loss" / f"{name}.jsonl", encoding="ascii") as file:
        return [Row(line) for line in file]


def only(items):
    """The only item."""
    (item,) = items
    return item


def gaps(arrived, last):
    """(first missing number, all missing numbers up to the last announced one)."""
    missing = [number for number in range(last + 1) if number not in arrived]
    return (missing or [last + 1])[0], frozenset(missing)


def acknowledgements(name, by):
    """Yield each ACKNACK of ``by``, its possible meanings, and the numbers that had arrived.

    It was written shortly before it passed the relay, so each state of the last ``SECONDS_BEFORE``
    is a possible meaning. The numbers stay far from 65535.
    """
    arrived, last = set(), -1
    states = [(0.0, gaps(arrived, last))]
    for row in rows(name):
        if row.sender != by and not row.lost:
            if row.stream == STREAM:
                arrived.add(row.number)
                last = max(last, row.number)
            elif row.kind == ids.HEARTBEAT and row.payload[4] == STREAM:
                last = max(last, struct.unpack_from("<H", row.payload, 2)[0])
            states.append((row.time, gaps(arrived, last)))
        elif row.sender == by and row.kind == ids.ACKNACK and row.payload[4] == STREAM:
            while len(states) > 1 and states[1][0] < row.time - SECONDS_BEFORE:
                del states[0]
            yield row, {meaning for _, meaning in states}, set(arrived)


def asked(first, missing):
    return first, frozenset(first + bit for bit in range(16) if missing >> bit & 1)


@pytest.mark.parametrize(("name", "by"), LOSSY)
def test_a_recorded_acknack_requests_the_lost_messages(name, by):
    with_gaps, high = 0, 0
    for row, meanings, _ in acknowledgements(name, by):
        first, missing, stream = session.pull_acknack(row.reader())
        assert stream == STREAM
        assert asked(first, missing) in meanings
        with_gaps += missing != 0
        high += missing > 0xFF
    assert with_gaps >= 20, "nothing is lost here"


@pytest.mark.parametrize(("name", "by"), LOSSY)
def test_our_acknack_has_the_same_octets_for_the_same_loss(name, by):
    same = 0
    for row, meanings, arrived in acknowledgements(name, by):
        key = struct.unpack_from(">I", row.raw, 4)[0] if row.raw[0] < 0x80 else 0
        octets = set()
        for first, missing in meanings:
            ours = ReliableIn()
            ours.next = first
            ours.announced = max(missing, default=first - 1) & 0xFFFF
            for number in arrived:
                if number > first:
                    ours.receive(number, b"x")
            octets.add(session.acknack_message(row.raw[0], key, *ours.acknack(), STREAM))
        same += row.raw in octets and any(row.payload[2:4])
    assert same >= 20


def test_our_client_sends_the_acknack_of_the_c_client_for_the_same_loss():
    same = 0
    for row, meanings, _ in acknowledgements("subscribe", "client"):
        octets = set()
        for first, missing in meanings:
            last = max(missing, default=first - 1)
            bench = Bench()
            for number in range(last + 1):
                if number not in missing:
                    bench.sample(number, b"1234")
            bench.heartbeat(0, last & 0xFFFF)
            bench.session.tick(0)
            octets.add(bench.take()[-1][4:])
        assert row.raw[row.at :] in octets
        same += any(row.payload[2:4])
    assert same >= 100


def test_our_agent_retransmits_what_a_c_client_requests():
    resent = 0
    for row, meanings, _ in acknowledgements("subscribe", "client"):
        talk = Session(0x12345678, row.raw[0], 512, Handler())
        out = talk._out[STREAM] = ReliableOut(window=0x4000)
        for number in range(
            max(max(numbers, default=first - 1) for first, numbers in meanings) + 1
        ):
            talk.send(ids.DATA, 1, STREAM, b"\0\x0e\0\x16" + bytes([number]), 100)
        talk.outgoing.clear()
        buf = bytearray(row.raw)
        talk.receive(buf, memoryview(buf), len(buf), 1000)
        again = frozenset(pull_header(message, len(message))[2] for message in talk.outgoing)
        assert (out.acked, again) in meanings
        resent += len(again)
    assert resent >= 100


def test_our_client_retransmits_what_the_cpp_agent_requests():
    resent = 0
    for row, meanings, _ in acknowledgements("publish", "agent"):
        first = struct.unpack_from("<H", row.payload)[0]
        possible = [missing for number, missing in meanings if number == first]
        sent = max(max(missing, default=first - 1) for missing in possible) + 1
        bench = Bench()
        bench.session.id = row.raw[0]
        for number in range(sent):
            if number >= 16:
                bench.acknack(number - 15, now=100)
            bench.request(now=100)
        bench.take()
        bench.session.receive(row.raw, 1000)
        again = frozenset(sequences(bench.take()))
        assert bench.session.acked == first and again in possible
        resent += len(again)
    assert resent >= 50


def test_read_data_has_the_limits_of_the_recorded_program():
    """READ_DATA has the limits of the program's uxrDeliveryControl, of datareader 0x126.

    They are max_samples 0x0102, max_elapsed_time 0x0304, max_bytes_per_second 0x0506 and
    min_pace_period 0x0708.
    """
    row = only(row for row in rows("read_limits") if row.kind == ids.READ_DATA)
    request, thing, stream, form, content_filter, control = data.pull_read_data(row.reader())
    assert (request, thing, stream, form, content_filter) == (14, 0x1266, STREAM, 0, None)
    assert control == (0x0102, 0x0304, 0x0506, 0x0708)
    w = Writer(bytearray(64))
    data.push_read_data(w, 14, 0x1266, STREAM, control=(0x0102, 0x0304, 0x0506, 0x0708))
    assert bytes(w.buf[: w.offset]) == row.payload[:16]


def test_our_agent_applies_the_limits_of_the_recorded_program():
    desk = Desk()
    for row in rows("read_limits"):
        if row.sender == "client" and row.client == 0 and row.kind != ids.DELETE:
            desk.hear(row.raw)
    things = only(desk.agent.clients.values()).objects.values()
    delivery = only(endpoint.delivery for endpoint in things if endpoint.delivery is not None)
    assert delivery.remaining == 0x0102
    assert (delivery._bytes_per_second, delivery._pace) == (0x0506, 0x0708)
    desk.close()


def test_the_client_key_and_its_octets():
    """The key 0x12345678 of the program is in each header, since its session is 0x01."""
    first = rows("subscribe")[0]
    values = session.pull_create_client(Reader(first.payload, 0, len(first.payload), True))
    assert (values[3], values[4], values[6]) == (0x12345678, 0x01, 508)
    with_key = [row for row in rows("subscribe") if row.raw[0] == 0x01]
    assert len(with_key) > 100 and {row.sender for row in with_key} == {"client", "agent"}
    for row in with_key:
        head = pull_header(row.raw, len(row.raw))
        assert head == (0x01, row.stream, row.number, 0x12345678, 8)
        ours = bytearray(8)
        push_header(ours, 0x01, row.stream, row.number, 0x12345678)
        assert ours == row.raw[:8]
    w = Writer(bytearray(64))
    session.push_create_client(w, 0x12345678, 0x01, 508)
    assert bytes(w.buf[: w.offset]) == first.payload[: w.offset]


IDENTITY = bytes(range(0xA0, 0xAC)) + b"\xb1\xb2\xb3\xc4", 0x0102030405060708


def test_a_reply_has_the_sample_identity_of_the_recorded_program():
    """WRITE_DATA number 16 has the SampleIdentity of the program.

    Its GUID has the prefix A0 to AB, the key B1 B2 B3 and the kind C4; its sequence number is high
    0x01020304, low 0x05060708.
    """
    replies = [
        row
        for row in rows("service_identity")
        if row.sender == "client" and row.client == 0 and row.kind == ids.WRITE_DATA
    ]
    assert len(replies) == 4
    row = replies[-1]
    reader = row.reader()
    assert session.pull_request(reader) == (16, 0x1478)
    assert data.pull_sample_identity(row.payload, 4, reader.end) == IDENTITY
    assert row.payload[28:36] == bytes(range(1, 9))
    buf = bytearray(24)
    data.push_sample_identity(buf, 0, *IDENTITY)
    assert buf == row.payload[4:28]


def test_samples_published_with_loss_arrive_once_and_in_order():
    """60 numbered samples of the C client arrive, from messages lost, duplicated and late."""
    talk = Session(0x9ABCDEF1, 0x81, 512, Handler())
    samples = []
    talk.writers[0x1365] = lambda cdr: samples.append(bytes(cdr[4:8])) is None
    for row in rows("publish"):
        if row.sender == "client" and not row.lost and row.raw[0] == 0x81:
            buf = bytearray(row.raw)
            talk.receive(buf, memoryview(buf), len(buf), 100)
    assert [struct.unpack("<I", octets)[0] for octets in samples] == list(range(60))


def sample_of(index, size):
    """The sample that the program wrote as its message ``index``."""
    return bytes((i * 7 + (5 + 2 * index) * 3) % 251 | 8 for i in range(size))


def test_fragments_that_a_c_client_abandoned_do_not_join_the_next_message():
    """The complete messages arrive, and three abandoned ones are counted.

    The program abandoned 6000 octets and wrote 5000, abandoned 7000 and wrote 7000, abandoned
    66,000 and wrote 4000, then 5003; the agent acknowledged the complete ones.
    """
    handler = Handler()
    talk = Session(0x12345678, 0x81, 512, handler)
    samples = []
    talk.writers[0x1365] = lambda cdr: samples.append(bytes(cdr[4:])) is None
    for row in rows("given_up"):
        if row.sender == "client" and row.raw[0] == 0x81:
            buf = bytearray(row.raw)
            talk.receive(buf, memoryview(buf), len(buf), 100)
    assert samples == [
        sample_of(1, 5000),
        sample_of(3, 7000),
        sample_of(5, 4000),
        sample_of(6, 5003),
    ]
    assert talk.given_up == 3
