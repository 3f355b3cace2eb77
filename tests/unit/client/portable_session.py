"""The client's session without I/O. Also runs on MicroPython."""

from support.board import KEY, Blob, Number, built, message, pattern
from support.conversation import unpack
from support.recorder import Recorder

from uros.client.session import DELETE_CLIENT_REQUEST, FIRST_REQUEST
from uros.wire import ids, session
from uros.wire.errors import EncodeError
from uros.wire.streams import HEARTBEAT_MS, RESEND_HOLD_MS, Fragments

WRITER = 0x15


class Bench:
    """A session that records the datagrams it sends and the handlers it calls."""

    def __init__(self, mtu=512, limit=32768):
        self.session = self.owner = Recorder(KEY, mtu, limit)

    def take(self):
        """Return the datagrams sent since the last call."""
        out = self.session.sent
        self.session.sent = []
        return out

    def hear(self, kind, payload, stream=0, sequence=0, now=0, flags=1):
        datagram = message(kind, payload, stream, sequence, self.session.id, flags)
        return self.session.receive(datagram, now)

    def acknack(self, first, missing=0, now=0):
        self.hear(ids.ACKNACK, built(session.push_acknack, first, missing, 0x80), now=now)

    def heartbeat(self, first, last, now=0):
        self.hear(ids.HEARTBEAT, built(session.push_heartbeat, first, last, 0x80), now=now)

    def sample(self, sequence, octets, stream=0x80, now=0):
        return self.hear(ids.DATA, b"\0\x0e\0\x16" + octets, stream, sequence, now)

    def request(self, now=0):
        self.session.now = now
        return self.session.request(ids.DELETE, 1, self.session.begin(0x25))

    def create(self, octets):
        """Send CREATE with these octets as representation."""
        w = self.session.begin(1)
        for octet in (1, ids.IN_BINARY):
            w.u8(octet)
        w.sequence(octets)
        w.u16(0)
        return self.session.request(ids.CREATE, 7, w)

    def write(self, octets, reliable=True, prefix=b"", now=0):
        self.session.now = now
        return self.session.write(WRITER, Blob(octets), prefix, reliable)


def sequences(messages):
    """Return the sequence numbers of the messages on the reliable stream."""
    return [
        datagram[2] | datagram[3] << 8
        for datagram in messages
        if datagram[1] == ids.STREAM_RELIABLE
    ]


def reassembled(messages):
    """Return (kind, payload) of each submessage in reliable messages, fragments joined."""
    fragments = Fragments(1 << 20)
    out = []
    for datagram in messages:
        for kind, flags, payload in unpack(datagram)[1]:
            if kind != ids.FRAGMENT:
                out.append((kind, payload))
                continue
            whole = fragments.add(payload, bool(flags & ids.FLAG_LAST_FRAGMENT))
            if whole is not None:
                out.append((whole[0], bytes(whole[4:])))
    return out


# --- outside of streams -----------------------------------------------------------------------


def test_create_client_has_the_bytes_of_the_c_client() -> None:
    # recorded: publish_reliable, with our key and MTU
    bench = Bench(508)
    bench.session.key = 0xAAAABBBB
    bench.session.create_session()
    assert bench.take() == [
        bytes.fromhex("80000000 00011000 58524345 0100 010f aaaabbbb 81 00 fc01")
    ]


def test_bytes_of_pings_and_of_delete() -> None:
    bench = Bench()
    bench.session.ping(False)
    bench.session.ping(True)
    bench.session.delete_session()
    assert bench.take() == [  # recorded: ping; by hand: DELETE
        bytes.fromhex("80000000 02010800 000a fffd 02000000"),
        bytes.fromhex("81000000 02010800 000a fffd 02000000"),
        bytes.fromhex("81000000 03010400 0009 fffe"),
    ]


def test_bytes_of_timestamp() -> None:
    bench = Bench()
    bench.session.ask_time(0x01020304, 5)
    bench.session.ask_time(-1, 999999999)
    assert bench.take() == [
        bytes.fromhex("81000000 0e010800 04030201 05000000"),
        bytes.fromhex("81000000 0e010800 ffffffff ffc99a3b"),
    ]


def test_only_the_reply_to_the_last_timestamp_is_passed_on_and_once() -> None:
    bench = Bench()
    bench.session.ask_time(5, 6)
    bench.session.ask_time(7, 8)
    transmit, receive = (100, 1), (99, 2)

    def answer(originate):
        bench.hear(
            ids.TIMESTAMP_REPLY,
            built(session.push_timestamp_reply, transmit, receive, originate),
        )

    answer((5, 6))
    assert bench.owner.events == []
    answer((7, 8))
    answer((7, 8))
    assert bench.owner.events == [("time", transmit, receive)]


# --- request ids and sequence numbers -----------------------------------------------------------


def test_request_ids_begin_at_ten_and_wrap_to_ten() -> None:
    bench = Bench()
    assert bench.request() == FIRST_REQUEST == 10
    assert bench.write(b"abcd") == 11
    assert bench.write(b"abcd", False) == 12
    bench.session.request_id = 0xFFFF
    assert bench.request() == 0xFFFF
    assert bench.write(b"abcd") == 10
    for datagram, request in zip(bench.take(), (10, 11, 12, 0xFFFF, 10)):
        assert datagram[8:10] == bytes((request >> 8, request & 0xFF))


def test_a_requests_bytes() -> None:
    bench = Bench()
    bench.create(b"abcd")
    bench.request()
    assert bench.take() == [
        bytes.fromhex("81800000 01071200 000a 0001 01 03 0000 04000000 61626364 0000"),
        bytes.fromhex("81800100 03010400 000b 0025"),
    ]


def test_a_samples_bytes() -> None:
    bench = Bench()
    assert bench.session.write(WRITER, Number(1), b"", True) == 10
    assert bench.session.write(WRITER, Number(-2), b"", False) == 11
    assert bench.session.write(0x18, Number(3), bytes(range(24)), True) == 12
    assert bench.take() == [
        bytes.fromhex("81800000 07010800 000a 0015 01000000"),
        bytes.fromhex("81010000 07010800 000b 0015 feffffff"),
        bytes.fromhex("81800100 07012000 000c 0018") + bytes(range(24)) + b"\3\0\0\0",
    ]


def test_a_too_long_request_is_refused_and_nothing_is_sent() -> None:
    for mtu in (63, 64, 512, 600):
        bench = Bench(mtu=mtu)
        size = max(mtu, 512) - 21  # one byte too many
        try:
            bench.create(bytes(size))
        except EncodeError:
            pass
        else:
            raise AssertionError("not refused")
        assert bench.take() == [] and bench.session.held() == 0
        bench.request()
        assert sequences(bench.take()) == [0]


def test_a_request_longer_than_the_mtu_is_sent_in_fragments() -> None:
    whole = Bench()
    whole.create(bytes(range(200)))
    bench = Bench(mtu=63)
    assert bench.create(bytes(range(200))) == 10
    out = bench.take()
    assert sequences(out) == [0, 1, 2, 3, 4] and all([len(datagram) <= 63 for datagram in out])
    assert [datagram[4:6] for datagram in out] == [b"\x0d\x01"] * 4 + [b"\x0d\x03"]
    assert b"".join([datagram[8:] for datagram in out]) == whole.take()[0][4:]
    bench.request()
    assert sequences(bench.take()) == [5]


# --- the window -------------------------------------------------------------------------------


def test_a_window_of_requests_is_sent_without_waiting() -> None:
    bench = Bench()
    for _ in range(16):
        assert bench.session.available()
        bench.request()
    assert not bench.session.available()
    for _ in range(4):
        bench.request()
    assert sequences(bench.take()) == list(range(16))
    bench.acknack(3)
    assert sequences(bench.take()) == [16, 17, 18]
    bench.acknack(3)
    assert bench.take() == []
    bench.acknack(20)  # never sent
    assert bench.take() == [] and bench.session.held() == 17
    bench.acknack(19)
    assert sequences(bench.take()) == [19]
    bench.acknack(20)
    assert bench.session.held() == 0 and bench.session.deadline is None


def test_sequence_numbers_wrap() -> None:
    bench = Bench()
    bench.session.next = bench.session.acked = 65500
    for i in range(65500, 65536 + 40):
        bench.request()
        bench.acknack((i + 1) & 0xFFFF)
        assert bench.session.held() == 0
    assert sequences(bench.take()) == list(range(65500, 65536)) + list(range(40))


def test_missing_messages_are_resent_and_heartbeats_sent() -> None:
    bench = Bench()
    for _ in range(5):
        bench.request(now=100)
    first = bench.take()
    bench.session.tick(100)
    assert bench.session.deadline == 100 + HEARTBEAT_MS
    bench.session.tick(100 + HEARTBEAT_MS - 1)
    assert bench.take() == []
    bench.session.tick(100 + HEARTBEAT_MS)
    assert bench.take() == [bytes.fromhex("81000000 0b010500 0000 0400 80")]
    bench.acknack(1, 0b101, now=350)
    assert bench.take() == [first[1], first[3]]
    bench.acknack(1, 0b101, now=351)  # within the hold time: the same loss
    assert bench.take() == []
    bench.acknack(1, 0b1000, now=400)
    assert bench.take() == [first[4]]


def test_acknacks_without_news_do_not_postpone_the_heartbeat() -> None:
    """The agent repeats its ACKNACK faster than every 200 ms, and the only message was lost."""
    bench = Bench()
    bench.request(now=100)
    bench.session.tick(100)
    bench.take()
    for now in range(150, 100 + HEARTBEAT_MS, 50):
        bench.acknack(0, now=now)
        bench.session.tick(now)
        assert bench.take() == []
    assert bench.session.deadline == 100 + HEARTBEAT_MS
    bench.session.tick(100 + HEARTBEAT_MS)
    assert bench.take() == [bytes.fromhex("81000000 0b010500 0000 0000 80")]


def test_a_repeated_acknack_within_the_hold_time_causes_a_heartbeat() -> None:
    """The second ACKNACK may be for the same loss or for another: a HEARTBEAT asks."""
    bench = Bench()
    for _ in range(2):
        bench.request(now=100)
    first = bench.take()
    bench.acknack(0, 0b1, now=150)
    assert bench.take() == first[:1]
    bench.acknack(0, 0b1, now=150 + RESEND_HOLD_MS - 1)
    assert bench.take() == []
    assert bench.session.deadline == 150 + 2 * RESEND_HOLD_MS - 1
    bench.session.tick(150 + 2 * RESEND_HOLD_MS - 1)
    assert bench.take() == [bytes.fromhex("81000000 0b010500 0000 0100 80")]
    bench.acknack(0, 0b1, now=150 + 2 * RESEND_HOLD_MS)
    assert bench.take() == first[:1]


def test_the_hold_time_of_a_slot_ends_with_its_message() -> None:
    bench = Bench()
    for number in range(17):
        bench.request(now=100)
        sent = bench.take()
        if number in (0, 16):
            bench.acknack(number, 1, now=100)
            assert bench.take() == sent
        bench.acknack(number + 1, now=100)


def test_an_acknack_for_unsent_messages_resends_the_sent_ones() -> None:
    bench = Bench()
    for _ in range(3):
        bench.request(now=100)
    sent = bench.take()
    bench.acknack(1, 0xFFFF, now=200)
    assert bench.take() == sent[1:]
    bench.acknack(3, 0xFFFF, now=300)
    assert bench.take() == [] and bench.session.in_flight() == 0


def test_a_missing_message_is_resent_after_the_hold_time() -> None:
    bench = Bench()
    bench.request(now=100)
    sent = bench.take()
    for now, again in ((200, 1), (209, 0), (210, 1), (211, 0), (219, 0), (220, 1)):
        bench.acknack(0, 1, now=now)
        assert bench.take() == sent * again, now


def test_publishing_never_waits_and_stops_at_the_limit() -> None:
    bench = Bench(limit=1000)
    sent = 0
    while bench.write(pattern(88)):  # 100 octets of message
        sent += 1
    assert sent == 10
    assert sequences(bench.take()) == list(range(10))
    before = bench.session.request_id, bench.session.next, bench.session.size()
    assert bench.write(pattern(88)) == 0
    assert before == (
        bench.session.request_id, bench.session.next, bench.session.size()
    )  # fmt: skip
    assert bench.take() == []
    assert bench.write(b"abcd", False)  # best effort needs no room in the queue
    bench.acknack(1)
    assert bench.write(pattern(88)) and not bench.write(pattern(88))


def test_many_small_samples_are_queued_and_sent_in_order() -> None:
    bench = Bench(limit=1 << 13)
    bench.session.next = bench.session.acked = 0xFFF0
    count = 0
    while bench.write(b""):
        count += 1
    assert count > 600, count
    assert bench.write(pattern(6000)) == 0
    request = 10
    for _ in range(count // 16 + 1):
        for datagram in bench.take():
            assert datagram[8] << 8 | datagram[9] == request
            request = 10 if request == 0xFFFF else request + 1
        bench.acknack(bench.session.next)
    assert bench.session.held() == 0 and bench.session.size() == 0


def test_an_error_of_packing_sends_nothing() -> None:
    class Bad(Blob):
        def pack_into(self, buf, offset, start):
            raise TypeError("a field")

    for size in (4, 2000):
        for reliable in (True, False):
            bench = Bench(2048)
            try:
                bench.session.write(WRITER, Bad(bytes(size)), b"", reliable)
            except TypeError:
                pass
            else:
                raise AssertionError("not raised")
            assert bench.take() == [] and bench.session.request_id == 10
            assert bench.write(b"abcd", reliable) == 10
            assert unpack(bench.take()[0])[0][2] == 0


# --- fragments --------------------------------------------------------------------------------


def test_samples_around_the_size_of_a_message() -> None:
    for mtu in (64, 67, 512):
        for size in (mtu - 13, mtu - 12, mtu - 11, 2 * mtu - 24, 2 * mtu):
            bench = Bench(mtu)
            octets = pattern(size)
            assert bench.write(octets) == 10
            out = bench.take()
            assert all([len(datagram) <= mtu for datagram in out])
            assert (len(out) == 1) == (size <= mtu - 12)
            assert sequences(out) == list(range(len(out)))
            assert reassembled(out) == [(ids.WRITE_DATA, b"\0\x0a\0\x15" + octets)]
            for datagram in out[:-1]:
                assert len(datagram) % 4 == 0  # the next header of a C agent is aligned


def test_fragments_of_large_samples_and_over_64_kb() -> None:
    for size in (15000, 65523, 65532, 70000):
        bench = Bench(limit=80000)
        octets = pattern(size)
        assert bench.write(octets) == 10
        out = bench.take()
        assert len(out) == 16
        for _ in range(1000):
            bench.acknack(bench.session.next)
            more = bench.take()
            if not more:
                break
            out += more
        assert sequences(out) == list(range(len(out)))
        submessages = reassembled(out)
        assert len(submessages) == 1 and submessages[0][1][4:] == octets
        # As the C client: 0 where the length does not fit. eProsima's agent would cut the sample.
        length = 4 + size if 4 + size <= 0xFFFF else 0
        assert out[0][8:12] == bytes([ids.WRITE_DATA, 1, length & 0xFF, length >> 8]), size
        assert bench.write(b"next") == 11
        assert bench.session.size() == 16


def test_a_sample_over_the_limit_raises() -> None:
    bench = Bench(limit=1000)
    for size, reliable, text in ((989, True, "1001"), (501, False, "513")):
        try:
            bench.write(bytes(size), reliable)
        except EncodeError as error:
            assert text in str(error) and "Blob" in str(error), error
        else:
            raise AssertionError("not refused")
    assert bench.take() == []
    assert bench.write(bytes(988)) == 10 and len(bench.take()) == 2
    assert bench.write(bytes(500), False) == 11 and len(bench.take()[0]) == 512


def test_received_fragments_are_joined() -> None:
    bench = Bench()
    whole = bytes((ids.DATA, 1, 0, 0)) + b"\0\x0e\0\x16" + pattern(2000)
    parts = [whole[i : i + 500] for i in range(0, len(whole), 500)]
    for i in range(len(parts)):
        flags = 3 if i == len(parts) - 1 else 1
        assert bench.hear(ids.FRAGMENT, parts[i], 0x80, i, flags=flags)
    # A DATA of length 0 that is followed by octets is a fault of the peer.
    assert bench.owner.samples() == []
    assert bench.session.dropped == 1
    bench = Bench()
    whole = bytes((ids.DATA, 1, 2004 & 0xFF, 2004 >> 8)) + whole[4:]
    for i in (1, 0, 2, 4, 3):
        flags = 3 if i == 4 else 1
        bench.hear(ids.FRAGMENT, whole[i * 500 : i * 500 + 500], 0x80, i, flags=flags)
    assert bench.owner.samples() == [pattern(2000)]
    assert bench.session.dropped == 0


def test_fragments_over_the_limit_are_dropped_and_the_next_sample_arrives() -> None:
    bench = Bench(limit=1000)
    for i in range(5):
        bench.hear(ids.FRAGMENT, bytes(400), 0x80, i, flags=3 if i == 4 else 1)
    assert bench.session.dropped == 1 and bench.owner.events == []
    whole = bytes((ids.DATA, 1, 8, 0)) + b"\0\x0e\0\x16abcd"
    bench.hear(ids.FRAGMENT, whole[:8], 0x80, 5)
    bench.hear(ids.FRAGMENT, whole[8:], 0x80, 6, flags=3)
    assert bench.owner.samples() == [b"abcd"]


def test_a_lost_fragment_delays_the_stream_until_it_is_resent() -> None:
    bench = Bench()
    whole = bytes((ids.DATA, 1, 8, 0)) + b"\0\x0e\0\x16abcd"
    bench.hear(ids.FRAGMENT, whole[:4], 0x80, 0)
    bench.hear(ids.FRAGMENT, whole[8:], 0x80, 2, flags=3)
    bench.sample(3, b"after")
    bench.heartbeat(2, 3)
    # The lost fragment is resent: the HEARTBEAT does not exclude it.
    assert bench.owner.events == []
    bench.hear(ids.FRAGMENT, whole[4:8], 0x80, 1)
    assert bench.owner.samples() == [b"abcd", b"after"] and bench.session.dropped == 0


# --- receiving --------------------------------------------------------------------------------


def test_samples_are_passed_on_in_order_and_once() -> None:
    bench = Bench()
    for sequence in (2, 0, 0, 3, 2, 1, 1, 4, 0):
        bench.sample(sequence, bytes((sequence,)))
    assert bench.owner.samples() == [bytes((i,)) for i in range(5)]
    assert bench.owner.events[0] == ("data", 0x16, b"\0", True)


def test_received_messages_are_acknowledged_once_a_tick() -> None:
    bench = Bench()
    bench.session.tick(0)
    assert bench.take() == []
    for sequence in (0, 1, 4):
        bench.sample(sequence, b"x")
    assert bench.take() == []
    bench.session.tick(0)
    # 2 and 3 are missing
    assert bench.take() == [bytes.fromhex("81000000 0a010500 0200 0003 80")]
    bench.session.tick(0)
    assert bench.take() == []
    bench.sample(0, b"x")  # repeated messages are acknowledged again
    bench.session.tick(0)
    assert bench.take() == [bytes.fromhex("81000000 0a010500 0200 0003 80")]


def test_heartbeats_are_answered_and_late_ones_ignored() -> None:
    bench = Bench()
    bench.heartbeat(0, 2)
    bench.session.tick(0)
    assert bench.take() == [bytes.fromhex("81000000 0a010500 0000 0007 80")]
    bench.sample(6, b"6")
    bench.sample(4, b"4")
    bench.heartbeat(4, 6)  # of an earlier session: 0 to 3 were acknowledged there
    bench.heartbeat(500, 503)
    assert bench.owner.events == []
    bench.session.tick(0)
    assert bench.take() == [bytes.fromhex("81000000 0a010500 0000 002f 80")]
    for sequence in range(6):
        bench.sample(sequence, b"%d" % sequence)
    assert bench.owner.samples() == [b"0", b"1", b"2", b"3", b"4", b"5", b"6"]
    assert len(bench.owner.events) == 7


def test_repeated_heartbeats_beyond_missing_messages_end_the_session() -> None:
    bench = Bench()
    bench.sample(0, b"0")
    for now in range(0, 2000, 200):
        bench.heartbeat(3, 4, now)
        assert len(bench.owner.events) == 1
    bench.heartbeat(3, 4, 2000)
    assert bench.owner.events[1:] == [("unknown",)]


def test_a_heartbeat_in_either_byte_order() -> None:
    bench = Bench()
    bench.hear(ids.HEARTBEAT, b"\0\0\0\2\x80", flags=0)
    bench.session.tick(0)
    assert bench.take() == [bytes.fromhex("81000000 0a010500 0000 0007 80")]
    for now in range(0, 2001, 200):
        bench.hear(ids.HEARTBEAT, b"\1\2\4\3\x80", now=now, flags=0)
    assert bench.owner.events == [("unknown",)]


def test_best_effort_samples_are_passed_on_in_order_with_gaps() -> None:
    bench = Bench()
    for sequence in (0, 1, 1, 5, 3, 6, 65535):
        bench.sample(sequence, bytes((sequence & 0xFF,)), ids.STREAM_BEST_EFFORT)
    assert bench.owner.samples() == [b"\0", b"\1", b"\5", b"\6"]
    bench.session.tick(0)
    assert bench.take() == []


def test_best_effort_samples_resume_after_a_late_one_of_an_earlier_session() -> None:
    bench = Bench()
    bench.sample(20000, b"late", ids.STREAM_BEST_EFFORT)
    for sequence in range(30):
        bench.sample(sequence, bytes((sequence,)), ids.STREAM_BEST_EFFORT, sequence * 200)
        bench.sample(sequence, b"doubled", ids.STREAM_BEST_EFFORT, sequence * 200)
    # After two seconds, and each once.
    assert bench.owner.samples() == [b"late"] + [bytes((i,)) for i in range(10, 30)]


def test_several_submessages_in_a_message() -> None:
    bench = Bench()
    status = bytes((ids.STATUS, 1, 6, 0)) + built(session.push_status, 10, 0x11, 0) + b"\0\0"
    acknack = bytes((ids.ACKNACK, 1, 5, 0)) + built(session.push_acknack, 0, 0, 0x80)
    whole = message(ids.DATA, b"\0\x0e\0\x16abcd", 0x80, 0) + status + acknack
    assert bench.session.receive(whole, 0)
    assert bench.owner.events == [("data", 0x16, b"abcd", True), ("status", 10, ids.STATUS_OK)]


def test_big_endian_samples_are_marked() -> None:
    bench = Bench()
    bench.hear(ids.DATA, b"\0\x0e\0\x16abcd", 0x80, 0, flags=0)
    assert bench.owner.events == [("data", 0x16, b"abcd", False)]


def test_messages_of_the_agent_call_their_handlers() -> None:
    bench = Bench()
    bench.hear(ids.STATUS_AGENT, built(session.push_status_agent, ids.STATUS_ERR_DENIED))
    info = built(session.push_info, 10, ids.OBJECT_AGENT, 0, 0, [])
    bench.hear(ids.INFO, info)
    bench.hear(ids.INFO, built(session.push_info, 10, ids.OBJECT_AGENT, 0, 1, []))
    bench.hear(ids.STATUS, built(session.push_status, DELETE_CLIENT_REQUEST, ids.OBJECT_CLIENT, 0))
    assert not bench.session.receive(message(ids.INFO, info, session_id=0x80), 0)
    assert bench.owner.events == [
        ("agent", ids.STATUS_ERR_DENIED), ("unknown",), ("status", DELETE_CLIENT_REQUEST, 0),
        ("pong",),
    ]  # fmt: skip
    assert bench.session.dropped == 0


def test_malformed_and_foreign_datagrams_are_counted_and_ignored() -> None:
    bench = Bench()
    bench.sample(0, b"0")
    bench.write(b"abcd")
    bench.take()
    nonsense = (
        b"",
        b"\x81",
        b"\x81\x80\x01\x00",
        b"\x81\0\0\0\x0a\x01\x05",
        b"\x81\0\0\0\x0a\x01\x05\0\x01",  # an ACKNACK cut short
        b"\x81\0\0\0\x0b\x01\x05\0\x01",
        b"\x81\0\0\0\x09\x01\xff\0\x01",  # its length is larger than the message
        message(ids.STATUS, b"\0\x0a"),
        message(ids.STATUS_AGENT, b""),
        message(ids.INFO, b"\0"),
        message(ids.TIMESTAMP_REPLY, bytes(23)),
    )
    for i in range(len(nonsense)):
        bench.session.receive(nonsense[i], 0)
        assert bench.session.dropped == i + 1, nonsense[i]
    for session_id in (0x00, 0x01, 0x7F, 0x80, 0x82, 0xFF):
        assert not bench.session.receive(
            message(ids.DATA, b"\0\x0e\0\x16" + bytes(8), 0x80, 1, session_id), 0
        )
    assert bench.session.dropped == len(nonsense) + 6
    # Other streams and submessages are ignored, but they show that the agent is alive.
    for kind, stream in ((ids.DATA, 0x81), (ids.DATA, 0x02), (99, 0), (ids.CREATE, 0)):
        assert bench.hear(kind, b"\0\x0e\0\x16abcd", stream, 0)
    bench.hear(ids.DATA, b"\0\x0e", 0x80, 1)  # too short to be a sample
    bench.hear(ids.ACKNACK, built(session.push_acknack, 1, 0, 0x81))  # not our stream
    bench.hear(ids.HEARTBEAT, built(session.push_heartbeat, 9, 9, 0x01))
    assert bench.owner.samples() == [b"0"] and bench.session.held() == 1
    bench.sample(2, b"2")
    bench.acknack(1)
    assert bench.owner.samples() == [b"0", b"2"] and bench.session.held() == 0


def test_a_malformed_submessage_does_not_stop_the_reliable_stream() -> None:
    bench = Bench()
    bench.sample(2, b"2")
    bench.sample(1, b"1")
    # The next message has two submessages: the first is valid, the second malformed.
    whole = message(ids.DATA, b"\0\x0e\0\x16abcd", 0x80, 0) + b"\x05\x01\xff\0\0\0"
    assert bench.session.receive(whole, 0)
    assert bench.owner.samples() == [b"abcd", b"1", b"2"]
    assert bench.session.dropped == 1


def test_nested_fragments_are_refused() -> None:
    bench = Bench()
    inner = b"abc"
    for _ in range(200):  # deeper than any stack of a board
        inner = bytes((ids.FRAGMENT, 3, len(inner) & 0xFF, len(inner) >> 8)) + inner
    bench.hear(ids.FRAGMENT, inner, 0x80, 0, flags=3)
    assert bench.session.dropped == 1 and bench.owner.events == []
    bench.sample(1, b"after")
    assert bench.owner.samples() == [b"after"]


def test_heartbeats_that_stay_behind_end_the_session() -> None:
    bench = Bench()
    for sequence in range(20):
        bench.sample(sequence, b"x")
    for now in range(0, 6000, 400):
        bench.heartbeat(3, 4 if now % 800 else 19, now)  # late ones between others
    for now in range(10):
        bench.heartbeat(3, 4, now)  # and many late ones at once
    bench.heartbeat(19, 19, 10)
    assert bench.owner.samples() == [b"x"] * 20 and len(bench.owner.events) == 20
    for now in range(0, 2000, 200):
        bench.heartbeat(0, 2, now)
        assert len(bench.owner.events) == 20
    bench.heartbeat(0, 2, 2000)
    assert bench.owner.events[20:] == [("unknown",)]


# --- one session after the other --------------------------------------------------------------


def test_every_session_has_another_id_and_fresh_streams() -> None:
    bench = Bench()
    session_ids = []
    for _ in range(130):
        session_ids.append(bench.session.id)
        bench.write(pattern(3000))
        bench.sample(0, b"x")
        bench.hear(ids.FRAGMENT, bytes(100), 0x80, 1)
        bench.sample(7, b"x", ids.STREAM_BEST_EFFORT)
        bench.write(b"abcd", False)
        old = message(ids.DATA, b"\0\x0e\0\x16late", 0x80, 0, bench.session.id)
        bench.session.renew()
        bench.take()
        dropped = bench.session.dropped
        assert not bench.session.receive(old, 0) and bench.session.dropped == dropped + 1
        assert bench.session.in_flight() == 0 and bench.session.deadline is None
        bench.session.tick(0)
        assert bench.take() == []
    assert session_ids == list(range(0x81, 0xFF)) + [0x81, 0x82, 0x83, 0x84]
    count = len(bench.owner.events)
    assert bench.request() == 10
    bench.write(b"abcd", False)
    out = bench.take()
    assert [datagram[2] for datagram in out] == [0, 0]
    bench.sample(0, b"fresh")
    bench.sample(0, b"fresh too", ids.STREAM_BEST_EFFORT)
    assert len(bench.owner.events) == count + 2
