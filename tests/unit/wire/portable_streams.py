"""Stream windows, step by step. Also runs on MicroPython."""

from support.portable import refused

from uros.ticks import ticks_add, ticks_diff
from uros.wire import streams
from uros.wire.errors import LimitError
from uros.wire.streams import (
    DOUBT_MS,
    DOUBTS,
    HEARTBEAT_MS,
    MAX_HELD,
    RESEND_HOLD_MS,
    WINDOW,
    BestEffortIn,
    Fragments,
    ReliableIn,
    ReliableOut,
    sequence_after,
    split,
)

# The first number of a stream: also just before the wrap.
STARTS = (0, 1, 65520, 65530, 65535)


def incoming(first):
    """Return a ReliableIn that expects `first`, as after that many messages."""
    stream = ReliableIn()
    stream.next = first
    stream.announced = number(first - 1)
    return stream


def outgoing(first):
    """Return a ReliableOut whose next message is `first`; all before are acknowledged."""
    stream = ReliableOut()
    stream.next = stream.sent = stream.acked = first
    return stream


def number(n):
    return n & 0xFFFF


def content(n):
    return b"m%d" % n


def put(stream, count):
    for _ in range(count):
        stream.put(content(stream.next))


def test_times_wrap() -> None:
    last = (1 << 30) - 1
    assert ticks_add(last, 1) == 0
    assert ticks_add(0, -1) == last
    assert ticks_diff(0, last) == 1
    assert ticks_diff(last, 0) == -1
    assert ticks_diff(5, 5) == 0
    assert ticks_diff((1 << 29) - 1, 0) == (1 << 29) - 1
    assert ticks_diff(0, (1 << 29) - 1) == 1 - (1 << 29)


def test_numbers_wrap() -> None:
    assert sequence_after(1, 0) and not sequence_after(0, 1) and not sequence_after(7, 7)
    assert sequence_after(0, 65535) and not sequence_after(65535, 0)
    assert sequence_after(0x7FFF, 0) and not sequence_after(0x8000, 0)


def test_best_effort_takes_new_messages() -> None:
    stream = BestEffortIn()
    assert stream.accept(0, 0)
    assert not stream.accept(0, 0)
    assert stream.accept(5, 0)
    assert not stream.accept(4, 0)
    assert stream.accept(32000, 0)
    assert stream.accept(64000, 0)
    assert stream.accept(65535, 0)
    assert not stream.accept(65534, 0)
    assert stream.accept(0, 0)
    assert not stream.accept(65535, 0)


def test_best_effort_may_begin_late() -> None:
    assert BestEffortIn().accept(1000, 0)


def accepted(stream, numbers, now, every_ms):
    """Return which of the numbers are new, where one arrives every so many milliseconds."""
    out = []
    for n in numbers:
        if stream.accept(number(n), now):
            out.append(n)
        now = ticks_add(now, every_ms)
    return out


def test_best_effort_goes_on_after_a_jump_of_more_than_half_of_all_numbers() -> None:
    for last in STARTS:
        for jump in (0x8000, 0x8001, 40000, 65000):
            for every_ms, lost in ((300, DOUBTS - 1), (10, DOUBT_MS // 10), (1000, DOUBTS - 1)):
                stream = BestEffortIn()
                stream.last = last
                numbers = range(last + jump, last + jump + 300)
                took = accepted(stream, numbers, (1 << 30) - 5, every_ms)
                assert took == list(numbers)[lost:], (last, jump, every_ms)


def test_late_and_duplicate_messages_do_not_move_a_best_effort_stream() -> None:
    for last in STARTS:
        stream = BestEffortIn()
        stream.last = last
        # Behind the last by less than a window, for hours.
        for n in range(WINDOW):
            assert accepted(stream, [last - n] * 20, 0, 60000) == []
        # Many of an earlier session at once; few of them for long; and with new ones between.
        assert accepted(stream, range(last - 500, last - 100), 5, 1) == []
        assert accepted(stream, [last + 1], 0, 0) == [last + 1]
        assert accepted(stream, range(last - 500, last - 501 + DOUBTS), 5, 10000) == []
        assert accepted(stream, [last + 2], 0, 0) == [last + 2]
        for n in range(100):
            late_numbers = range(last - 500, last - 501 + DOUBTS)
            assert accepted(stream, late_numbers, n * 10000, 1000) == []
            assert stream.accept(number(last + 3 + n), n * 10000)


def test_messages_in_order_are_handed_on_at_once() -> None:
    for first in STARTS:
        stream = incoming(first)
        for n in range(first, first + 40):
            assert stream.acknack() == (number(n), 0)
            assert stream.receive(number(n), b"x")
            assert stream.pop() is None
        assert stream.waiting == {}


def test_a_stream_runs_through_all_numbers() -> None:
    out, into = ReliableOut(), ReliableIn()
    for n in range(66000):
        assert out.next == number(n)
        out.put(b"x")
        assert out.take(0) == [b"x"]
        assert into.receive(number(n), b"x")
        if n % 11 == 10:
            first, missing = into.acknack()
            assert out.acknack(first, missing, 0) == [] and len(out) == 0 and missing == 0
    assert out.deadline is None and into.waiting == {}


def test_messages_out_of_order_wait() -> None:
    for first in STARTS:
        stream = incoming(first)
        for i in (2, 1, 3, 15):
            assert not stream.receive(number(first + i), content(i))
        assert stream.pop() is None
        assert stream.acknack() == (first, 0b0111111111110001)
        assert stream.receive(first, b"now")
        assert [stream.pop() for _ in range(4)] == [content(1), content(2), content(3), None]
        assert stream.acknack() == (number(first + 4), 0b011111111111)
        assert list(stream.waiting) == [number(first + 15)]


def test_waiting_messages_are_copies() -> None:
    stream = ReliableIn()
    buf = bytearray(b"abc")
    stream.receive(1, memoryview(buf))
    buf[0] = 0
    stream.receive(0, b"")
    assert stream.pop() == b"abc"


def test_duplicate_messages_are_dropped() -> None:
    for first in STARTS:
        stream = incoming(first)
        assert not stream.receive(number(first + 1), b"first")
        assert not stream.receive(number(first + 1), b"second")
        assert stream.receive(first, b"")
        assert not stream.receive(first, b"")
        assert stream.pop() == b"first"
        assert not stream.receive(number(first + 1), b"third")
        assert not stream.receive(number(first - 1), b"old")
        assert stream.waiting == {} and stream.acknack() == (number(first + 2), 0)


def test_messages_too_far_ahead_are_dropped() -> None:
    for first in STARTS:
        stream = incoming(first)
        for ahead in (WINDOW, WINDOW + 1, 0x7FFF, 0x8000, 0xFFFF):
            assert not stream.receive(number(first + ahead), b"")
        assert stream.waiting == {} and stream.acknack() == (first, 0)


def test_a_heartbeat_announces_missing_messages() -> None:
    for first in STARTS:
        stream = incoming(first)
        assert not stream.heartbeat(first, number(first + 2), 0)
        assert stream.acknack() == (first, 0b111)
        stream.receive(number(first + 1), b"")
        assert stream.acknack() == (first, 0b101)
        assert not stream.heartbeat(first, number(first + 30), 0)
        assert stream.acknack() == (first, 0b1111111111111101)


def test_a_heartbeat_that_all_is_acknowledged() -> None:
    # The client sends it as (next, next - 1) or with the last message: both are harmless.
    for first in STARTS:
        stream = incoming(first)
        for ends in ((first, first - 1), (first - 1, first - 1), (first - 3, first - 1)):
            assert not stream.heartbeat(number(ends[0]), number(ends[1]), 0)
            assert stream.doubts == 0
            assert stream.acknack() == (first, 0)


def test_heartbeats_that_contradict_change_nothing_until_there_are_many() -> None:
    # Of messages that would have been abandoned, and of fewer than have arrived.
    for ends in ((3, 4), (1, 1), (30000, 30001), (-3, -2), (-30000, -29000), (-1, -2)):
        for first in STARTS:
            stream = incoming(first)
            stream.receive(number(first + 2), b"early")
            false = (number(first + ends[0]), number(first + ends[1]))
            before = stream.acknack()
            now = (1 << 30) - 100
            # Many at once, and few for long.
            for _ in range(100):
                assert not stream.heartbeat(false[0], false[1], now)
            assert not stream.heartbeat(first, number(first + 2), ticks_add(now, 5))
            before = stream.acknack()
            for n in range(DOUBTS - 1):
                assert not stream.heartbeat(false[0], false[1], ticks_add(now, n * DOUBT_MS))
            assert stream.acknack() == before
            # An expected message proves that the stream has not moved.
            assert stream.receive(first, b"")
            for n in range(DOUBTS - 1):
                assert not stream.heartbeat(false[0], false[1], ticks_add(now, n * DOUBT_MS))
            assert not stream.heartbeat(number(first + 1), number(first + 2), now)
            stream = incoming(first)
            accepted = [
                stream.heartbeat(false[0], false[1], ticks_add(now, n * HEARTBEAT_MS))
                for n in range(11)
            ]
            assert accepted == [False] * 10 + [True], (first, ends, accepted)


def test_a_stream_that_the_peer_has_reset() -> None:
    for first in STARTS:
        stream = incoming(first)
        stream.receive(number(first + 1), b"given up")
        stream.receive(number(first + 4), b"comes again")
        stream.restart(number(first + 3), number(first + 4))
        assert stream.waiting == {}
        assert stream.acknack() == (number(first + 3), 0b11)
        assert stream.receive(number(first + 3), b"")
        assert stream.acknack() == (number(first + 4), 1)


def test_a_heartbeat_that_cannot_be_true_is_ignored() -> None:
    for first in STARTS:
        stream = incoming(first)
        for ends in (
            (first + 9, first + 3),  # the last number is before the first
            (first + 0x7FFF, first + 0x7FFF),  # before or after?
            (first + 0x8000, first + 0x8000),
            (first, first + 0x8000),
        ):
            assert not stream.heartbeat(number(ends[0]), number(ends[1]), 0)
            assert stream.acknack() == (first, 0)
        assert stream.receive(first, b"")


def test_a_full_window_goes_out_and_the_rest_waits() -> None:
    for first in STARTS:
        stream = outgoing(first)
        assert stream.available() == WINDOW
        put(stream, 20)
        assert stream.available() == 0
        assert len(stream) == 20
        assert stream.take(0) == [content(number(first + i)) for i in range(16)]
        assert stream.take(0) == []
        # four acknowledged: four go out
        assert stream.acknack(number(first + 4), 0, 1) == [
            content(number(first + i)) for i in range(16, 20)
        ]
        assert len(stream) == 16
        assert stream.acknack(number(first + 20), 0, 2) == []
        assert len(stream) == 0 and stream.available() == WINDOW


def test_heartbeats_while_something_is_not_acknowledged() -> None:
    last = (1 << 30) - 1
    for start in (0, 1000, last - 300, last - HEARTBEAT_MS, last):
        for first in STARTS:
            stream = outgoing(first)
            assert stream.heartbeat(start) is None
            put(stream, 2)
            stream.take(start)
            assert stream.deadline == ticks_add(start, HEARTBEAT_MS)
            assert stream.heartbeat(ticks_add(start, HEARTBEAT_MS - 1)) is None
            due = (first, number(first + 1))
            assert stream.heartbeat(ticks_add(start, HEARTBEAT_MS)) == due
            assert stream.heartbeat(ticks_add(start, HEARTBEAT_MS)) is None
            assert stream.heartbeat(ticks_add(start, 2 * HEARTBEAT_MS)) == due
            now = ticks_add(start, 450)
            assert stream.acknack(number(first + 1), 0, now) == []
            assert stream.deadline == ticks_add(now, HEARTBEAT_MS)
            assert stream.acknack(number(first + 2), 0, now) == []
            assert stream.deadline is None
            assert stream.heartbeat(ticks_add(now, 10000)) is None


def test_missing_messages_are_sent_again() -> None:
    for first in STARTS:
        stream = outgoing(first)
        put(stream, 4)
        stream.take(0)
        again = [content(number(first + 1)), content(number(first + 3))]
        assert stream.acknack(number(first + 1), 0b101, 50) == again
        assert len(stream) == 3


def test_a_message_is_not_resent_too_soon() -> None:
    last = (1 << 30) - 1
    for start in (0, last - 3):
        stream = outgoing(65535)
        put(stream, 2)
        stream.take(start)
        early = ticks_add(start, RESEND_HOLD_MS - 1)
        assert stream.acknack(65535, 0b11, early) == []
        assert stream.deadline == ticks_add(early, RESEND_HOLD_MS)
        now = ticks_add(start, RESEND_HOLD_MS)
        assert stream.acknack(65535, 0b11, now) == [content(65535), content(0)]
        assert stream.acknack(65535, 0b11, now) == []
        assert stream.acknack(0, 0b1, ticks_add(now, RESEND_HOLD_MS)) == [content(0)]


def test_lost_messages_are_sent_before_new_ones() -> None:
    stream = outgoing(65530)
    put(stream, 20)
    stream.take(0)
    out = stream.acknack(65532, 0b1, 100)
    assert out == [content(65532), content(number(65530 + 16)), content(number(65530 + 17))]


def test_acknacks_without_news_do_not_put_the_heartbeat_off() -> None:
    stream = outgoing(0)
    put(stream, 1)
    stream.take(0)
    for now in range(1, HEARTBEAT_MS, 20):
        assert stream.acknack(0, 0, now) == []
    assert stream.heartbeat(HEARTBEAT_MS) == (0, 0)
    # The session may pause the heartbeats of a stream; an ACKNACK resumes them.
    stream.deadline = None
    stream.acknack(0, 0, 500)
    assert stream.heartbeat(500 + HEARTBEAT_MS) == (0, 0)


def test_acknacks_for_numbers_never_sent_are_ignored() -> None:
    for first in STARTS:
        stream = outgoing(first)
        put(stream, 20)
        stream.take(0)
        for wrong in (first + 17, first + 20, first + 0x7FFF, first + 0x8000, first - 1):
            assert stream.acknack(number(wrong), 0xFFFF, 100) == []
            assert (stream.acked, len(stream)) == (first, 20)
        # Those within what was sent are resent, no more.
        assert len(stream.acknack(number(first + 15), 0xFFFF, 100)) == 1 + 4
        assert len(outgoing(first).acknack(first, 0xFFFF, 100)) == 0


def test_the_number_of_messages_held_is_limited() -> None:
    stream = ReliableOut(limit=3)
    put(stream, 3)
    refused(LimitError, stream.put, b"")
    assert len(stream) == 3 and stream.next == 3
    stream.take(0)
    stream.acknack(1, 0, 0)
    put(stream, 1)


def test_messages_never_exceed_half_of_the_sequence_numbers() -> None:
    stream = ReliableOut()
    message = b""
    for _ in range(MAX_HELD):
        stream.put(message)
    refused(LimitError, stream.put, message)


def test_export_and_restore_of_a_reliable_output_stream() -> None:
    for first in STARTS:
        stream = outgoing(first)
        put(stream, WINDOW + 3)
        stream.take(1000)
        stream.acknack(number(first + 2), 0, 1000)
        acked, sent, after, messages = stream.export()
        assert (acked, sent, after) == (
            number(first + 2),
            number(first + WINDOW + 2),
            number(first + WINDOW + 3),
        )
        assert messages == {number(first + i): content(number(first + i)) for i in range(2, 19)}
        last = number(after - 1)
        assert stream.export(last)[3] == {last: content(last)}
        assert stream.export(after)[3] == {}
        assert sorted(stream.export(first)[3]) == sorted(
            messages
        )  # acknowledged messages are not exported
        restored = ReliableOut()
        restored.restore(acked, sent, after, messages, 5000)
        assert restored.export() == stream.export()
        assert restored.size == stream.size and len(restored) == len(stream)
        # A heartbeat at once; missing messages are sent again, then the waiting ones.
        assert restored.heartbeat(5000) == (acked, number(sent - 1))
        assert restored.acknack(number(acked + 1), 1, 5000) == [
            content(number(acked + 1)),
            content(number(after - 1)),
        ]
        put(restored, 1)
        assert restored.export(after)[3] == {after: content(after)}
        assert after not in stream.export()[3], "the messages are shared, the stream is not"


def test_export_and_restore_of_a_stream_without_messages() -> None:
    stream = ReliableOut()
    stream.restore(7, 7, 7, {}, 0)
    assert stream.deadline is None and stream.export() == (7, 7, 7, {})
    put(stream, 1)
    assert stream.take(0) == [content(7)]


def test_export_and_restore_of_fragments() -> None:
    fragments = Fragments()
    assert not fragments.export()[0] and not fragments.export()[1]
    fragments.add(b"abc", False)
    whole, skip = fragments.export()
    assert whole == b"abc" and not skip
    restored = Fragments()
    restored.restore(bytearray(whole), skip)
    assert restored.pending == 3
    fragments.add(b"def", False)
    assert fragments.export()[0] is whole and whole == b"abcdef", "one buffer grows"
    assert restored.add(b"d", True) == b"abcd"
    fragments.interrupt()
    restored.restore(*fragments.export())
    assert restored.add(b"rest", True) is None
    assert restored.add(b"sound", True) == b"sound"


def test_fragments_make_a_whole() -> None:
    fragments = Fragments()
    assert fragments.add(memoryview(b"abc"), False) is None
    assert fragments.pending == 3
    assert fragments.add(b"", False) is None
    assert fragments.add(bytearray(b"def"), False) is None
    whole = fragments.add(b"g", True)
    assert whole == b"abcdefg" and isinstance(whole, bytearray)
    assert fragments.pending == 0
    assert fragments.add(b"alone", True) == b"alone"
    whole[0] = 0
    assert fragments.add(b"again", True) == b"again"


def test_fragments_are_copies() -> None:
    fragments = Fragments()
    buf = bytearray(b"abc")
    fragments.add(memoryview(buf), False)
    buf[0] = 0
    assert fragments.add(b"", True) == b"abc"


def test_fragments_without_end() -> None:
    assert Fragments().limit == streams.MAX_MESSAGE
    fragments = Fragments(1000)
    for last in (False, True):
        fragments.add(bytes(600), False)
        fragments.add(bytes(400), False)
        refused(LimitError, fragments.add, b"!", last)
        assert fragments.pending == 0
        # The remaining fragments of that submessage are no submessage of their own.
        if not last:
            assert fragments.add(bytes(999), False) is None
            assert fragments.add(b"tail", True) is None
            assert fragments.pending == 0
        assert fragments.add(b"sound", True) == b"sound"


def test_fragments_with_messages_lost_between() -> None:
    fragments = Fragments()
    fragments.add(b"abc", False)
    fragments.interrupt()
    fragments.interrupt()
    assert fragments.add(b"def", False) is None
    assert fragments.add(b"g", True) is None
    assert fragments.add(b"sound", True) == b"sound"
    fragments.interrupt()
    assert fragments.add(b"sound", True) == b"sound"


def test_fragments_of_a_reset_stream() -> None:
    fragments = Fragments()
    fragments.add(b"abc", False)
    fragments.drop()
    assert fragments.add(b"new", True) == b"new"
    fragments.add(b"abc", False)
    fragments.interrupt()
    fragments.drop()
    assert fragments.add(b"new", True) == b"new"


def test_splitting() -> None:
    assert split(10, 100) == [(0, 10, 3)]
    assert split(100, 100) == [(0, 100, 3)]
    assert split(101, 100) == [(0, 100, 1), (100, 101, 3)]
    assert split(20, 11) == [(0, 8, 1), (8, 16, 1), (16, 20, 3)]
    assert split(0, 4) == [(0, 0, 3)]
    for room in (3, 0, -4):
        refused(LimitError, split, 10, room)


def test_a_split_submessage_is_reassembled() -> None:
    whole = bytes([i & 0xFF for i in range(1000)])
    for room in (4, 7, 96, 996, 1000, 1004):
        fragments = Fragments()
        results = [
            fragments.add(memoryview(whole)[start:stop], bool(flags & 2))
            for start, stop, flags in split(len(whole), room)
        ]
        assert results[-1] == whole
        assert all([result is None for result in results[:-1]])
