"""The session alone: datagrams and the time in, datagrams out."""

import pytest
from hypothesis import given
from hypothesis import strategies as st
from unit.agent.helpers import (
    KEY,
    SESSION,
    acknack,
    fragment,
    heartbeat,
    message,
    parse,
    sub,
    whole,
    write_data,
)

from uros.agent.policy.memory_budget import MESSAGE_BYTES
from uros.agent.session import session as module
from uros.agent.session.session import Session
from uros.middleware.base import MiddlewareError
from uros.ticks import TIME_MASK
from uros.wire import ids
from uros.wire.cdr import Reader
from uros.wire.errors import DecodeError, LimitError
from uros.wire.header import MessageWriter, push_header, push_subheader
from uros.wire.session import pull_acknack, pull_heartbeat
from uros.wire.streams import MAX_MESSAGE, split

WRITER = 0x0015
OTHER = 0x0025


class Handler:
    """Records the calls of a session; the next ``full`` submessages find no room."""

    def __init__(self):
        self.submessages = []
        self.rooms = []
        self.faults = []
        self.full = 0

    def submessage(self, kind, flags, stream, payload):
        if self.full:
            self.full -= 1
            return False
        self.submessages.append((kind, flags, stream, bytes(payload)))
        return True

    def room(self, stream):
        self.rooms.append(stream)

    def many_fragments(self, size, count):
        pass

    def fault(self, text, about):
        self.faults.append((text, about))


class Talk:
    """A session with a handler and a writer; the test plays the client."""

    def __init__(self, mtu=512, session_id=SESSION):
        self.handler = Handler()
        self.session = Session(KEY, session_id, mtu, self.handler)
        self.now = 5000
        self.written = []
        self.full = 0
        self.session.writers[WRITER] = self.write
        self.sequence = {}

    def write(self, cdr):
        if self.full:
            self.full -= 1
            return False
        self.written.append(bytes(cdr))
        return True

    def samples(self):
        return [item[4:] for item in self.written]

    def raw(self, datagram):
        buf = bytearray(datagram)
        return self.session.receive(buf, memoryview(buf), len(buf), self.now)

    def hear(self, *submessages, stream=ids.STREAM_RELIABLE, sequence=None):
        if sequence is None:
            sequence = self.sequence.get(stream, 0)
            if stream:
                self.sequence[stream] = (sequence + 1) & 0xFFFF
        return self.raw(message(submessages, stream, sequence, self.session.session_id))

    def out(self):
        """Finish the turn; return what the session sends."""
        self.session.finish()
        sent, self.session.outgoing[:] = list(self.session.outgoing), []
        return [parse(item) for item in sent]

    def wait(self, milliseconds):
        """Advance the clock; poll the session at its deadlines."""
        out = []
        end = self.now + milliseconds
        while True:
            at = self.session.next_deadline()
            if at is None or at > end:
                break
            assert at >= self.now
            self.now = at
            self.session.poll(self.now)
            out += self.out()
        self.now = end
        return out


def acks(out):
    """Return (first unacknowledged, missing, stream) of each ACKNACK."""
    return [
        pull_acknack(Reader(payload, 0, len(payload)))
        for _, submessages in out
        for kind, _, payload in submessages
        if kind == ids.ACKNACK
    ]


def heartbeats(out):
    return [
        pull_heartbeat(Reader(payload, 0, len(payload)))
        for _, submessages in out
        for kind, _, payload in submessages
        if kind == ids.HEARTBEAT
    ]


@pytest.fixture
def talk():
    return Talk()


# --- the fast path -----------------------------------------------------------------


def test_a_written_sample_gets_an_encapsulation_header_of_its_byte_order(talk):
    talk.hear(write_data(WRITER, b"little"))
    talk.hear(write_data(WRITER, b"BIG END", flags=0))
    assert talk.written == [b"\0\1\0\0little", b"\0\0\0\0BIG END"]
    assert not talk.handler.submessages


def test_the_writer_gets_a_view_of_the_receive_buffer_and_no_copy(talk):
    samples = []
    talk.session.writers[WRITER] = lambda cdr: samples.append(cdr.obj) or True
    buf = bytearray(message([write_data(WRITER, b"sample")]))
    talk.session.receive(buf, memoryview(buf), len(buf), 0)
    assert samples[0] is buf


def test_only_the_datagrams_length_of_a_buffer_is_read(talk):
    datagram = message([write_data(WRITER, b"sample")])
    buf = bytearray(datagram) + write_data(WRITER, b"old")[2] * 3
    talk.session.receive(buf, memoryview(buf), len(datagram), 0)
    assert talk.samples() == [b"sample"]


def test_several_samples_in_one_message(talk):
    talk.hear(*[write_data(WRITER, bytes([65 + i]) * (i + 1)) for i in range(9)])
    assert talk.samples() == [bytes([65 + i]) * (i + 1) for i in range(9)]


@pytest.mark.parametrize(
    "flags", [ids.FORMAT_SAMPLE, ids.FORMAT_DATA_SEQ, ids.FORMAT_SAMPLE_SEQ, ids.FORMAT_MASK]
)
def test_other_formats_do_not_reach_the_writer(talk, flags):
    talk.hear(write_data(WRITER, b"sample", flags=1 | flags))
    assert not talk.written
    assert len(talk.handler.submessages) == 1


@pytest.mark.parametrize("size", range(5))
def test_write_data_too_short_for_a_sample_does_not_reach_the_writer(talk, size):
    payload = b"\0\0\0\x15"[:size]
    talk.hear(sub(ids.WRITE_DATA, payload), write_data(WRITER, b"next"))
    assert talk.samples() == [b"next"]
    assert [item[3] for item in talk.handler.submessages] == [payload]


def test_a_writer_that_fails_is_a_fault_and_the_rest_is_written(talk):
    def fail(cdr):
        raise MiddlewareError("no network")

    talk.session.writers[OTHER] = fail
    talk.hear(write_data(WRITER, b"a"), write_data(OTHER, b"b"), write_data(WRITER, b"c"))
    assert talk.samples() == [b"a", b"c"]
    assert talk.handler.faults == [("middleware error", "no network")]
    assert acks(talk.out()) == [(1, 0, ids.STREAM_RELIABLE)]


# --- streams in ------------------------------------------------------------------------


def test_best_effort_drops_old_and_duplicate_messages(talk):
    for sequence in (0, 1, 1, 0, 3, 2, 4, 0xFFFF):
        talk.hear(write_data(WRITER, bytes([sequence & 0xFF])), stream=1, sequence=sequence)
    assert talk.samples() == [b"\0", b"\1", b"\3", b"\4"]
    assert talk.out() == []


def test_best_effort_streams_have_their_own_numbers(talk):
    for stream in (1, 2, 3):
        talk.hear(write_data(WRITER, bytes([stream])), stream=stream, sequence=0)
    assert talk.samples() == [b"\1", b"\2", b"\3"]


@pytest.mark.parametrize("stream", [1, ids.STREAM_RELIABLE])
def test_numbers_wrap(talk, stream):
    for number in range(0x10000 + 20):
        talk.raw(message([write_data(WRITER, number.to_bytes(4, "big"))], stream, number & 0xFFFF))
        if number % 1000 == 999:
            talk.out()
    assert talk.samples() == [n.to_bytes(4, "big") for n in range(0x10000 + 20)]


def test_reliable_order_and_gaps(talk):
    for number in (0, 2, 3, 5):
        talk.hear(write_data(WRITER, bytes([number])), sequence=number)
    assert talk.samples() == [b"\0"]
    assert acks(talk.out()) == [(1, 0b01001, ids.STREAM_RELIABLE)]
    talk.hear(write_data(WRITER, b"\1"), sequence=1)
    assert talk.samples() == [b"\0", b"\1", b"\2", b"\3"]
    assert acks(talk.out()) == [(4, 0b1, ids.STREAM_RELIABLE)]
    talk.hear(write_data(WRITER, b"\4"), sequence=4)
    assert talk.samples() == [bytes([n]) for n in range(6)]


def test_reliable_duplicates_are_acknowledged_and_not_handled_again(talk):
    talk.hear(write_data(WRITER, b"a"), sequence=0)
    talk.out()
    talk.hear(write_data(WRITER, b"a"), sequence=0)
    assert talk.samples() == [b"a"]
    assert acks(talk.out()) == [(1, 0, ids.STREAM_RELIABLE)]


def test_messages_far_ahead_are_not_kept(talk):
    talk.hear(write_data(WRITER, b"far"), sequence=16)
    talk.hear(write_data(WRITER, b"0"), sequence=0)
    for number in range(1, 16):
        talk.hear(write_data(WRITER, b"."), sequence=number)
    assert b"far" not in talk.samples()
    talk.hear(write_data(WRITER, b"far"), sequence=16)
    assert talk.samples()[-1] == b"far"


def test_one_acknowledgement_for_a_burst_and_one_for_each_stream(talk):
    for _ in range(10):
        talk.hear(write_data(WRITER, b"a"))
        talk.hear(write_data(WRITER, b"b"), stream=0x85)
    assert acks(talk.out()) == [(10, 0, 0x80), (10, 0, 0x85)]
    assert talk.out() == []


def test_a_heartbeat_is_answered_and_asks_for_what_is_missing(talk):
    talk.hear(heartbeat(0, 2), stream=0)
    assert acks(talk.out()) == [(0, 0b111, ids.STREAM_RELIABLE)]


def out_of_step(talk, first, last):
    """Send heartbeats that contradict the stream until the session accepts them."""
    for _ in range(10):
        talk.hear(heartbeat(first, last), stream=0)
        talk.now += 200
    assert not talk.handler.faults
    talk.hear(heartbeat(first, last), stream=0)
    (fault,) = talk.handler.faults
    assert fault[0] == "stream out of step"
    talk.handler.faults.clear()


@pytest.mark.parametrize("ends", [(500, 503), (2, 2), (40000, 40000), (30000, 30015)])
def test_a_late_heartbeat_of_an_earlier_session_changes_nothing(talk, ends):
    # A board that was reset has the same key and session id, and starts with number 0.
    for _ in range(50):
        talk.hear(heartbeat(*ends), stream=0)
    for number in (0, 2, 3):
        talk.hear(write_data(WRITER, b"%d" % number), sequence=number)
        talk.hear(heartbeat(*ends), stream=0)
        # C clients accept any ACKNACK: one of 500 would end their stream.
        assert [ack[0] for ack in acks(talk.out())] == [1]
        talk.now += 5000
    talk.hear(write_data(WRITER, b"1"), sequence=1)
    assert talk.samples() == [b"0", b"1", b"2", b"3"]
    assert acks(talk.out()) == [(4, 0, ids.STREAM_RELIABLE)] and not talk.handler.faults


def test_messages_that_a_client_abandoned_are_skipped(talk):
    talk.hear(write_data(WRITER, b"2"), sequence=2)
    out_of_step(talk, 2, 2)
    assert acks(talk.out()) == [(2, 1, ids.STREAM_RELIABLE)]
    talk.hear(write_data(WRITER, b"2"), sequence=2)
    assert talk.samples() == [b"2"]
    assert acks(talk.out()) == [(3, 0, ids.STREAM_RELIABLE)]


def test_a_reliable_stream_goes_on_after_its_numbers_fell_back(talk):
    for number in range(20):
        talk.hear(write_data(WRITER, b"x"), sequence=number)
    talk.out()
    out_of_step(talk, 0, 2)
    assert acks(talk.out()) == [(0, 0b111, ids.STREAM_RELIABLE)]
    for number in range(3):
        talk.hear(write_data(WRITER, b"%d" % number), sequence=number)
    assert talk.samples()[20:] == [b"0", b"1", b"2"]


def test_a_best_effort_stream_goes_on_after_a_jump(talk):
    for number in (0, 1, *range(40002, 40032)):
        talk.hear(write_data(WRITER, b"%d" % number), stream=1, sequence=number)
        talk.hear(write_data(WRITER, b"doubled"), stream=1, sequence=number)
        talk.now += 100
    assert talk.samples() == [b"0", b"1"] + [b"%d" % item for item in range(40022, 40032)]
    assert talk.session.lost < 100


def test_a_heartbeat_within_a_reliable_message_does_not_overtake_its_rest(talk):
    talk.hear(write_data(WRITER, b"2"), sequence=1)
    talk.hear(write_data(WRITER, b"0"), heartbeat(0, 1), write_data(WRITER, b"1"), sequence=0)
    assert talk.samples() == [b"0", b"1", b"2"]


def test_too_many_streams_are_refused(talk):
    for stream in range(1, 100):
        talk.hear(write_data(WRITER, bytes([stream])), stream=stream, sequence=0)
        talk.hear(write_data(WRITER, bytes([stream])), stream=stream + 128, sequence=0)
        talk.hear(heartbeat(0, 0, stream + 128), stream=0)
    assert len(talk.written) == 2 * module.MAX_STREAMS
    assert len(acks(talk.out())) == module.MAX_STREAMS
    assert ("too many streams", "stream: 99") in talk.handler.faults


# --- fragments in ------------------------------------------------------------------------


def parts_of(submessage, room=100):
    raw = whole(submessage)
    return [fragment(raw[a:b], bool(f & 2)) for a, b, f in split(len(raw), room)]


@pytest.mark.parametrize("size", [1, 96, 97, 5000, 65531, 65532, 70000, 300_000])
def test_fragments_become_one_sample(talk, size):
    sample = bytes(i * 7 & 0xFF for i in range(size))
    for part in parts_of(write_data(WRITER, sample), 400):
        talk.hear(part)
    talk.hear(write_data(WRITER, b"after"))
    assert talk.samples() == [sample, b"after"]
    assert not talk.handler.faults


def test_fragments_in_any_order_and_doubled(talk):
    sample = bytes(1500)
    parts = list(enumerate(parts_of(write_data(WRITER, sample))))
    assert len(parts) == 16
    for number, part in reversed(parts):
        talk.hear(part, sequence=number)
        talk.hear(part, sequence=number)
    assert talk.samples() == [sample]


def test_more_submessages_behind_the_last_fragment(talk):
    *first, last = parts_of(write_data(WRITER, bytes(250)))
    for part in first:
        talk.hear(part)
    talk.hear(last, write_data(WRITER, b"small"))
    assert talk.samples() == [bytes(250), b"small"]


def test_an_endless_fragmented_message_is_dropped_at_the_limit(talk):
    part = fragment(bytes(60_000))
    for _ in range(MAX_MESSAGE // 60_000 + 2):
        talk.hear(part)
    assert talk.session._in[0x80].fragments.pending <= MAX_MESSAGE
    assert "over" in talk.handler.faults[0][1]
    assert len(talk.handler.faults) == 1
    talk.hear(fragment(b"", True))
    talk.hear(write_data(WRITER, b"after"))
    assert talk.samples() == [b"after"]


def test_fragments_of_all_streams_together_are_limited_to_one_message(talk):
    part = fragment(bytes(60_000))
    for _ in range(MAX_MESSAGE // 60_000 // 4):
        for stream in range(0x80, 0x88):
            talk.hear(part, stream=stream)
    assert sum(item.fragments.pending for item in talk.session._in.values()) <= MAX_MESSAGE
    assert any("over" in about for _, about in talk.handler.faults)
    for stream in range(0x80, 0x88):
        talk.hear(fragment(b"", True), stream=stream)
        for piece in parts_of(write_data(WRITER, b"B" * 350)):
            talk.hear(piece, stream=stream)
    assert talk.samples() == [b"B" * 350] * 8


def test_fragments_in_fragments_are_a_fault_and_no_recursion(talk):
    nest = b""
    while len(nest) < 60_000:
        nest = whole(fragment(nest, True))
    talk.hear(fragment(nest, True))
    talk.hear(write_data(WRITER, b"after"))
    assert [text for text, _ in talk.handler.faults] == ["deserialization error"]
    assert talk.samples() == [b"after"]


def test_a_fragmented_message_has_one_submessage(talk):
    two = whole(write_data(WRITER, b"four")) + whole(write_data(WRITER, b"more"))
    talk.hear(fragment(two, True))
    assert talk.samples() == [b"four"]


@pytest.mark.parametrize("raw", [b"", b"\7", b"\7\1\0"])
def test_empty_fragments(talk, raw):
    talk.hear(fragment(raw, True), write_data(WRITER, b"lost with it"))
    talk.hear(write_data(WRITER, b"after"))
    assert talk.handler.faults and talk.samples() == [b"after"]


def test_a_fragment_on_a_best_effort_stream_is_a_fault(talk):
    talk.hear(fragment(whole(write_data(WRITER, b"x")), True), stream=1)
    assert talk.handler.faults and not talk.written


def test_lost_fragments_drop_their_message_alone(talk):
    first = parts_of(write_data(WRITER, b"A" * 350))
    talk.hear(first[0], sequence=0)
    talk.hear(first[3], sequence=3)
    # 1 and 2 are gone for good
    out_of_step(talk, 3, 3)
    talk.hear(first[3], sequence=3)
    number = 4
    for part in parts_of(write_data(WRITER, b"B" * 350)):
        talk.hear(part, sequence=number)
        number += 1
    assert talk.samples() == [b"B" * 350]
    assert not talk.handler.faults


def test_a_message_whose_end_is_lost_is_not_mixed_with_the_next(talk):
    number = 0
    for part in parts_of(write_data(WRITER, b"A" * 350))[:2]:
        talk.hear(part, sequence=number)
        number += 1
    number += 2
    out_of_step(talk, number, number)
    for letter in (b"B", b"C"):
        for part in parts_of(write_data(WRITER, letter * 350)):
            talk.hear(part, sequence=number)
            number += 1
    # the first one behind the gap may be the rest of A or of B
    assert talk.samples() == [b"C" * 350]
    assert not talk.handler.faults


def test_a_message_that_the_client_abandons_is_not_mixed_with_the_next(talk):
    """A C client whose publish() runs out of time (on_full_output_buffer_fragmented)."""
    for part in parts_of(write_data(WRITER, b"A" * 350))[:3]:
        talk.hear(part)
    talk.hear(write_data(WRITER, b"other"))
    for part in parts_of(write_data(WRITER, b"B" * 350)):
        talk.hear(part)
    assert talk.samples() == [b"other", b"B" * 350]
    assert [text for text, _ in talk.handler.faults] == ["message given up"]


def test_invalid_fragments_are_dropped_alone(talk):
    short = whole(write_data(WRITER, b"A" * 350))[:-13]
    talk.hear(fragment(short[:200]))
    talk.hear(fragment(short[200:], True), write_data(WRITER, b"other"))
    assert talk.samples() == [b"other"]
    assert [text for text, _ in talk.handler.faults] == ["message given up"]


def test_room_is_reported_when_a_full_window_opens_and_at_no_other_acknack(talk):
    """Samples that wait for room would otherwise wait for another ACKNACK, which need not come."""
    for _ in range(15):
        talk.session.send(ids.DATA, 1, 0x80, b"\0\x0e\0\x16", talk.now)
    talk.hear(acknack(1), stream=0)
    assert talk.handler.rooms == []
    for _ in range(2):
        talk.session.send(ids.DATA, 1, 0x80, b"\0\x0e\0\x16", talk.now)
    assert talk.session.room(0x80) == 0
    talk.hear(acknack(17), stream=0)
    assert talk.handler.rooms == [0x80]
    talk.hear(acknack(17), stream=0)
    assert talk.handler.rooms == [0x80]


def test_the_size_of_held_messages_includes_their_overhead(talk):
    """Otherwise empty messages would cost nothing in the memory budget."""
    assert talk.session.held() == 0
    for _ in range(3):
        talk.session.send(ids.DATA, 1, 0x80, b"\0\x0e\0\x16", talk.now)
    out = 3 * (4 + 4 + 4 + MESSAGE_BYTES)
    assert talk.session.held() == out
    talk.hear(fragment(bytes(100)))
    assert talk.session.held() == out + 100
    talk.hear(write_data(WRITER, b"early"), sequence=5)
    early = talk.session.held() - out - 100 - MESSAGE_BYTES
    assert 4 + 4 + 5 <= early <= 16
    talk.full = 1
    talk.hear(write_data(OTHER, b"handled"), write_data(WRITER, b"stalled"), sequence=1)
    stalled = talk.session.held() - out - 100 - early - 2 * MESSAGE_BYTES
    assert 4 + 4 + 7 <= stalled <= 16
    talk.hear(acknack(3), stream=0)
    assert talk.session.held() == 100 + early + stalled + 2 * MESSAGE_BYTES


# --- reset ------------------------------------------------------------------------------


def test_reset_in_the_middle_of_a_fragmented_message(talk):
    for part in parts_of(write_data(WRITER, b"A" * 350))[:2]:
        talk.hear(part)
    talk.hear(sub(ids.RESET), write_data(WRITER, b"not handled"))
    assert talk.out() == []
    talk.sequence.clear()
    for part in parts_of(write_data(WRITER, b"B" * 350)):
        talk.hear(part)
    assert talk.samples() == [b"B" * 350]
    assert acks(talk.out()) == [(4, 0, 0x80)]


def test_reset_outside_of_streams_clears_both_directions(talk):
    talk.hear(write_data(WRITER, b"early"), sequence=1)
    talk.session.send(ids.DATA, 1, 0x80, b"first", talk.now)
    talk.hear(sub(ids.RESET), stream=0)
    assert talk.out() == []
    assert talk.session.next_deadline() is None
    talk.hear(write_data(WRITER, b"0"), sequence=0)
    assert talk.samples() == [b"0"]
    talk.session.send(ids.DATA, 1, 0x80, b"second", talk.now)
    assert [head for head, _ in talk.out()] == [(SESSION, 0x80, 0), (SESSION, 0, 0)]


def test_reset_frees_room_and_reports_it(talk):
    for _ in range(20):
        talk.session.send(ids.DATA, 1, 0x80, b"x", talk.now)
    assert talk.session.room(0x80) == 0
    talk.hear(sub(ids.RESET), stream=0)
    assert talk.handler.rooms == [0x80]


# --- stalls ------------------------------------------------------------------------------


def test_a_stalled_stream_acknowledges_late_and_loses_nothing(talk):
    talk.full = 3
    talk.hear(write_data(WRITER, b"0"), write_data(WRITER, b"1"))
    for number in (1, 2, 3):
        talk.hear(write_data(WRITER, bytes([0x31 + number])), sequence=number)
    talk.hear(write_data(WRITER, b"0"), sequence=0)  # sent again, as it is unacknowledged
    talk.hear(heartbeat(0, 3), stream=0)
    assert talk.samples() == [] and talk.out() == []
    # It is tried again after 5, 10 and 20 ms.
    assert talk.wait(6 * module.STALL_RETRY_MS) == []
    out = talk.wait(module.STALL_RETRY_MS)
    assert talk.samples() == [b"0", b"1", b"2", b"3", b"4"]
    assert acks(out) == [(4, 0, 0x80)]
    assert talk.session.next_deadline() is None


def test_a_stalled_message_resumes_at_the_stalled_submessage(talk):
    talk.written.append(b"")
    samples = []

    def write(cdr):
        samples.append(bytes(cdr[4:]))
        return samples.count(b"b") != 1 or cdr[4:] != b"b"

    talk.session.writers[WRITER] = write
    talk.hear(*[write_data(WRITER, item) for item in (b"a", b"b", b"c")])
    assert samples == [b"a", b"b"]
    talk.wait(module.STALL_RETRY_MS)
    assert samples == [b"a", b"b", b"b", b"c"]


def test_the_ids_of_a_stalled_sample_are_handled_again(talk):
    talk.full = 2
    talk.hear(write_data(WRITER, b"sample"))
    talk.wait(3 * module.STALL_RETRY_MS)
    assert talk.written == [b"\0\1\0\0sample"]


def test_a_stall_within_a_reassembled_message_keeps_the_messages_behind_it(talk):
    *first, last = parts_of(write_data(WRITER, b"F" * 250))
    for part in first:
        talk.hear(part)
    talk.full = 3
    talk.hear(last, write_data(WRITER, b"behind"))
    talk.hear(write_data(WRITER, b"next message"))
    assert talk.out() == []
    assert talk.wait(6 * module.STALL_RETRY_MS) == []
    out = talk.wait(module.STALL_RETRY_MS)
    assert talk.samples() == [b"F" * 250, b"behind", b"next message"]
    assert acks(out) == [(len(first) + 2, 0, 0x80)]


def test_two_stalls_in_one_datagram(talk):
    *first, last = parts_of(write_data(WRITER, b"F" * 250))
    for part in first:
        talk.hear(part)
    full = iter([False, True, False, False, True])

    def write(cdr):
        if not next(full, True):
            return False
        talk.written.append(bytes(cdr))
        return True

    talk.session.writers[WRITER] = write
    talk.hear(last, write_data(WRITER, b"1"), write_data(WRITER, b"2"))
    talk.wait(10 * module.STALL_RETRY_MS)
    assert talk.samples() == [b"F" * 250, b"1", b"2"]


def test_a_stalled_stream_does_not_stall_another(talk):
    talk.session.writers[OTHER] = lambda cdr: False
    talk.hear(write_data(OTHER, b"x"))
    talk.hear(write_data(WRITER, b"y"), stream=0x81)
    assert talk.samples() == [b"y"]
    assert acks(talk.out()) == [(1, 0, 0x81)]


def test_the_handler_can_stall_a_stream_too(talk):
    talk.handler.full = 1
    talk.hear(sub(ids.READ_DATA, b"abcd"), write_data(WRITER, b"x"))
    assert talk.out() == []
    talk.wait(module.STALL_RETRY_MS)
    assert talk.handler.submessages == [(ids.READ_DATA, 1, 0x80, b"abcd")]
    assert talk.samples() == [b"x"]


def test_a_stalled_stream_keeps_at_most_a_window(talk):
    talk.full = 10_000
    for number in range(200):
        talk.hear(write_data(WRITER, bytes([number])), sequence=number)
    assert len(talk.session._in[0x80].stream.waiting) == 16
    talk.full = 0
    talk.wait(module.STALL_RETRY_MS)
    assert talk.samples() == [bytes([n]) for n in range(17)]


def test_reset_ends_a_stall(talk):
    talk.full = 1
    talk.hear(write_data(WRITER, b"old"))
    talk.hear(sub(ids.RESET), stream=0)
    talk.hear(write_data(WRITER, b"new"), sequence=0)
    talk.wait(100)
    assert talk.samples() == [b"new"]


def test_best_effort_drops_and_counts(talk):
    talk.full = 1
    talk.hear(write_data(WRITER, b"0"), write_data(WRITER, b"1"), stream=1)
    assert talk.samples() == [b"1"]
    assert talk.session.dropped == 1


# --- streams out ---------------------------------------------------------------------------


def test_sent_messages_are_numbered_for_each_stream(talk):
    for stream in (1, 0x80, 0, 1, 0x80, 0, 2):
        talk.session.send(ids.DATA, 1, stream, b"pay", talk.now)
    heads = [head for head, _ in talk.out()]
    assert heads == [
        (SESSION, 1, 0), (SESSION, 0x80, 0), (SESSION, 0, 0),
        (SESSION, 1, 1), (SESSION, 0x80, 1), (SESSION, 0, 0), (SESSION, 2, 0),
    ]  # fmt: skip


def test_the_window_opens_with_acknowledgements(talk):
    for number in range(40):
        talk.session.send(ids.DATA, 1, 0x80, bytes([number]), talk.now)
    assert [head[2] for head, _ in talk.out()] == list(range(16))
    assert talk.session.room(0x80) == 0
    talk.hear(acknack(10), stream=0)
    assert [head[2] for head, _ in talk.out()] == list(range(16, 26))
    assert talk.handler.rooms == []
    talk.hear(acknack(26), stream=0)
    talk.hear(acknack(40), stream=0)
    assert talk.session.room(0x80) == 16
    assert talk.handler.rooms == [0x80]
    assert talk.session.next_deadline() is None


def test_lost_messages_are_sent_again_once_asked_for(talk):
    for number in range(4):
        talk.session.send(ids.DATA, 1, 0x80, bytes([number]), talk.now)
    first = talk.out()
    talk.now += 50
    talk.hear(acknack(1, 0b101), stream=0)
    assert talk.out() == [first[1], first[3]]
    talk.hear(acknack(1, 0b101), stream=0)
    assert talk.out() == []  # just sent


def test_acknacks_that_cannot_be_true_are_ignored(talk):
    talk.session.send(ids.DATA, 1, 0x80, b"x", talk.now)
    talk.out()
    for first in (2, 17, 0x8000, 0xFFFF):
        talk.hear(acknack(first, 0xFFFF), stream=0)
    talk.hear(acknack(0, 0xFFFF, 0x90), stream=0)
    assert len(talk.session._out[0x80]) == 1
    assert not talk.handler.faults


def test_numbers_out_wrap(talk):
    for number in range(0x10000 + 40):
        talk.session.send(ids.DATA, 1, 0x80, b"x", talk.now)
        ((_, _, sequence), _) = talk.out()[0]
        assert sequence == number & 0xFFFF
        talk.hear(acknack((number + 1) & 0xFFFF), stream=0)


@pytest.mark.parametrize("session_id", [SESSION, 0x01])
@pytest.mark.parametrize("mtu", [32, 33, 64, 127, 512, 65507])
@pytest.mark.parametrize("size", [4, 20, 600, 70_000])
def test_fragments_out_fit_the_mtu_and_make_the_message(mtu, size, session_id):
    talk = Talk(mtu, session_id)
    payload = bytes(i & 0xFF for i in range(size))
    if not talk.session.send(ids.DATA, 1, 0x80, payload, talk.now):
        assert size // mtu > 1000
        assert talk.session.dropped == 1 and talk.out() == []
        return
    message_bytes = bytearray()
    alone = []
    number = 0
    while True:
        out = talk.session.outgoing[:]
        talk.session.outgoing.clear()
        if not out:
            break
        for datagram in out:
            assert len(datagram) <= mtu
            head, ((kind, flags, part),) = parse(datagram)
            assert head == (session_id, 0x80, number & 0xFFFF)
            number += 1
            if kind == ids.FRAGMENT:
                assert flags & 2 or len(part) % 4 == 0
                message_bytes += part
            else:
                alone.append((kind, flags, part))
        talk.hear(acknack(number & 0xFFFF), stream=0)
    if message_bytes:
        assert message_bytes[:2] == bytes([ids.DATA, 1])
        assert message_bytes[2] | message_bytes[3] << 8 == size & 0xFFFF
        alone.append((ids.DATA, 1, bytes(message_bytes[4:])))
    assert alone == [(ids.DATA, 1, payload)]


def test_half_a_message_is_never_sent(talk):
    big = bytes(508 * 3000)
    assert talk.session.send(ids.DATA, 1, 0x80, big, talk.now)
    assert not talk.session.send(ids.DATA, 1, 0x80, big, talk.now)
    assert talk.handler.faults[0][0] == "message dropped"
    assert talk.session.send(ids.DATA, 1, 0x80, b"small", talk.now)
    last = talk.session._out[0x80]
    assert parse(last.export()[3][(last.next - 1) & 0xFFFF])[1] == [(ids.DATA, 1, b"small")]


def test_a_message_too_large_for_best_effort_is_dropped_counted_and_logged(talk):
    assert not talk.session.send(ids.DATA, 1, 1, bytes(600), talk.now)
    assert talk.session.dropped == 1
    assert "600 bytes" in talk.handler.faults[0][1]
    assert talk.session.send(ids.DATA, 1, 1, bytes(504), talk.now)


def test_messages_for_a_client_that_never_acknowledges_are_limited(talk):
    with pytest.raises(LimitError):
        for _ in range(module.MAX_HELD + 1):
            talk.session.send(ids.STATUS, 1, 0x80, b"status", talk.now)
    assert len(talk.out()) == 16


def test_the_number_of_output_streams_is_limited(talk):
    with pytest.raises(LimitError):
        for stream in range(0x80, 0x100):
            talk.session.send(ids.DATA, 1, stream, b"x", talk.now)
    assert len(talk.session._out) == module.MAX_STREAMS


# --- heartbeats ------------------------------------------------------------------------------


def test_heartbeats_go_out_until_all_is_acknowledged(talk):
    for number in range(3):
        talk.session.send(ids.DATA, 1, 0x80, bytes([number]), talk.now)
    talk.out()
    assert talk.session.next_deadline() == talk.now + 200
    out = talk.wait(1000)
    assert heartbeats(out) == [(0, 2, 0x80)] * 5
    assert all(head == (SESSION, 0, 0) for head, _ in out)
    talk.hear(acknack(2), stream=0)
    assert heartbeats(talk.wait(400)) == [(2, 2, 0x80)] * 2
    talk.hear(acknack(3), stream=0)
    assert talk.session.next_deadline() is None
    assert talk.wait(5000) == []


def test_heartbeats_to_a_silent_client_pause_after_thirty_seconds(talk):
    talk.session.send(ids.DATA, 1, 0x80, b"x", talk.now)
    talk.out()
    early = heartbeats(talk.wait(module.SILENT_MS))
    assert 140 <= len(early) <= 151
    talk.wait(1000)
    assert talk.wait(600_000) == []
    talk.hear(write_data(WRITER, b"here"), stream=1)
    assert heartbeats(talk.wait(module.SILENT_CHECK_MS + 200))
    talk.hear(acknack(1), stream=0)
    assert talk.wait(5000) == []


def test_a_subscriber_that_only_acknowledges_gets_heartbeats_after_hours(talk):
    talk.session.send(ids.DATA, 1, 0x80, b"0", talk.now)
    talk.out()
    talk.wait(200)
    talk.hear(acknack(1), stream=0)
    talk.wait(3 * 3600 * 1000)
    talk.session.send(ids.DATA, 1, 0x80, b"lost", talk.now)
    talk.out()
    assert heartbeats(talk.wait(1000)) == [(1, 1, 0x80)] * 5


def test_a_message_in_the_millisecond_of_a_heartbeat_counts(talk):
    talk.session.send(ids.DATA, 1, 0x80, b"0", talk.now)
    talk.now += 200
    talk.hear(acknack(0), stream=0)
    talk.session.poll(talk.now)
    talk.hear(acknack(1), stream=0)
    talk.wait(60_000)
    talk.session.send(ids.DATA, 1, 0x80, b"1", talk.now)
    talk.out()
    assert heartbeats(talk.wait(200)) == [(1, 1, 0x80)]


def test_time_without_heartbeats_is_no_silence(talk):
    """A client is polled for other reasons as well, such as the pace of a delivery."""
    talk.hear(write_data(WRITER, b"x"), stream=1)
    for _ in range(4):
        talk.now += 20_000
        talk.session.poll(talk.now)
    talk.session.send(ids.DATA, 1, 0x80, b"0", talk.now)
    talk.out()
    assert heartbeats(talk.wait(200)) == [(0, 0, 0x80)]


def test_time_wraps(talk):
    talk.now = TIME_MASK - 300
    talk.session.send(ids.DATA, 1, 0x80, b"x", talk.now)
    talk.out()
    heartbeats_sent = []
    for _ in range(4):
        at = talk.session.next_deadline()
        assert (at - talk.now) & TIME_MASK == 200
        talk.now = at
        talk.session.poll(talk.now)
        heartbeats_sent += heartbeats(talk.out())
    assert heartbeats_sent == [(0, 0, 0x80)] * 4
    assert talk.now < 1000


# --- bad bytes --------------------------------------------------------------------------------


def test_a_truncated_submessage_is_a_fault_and_the_submessages_before_it_are_handled(talk):
    datagram = message([write_data(WRITER, b"good"), write_data(WRITER, b"cut off")])
    talk.raw(datagram[:-2])
    assert talk.samples() == [b"good"]
    assert talk.handler.faults[0][0] == "deserialization error"
    assert acks(talk.out()) == [(1, 0, 0x80)]


def test_a_decode_error_of_the_handler_is_a_fault(talk):
    def broken(*_):
        raise DecodeError("no such thing")

    talk.handler.submessage = broken
    talk.hear(sub(ids.CREATE, b""), write_data(WRITER, b"dropped"))
    talk.hear(write_data(WRITER, b"next"))
    assert talk.handler.faults == [("deserialization error", "no such thing")]
    assert talk.samples() == [b"next"]


@pytest.mark.parametrize("kind", [ids.ACKNACK, ids.HEARTBEAT])
@pytest.mark.parametrize("size", range(5))
def test_truncated_acknack_and_heartbeat(talk, kind, size):
    talk.hear(sub(kind, bytes(size)), stream=0)
    assert talk.handler.faults[0][0] == "deserialization error"


def test_a_heartbeat_of_a_best_effort_stream_is_ignored(talk):
    talk.hear(heartbeat(0, 5, 1), stream=0)
    assert talk.out() == []


def test_answers_carry_the_key_where_the_session_id_is_low():
    talk = Talk(session_id=0x05)
    talk.session.answer(ids.STATUS, 0x80, talk.now, lambda w: w.octets(b"123456"))
    (datagram,) = talk.session.outgoing
    assert datagram[:8] == bytes([0x05, 0x80, 0, 0]) + KEY.to_bytes(4, "big")
    w = MessageWriter(bytearray(64), 0x05, 0x80, 0, KEY)
    w.begin(ids.STATUS)
    w.octets(b"123456")
    assert datagram == w.finish()


@given(
    session_id=st.integers(1, 0xFF), key=st.integers(1, 0xFFFFFFFF), stream=st.integers(1, 0x7F),
    flags=st.integers(0, 0xFF), payload=st.binary(max_size=200), before=st.integers(0, 3),
)  # fmt: skip
def test_a_message_has_the_headers_of_the_wire(session_id, key, stream, flags, payload, before):
    """The session packs them at once; the plain form is that of the wire."""
    session = Session(key, session_id, 512, Handler())
    for _ in range(before):
        session.send(ids.DATA, 1, stream, b"", 0)
    session.outgoing.clear()
    assert session.send(ids.DATA, flags, stream, payload, 0)
    plain = bytearray(300)
    at = push_header(plain, session_id, stream, before, key)
    at = push_subheader(plain, at, ids.DATA, flags, len(payload))
    assert session.outgoing == [bytes(plain[:at]) + payload]
