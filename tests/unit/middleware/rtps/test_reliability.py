"""Writer and reader together, over a link that loses, doubles and reorders.

Both are ours: what both could get wrong together is tested against real peers in tests/interop.
"""

import random

import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from support.rtps_network import is_acknowledged

from uros.middleware.rtps import ids, submessages
from uros.middleware.rtps.kinds import (
    AckNack,
    Data,
    DataFrag,
    Gap,
    Heartbeat,
    HeartbeatFrag,
    NackFrag,
)
from uros.middleware.rtps.reader import StatefulReader, is_newer
from uros.middleware.rtps.reassembly import MAX_SAMPLE, OctetBudget
from uros.middleware.rtps.writer import StatefulWriter

WRITER = b"\x01\x75" + bytes(10) + b"\0\0\1\3"
OTHER_WRITER = b"\x01\x75" + bytes(10) + b"\0\0\2\3"
FRAGMENT = 100


def guid(number):
    return b"\x01\x75" + bytes(9) + bytes([number]) + b"\0\0\1\4"


class End:
    """A reader and what it delivered."""

    def __init__(self, number=1, reliable=True, from_first=False, limit=10**9, room=None):
        self.guid = guid(number)
        self.samples = []
        self.room = room
        self.budget = OctetBudget(limit)
        self.reader = StatefulReader(self.guid, reliable, from_first, self.deliver, self.budget)

    def deliver(self, sample):
        if self.room is not None and len(self.samples) >= self.room:
            return False
        self.samples.append(sample)
        return True

    @property
    def numbers(self):
        return [sample.number for sample in self.samples]


class Link:
    """A writer and its readers; ``rates`` are those of loss, doubling and reordering."""

    def __init__(self, seed=0, rates=(0.0, 0.0, 0.0), **options):
        self.random = random.Random(seed)
        self.rates = rates
        self.now = 100.0
        options = {"reliable": True, "transient_local": False, "depth": None} | options
        self.writer = StatefulWriter(WRITER, fragment_size=FRAGMENT, **options)
        self.ends = {}
        self.flying = []  # (receiver, submessages); the writer's receiver is None
        self.sent = []  # of the writer, in octets

    def join(self, end, reliable=None):
        self.ends[end.guid] = end
        reliable = end.reader.reliable if reliable is None else reliable
        end.reader.match(WRITER, self.writer.reliable, self.now)
        self.send(self.writer.match(end.guid, reliable, end.reader._from_first, self.now))

    def write(self, payload, **options):
        self.send(self.writer.write(payload, 0, self.now, **options))

    def send(self, packets):
        for packet in packets:
            self.sent.append(len(packet.submessages))
            for end in self.ends.values():
                if packet.reader in (None, end.guid):
                    self.fly(end, packet.submessages)

    def fly(self, receiver, octets):
        loss, doubling, reordering = self.rates
        if self.random.random() < loss:
            return
        for _ in range(1 + (self.random.random() < doubling)):
            at = len(self.flying)
            if self.random.random() < reordering:
                at = self.random.randint(0, at)
            self.flying.insert(at, (receiver, octets))

    def land(self):
        """Deliver what is in flight, and what is sent meanwhile."""
        while self.flying:
            receiver, octets = self.flying.pop(0)
            message = memoryview(submessages.header(bytes(12)) + octets)
            for submessage in submessages.read(message):
                self.handle(receiver, submessage)

    def handle(self, end, submessage):
        if isinstance(submessage, AckNack):
            self.writer.on_acknack(self.from_entity(submessage), submessage, self.now)
        elif isinstance(submessage, NackFrag):
            self.writer.on_nack_frag(self.from_entity(submessage), submessage, self.now)
        elif submessage.reader in (ids.ENTITY_UNKNOWN, end.guid[12:]):
            reader = end.reader
            if isinstance(submessage, Data):
                reader.on_data(
                    WRITER, submessage.number, submessage.payload, submessage.inline_qos,
                    submessage.little, submessage.is_key, self.now,
                )  # fmt: skip
            elif isinstance(submessage, DataFrag):
                reader.on_fragments(WRITER, submessage, self.now)
            elif isinstance(submessage, Heartbeat):
                reader.on_heartbeat(WRITER, submessage, self.now)
            elif isinstance(submessage, HeartbeatFrag):
                reader.on_heartbeat_frag(WRITER, submessage, self.now)
            elif isinstance(submessage, Gap):
                reader.on_gap(WRITER, submessage)

    def from_entity(self, submessage):
        """All ends have the same entity id: the sender is known by who sends now."""
        return self.speaker

    def step(self, seconds=0.05):
        self.land()
        for end in list(self.ends.values()):
            for _, octets in end.reader.poll(self.now):
                loss, doubling, _ = self.rates
                for _ in range(1 + (self.random.random() < doubling)):
                    if self.random.random() < loss:
                        continue
                    self.speaker = end.guid
                    message = memoryview(submessages.header(bytes(12)) + octets)
                    for submessage in submessages.read(message):
                        self.handle(end, submessage)
        self.send(self.writer.poll(self.now))
        self.land()
        self.now += seconds

    def settle(self, done=None, steps=2000):
        done = done or (lambda: is_acknowledged(self.writer))
        for _ in range(steps):
            self.step()
            if done():
                return
        raise AssertionError(f"not settled: {[end.numbers[-3:] for end in self.ends.values()]}")


def payload(number, size=20):
    return b"\0\1\0\0" + bytes((number * 7 + i) & 0xFF for i in range(size))


# --- reliable ------------------------------------------------------------------------------------


@given(
    st.integers(0, 10**6),
    st.tuples(*[st.sampled_from([0.0, 0.1, 0.3])] * 3),
    st.lists(st.sampled_from([0, 20, 96, 97, 250, 1000]), min_size=1, max_size=40),
    st.integers(1, 3),
)
def test_every_reliable_reader_gets_every_sample_once_and_in_order(seed, rates, sizes, count):
    link = Link(seed, rates)
    ends = [End(number) for number in range(1, count + 1)]
    for end in ends:
        link.join(end)
    for number, size in enumerate(sizes):
        link.write(payload(number, size))
        if link.random.random() < 0.3:
            link.step()
    link.settle()
    for end in ends:
        assert end.numbers == list(range(1, len(sizes) + 1))
        for number, (sample, size) in enumerate(zip(end.samples, sizes, strict=True)):
            whole = payload(number, size)
            assert sample.payload[: len(whole)] == whole
            assert len(sample.payload) - len(whole) < 4
        assert end.budget.used == 0
    assert not link.writer._history


def test_without_loss_nothing_is_sent_twice():
    link = Link()
    end = End()
    link.join(end)
    link.settle()
    link.sent.clear()
    for number in range(50):
        link.write(payload(number))
        link.step(0.0)
    link.settle()
    data = [size for size in link.sent if size == 24 + len(payload(0))]
    assert len(data) == 50 and end.numbers == list(range(1, 51))


def test_a_late_volatile_reader_begins_with_what_comes_first():
    link = Link()
    first, late = End(1), End(2)
    link.join(first)
    for number in range(5):
        link.write(payload(number))
    link.join(late)
    link.settle()
    assert first.numbers == [1, 2, 3, 4, 5] and late.numbers == []
    link.write(payload(5))
    link.settle()
    assert late.numbers == [6]


@pytest.mark.parametrize("loss", [0.0, 0.3])
def test_a_late_transient_local_reader_gets_the_depth_and_what_follows(loss):
    link = Link(1, (loss, 0.0, 0.0), transient_local=True, depth=3)
    for number in range(10):
        link.write(payload(number))
    end = End(from_first=True)
    link.join(end)
    link.settle()
    link.write(payload(10))
    link.settle()
    assert end.numbers == [8, 9, 10, 11]


def test_a_transient_local_best_effort_reader_gets_the_depth_at_once():
    link = Link(transient_local=True, depth=3)
    for number in range(10):
        link.write(payload(number, 300))
    end = End(reliable=False, from_first=True)
    link.join(end)
    link.land()
    assert end.numbers == [8, 9, 10]


def test_keep_last_passes_over_what_is_no_longer_kept():
    link = Link(2, depth=5)
    end = End()
    link.join(end)
    link.settle()
    link.rates = (1.0, 0.0, 0.0)
    for number in range(20):
        link.write(payload(number))
    link.rates = (0.0, 0.0, 0.0)
    link.settle()
    assert end.numbers == [16, 17, 18, 19, 20]
    (proxy,) = end.reader.writers.values()
    assert proxy.lost == 15 == end.reader.lost()
    end.reader.unmatch(*end.reader.writers)
    assert end.reader.lost() == 15


def test_keep_all_has_no_room_until_readers_acknowledge():
    link = Link(limit=10)
    end = End()
    link.join(end)
    link.settle()
    link.rates = (1.0, 0.0, 0.0)
    count = 0
    while link.writer.has_room():
        link.write(payload(count))
        count += 1
    assert count == 10
    link.rates = (0.0, 0.0, 0.0)
    link.settle()
    assert link.writer.has_room() and len(end.samples) == 10
    link.writer.unmatch(end.guid)
    assert link.writer.has_room()


def test_a_reader_that_leaves_frees_what_only_it_lacked():
    link = Link(limit=3)
    end = End()
    link.join(end)
    link.rates = (1.0, 0.0, 0.0)
    for number in range(3):
        link.write(payload(number))
    assert not link.writer.has_room()
    link.writer.unmatch(end.guid)
    assert link.writer.has_room() and not link.writer._history


def test_a_reader_without_room_gets_the_sample_later():
    link = Link()
    end = End(room=3)
    link.join(end)
    for number in range(6):
        link.write(payload(number))
    for _ in range(10):
        link.step()
    assert end.numbers == [1, 2, 3] and not is_acknowledged(link.writer)
    end.room = None
    end.reader.resume(link.now)
    link.settle()
    assert end.numbers == [1, 2, 3, 4, 5, 6]


@pytest.mark.parametrize("loss", [0.0, 0.3])
def test_a_directed_sample_is_for_its_reader_alone(loss):
    link = Link(3, (loss, 0.0, 0.0))
    ends = [End(1), End(2)]
    for end in ends:
        link.join(end)
    link.settle()
    for number in range(10):
        link.write(payload(number), readers=frozenset([ends[number % 2].guid]))
    link.settle()
    assert ends[0].numbers == [1, 3, 5, 7, 9] and ends[1].numbers == [2, 4, 6, 8, 10]


def test_inline_qos_arrives_with_samples_of_any_size():
    from uros.middleware.rtps.parameters import write_related_identity

    link = Link(4, (0.2, 0.0, 0.2))
    end = End()
    link.join(end)
    for size in (10, 1000):
        link.write(payload(0, size), inline_qos=write_related_identity(OTHER_WRITER, 77))
    link.settle()
    assert [sample.inline_qos.related for sample in end.samples] == [(OTHER_WRITER, 77)] * 2


def test_sequence_numbers_go_beyond_32_bits():
    link = Link(5, (0.3, 0.1, 0.3))
    link.writer.last = 2**32 - 5
    end = End()
    link.join(end)
    for number in range(10):
        link.write(payload(number))
    link.settle()
    assert end.numbers == list(range(2**32 - 4, 2**32 + 6))


def test_samples_follow_the_answer_to_a_heartbeat_and_not_a_readers_question():
    """Cyclone takes the first heartbeat that comes for the end of what a volatile reader missed."""
    link, end = Link(), End()
    link.writer.match(end.guid, True, False, link.now)  # the reader does not know the writer yet
    link.write(payload(1))
    link.writer.on_acknack(end.guid, AckNack(b"", b"", 1, (), 1, False), link.now)
    packets = list(link.writer.poll(link.now))
    (question,) = [
        submessage
        for packet in packets
        for submessage in submessages.read(
            memoryview(submessages.header(bytes(12)) + packet.submessages)
        )
    ]
    assert isinstance(question, Heartbeat) and (question.first, question.last) == (1, 0)
    link.writer.on_acknack(end.guid, AckNack(b"", b"", 1, (), 2, True), link.now)
    assert any(packet.time_ns is not None for packet in link.writer.poll(link.now))  # has DATA


@pytest.mark.parametrize("wants_history", [True, False])
def test_the_first_heartbeat_of_a_reader_tells_what_was_written_before_the_match(wants_history):
    """A participant on Cyclone takes it for all its readers, some volatile and others not."""
    writer = Link(transient_local=True, depth=10).writer
    for number in range(1, 6):
        writer.write(payload(number), 0, 100.0)
    first = writer.match(guid(1), True, wants_history, 100.0)
    writer.write(payload(6), 0, 100.0)  # before the reader has acknowledged
    for packet in (*first, *writer.poll(100.0)):
        (told,) = submessages.read(memoryview(submessages.header(bytes(12)) + packet.submessages))
        assert isinstance(told, Heartbeat) and (told.first, told.last) == (1, 5)


def test_heartbeats_of_a_reader_that_does_not_answer_become_seldom():
    link = Link()
    end = End()
    link.join(end)
    link.settle()
    link.write(payload(0))
    link.flying.clear()
    link.rates = (1.0, 0.0, 0.0)
    link.sent.clear()
    for _ in range(1000):
        link.step(0.02)
    assert 5 <= len(link.sent) <= 20  # in 20 s
    link.rates = (0.0, 0.0, 0.0)
    link.settle()
    assert end.numbers == [1]


# --- best effort ----------------------------------------------------------------------------------


@given(st.integers(0, 10**6), st.lists(st.sampled_from([20, 250, 1000]), max_size=30))
@example(336, [20, 20, 20, 1000, 1000, 1000, 1000, 250, 250, 250, 1000, 1000, 250])
def test_best_effort_delivers_whole_samples_that_are_newer_each_time(seed, sizes):
    link = Link(seed, (0.1, 0.1, 0.1), reliable=False)
    end = End(reliable=False)
    link.join(end)
    for number, size in enumerate(sizes):
        link.write(payload(number, size))
        link.land()
    assert end.numbers == sorted(set(end.numbers))
    for sample in end.samples:
        whole = payload(sample.number - 1, sizes[sample.number - 1])
        assert sample.payload[: len(whole)] == whole
    (proxy,) = end.reader.writers.values()
    if end.samples:
        assert proxy.lost == end.numbers[-1] - end.numbers[0] + 1 - len(end.samples)
    end.reader.close()
    assert end.budget.used == 0


def test_a_best_effort_writer_keeps_nothing():
    link = Link(reliable=False)
    link.join(End(reliable=False))
    link.write(payload(0))
    assert not link.writer._history and link.writer.next_deadline() is None


# --- limits ---------------------------------------------------------------------------------------


def data(number, size=10):
    message = memoryview(
        submessages.header(bytes(12))
        + submessages.encode_data(bytes(4), WRITER[12:], number, bytes(size))
    )
    (submessage,) = submessages.read(message)
    return submessage


def receive(end, number, size=10):
    found = data(number, size)
    end.reader.on_data(WRITER, number, found.payload, None, True, False, 0.0)


def heartbeat(first, last, counter):
    return Heartbeat(bytes(4), WRITER[12:], first, last, counter, False, False)


def test_samples_far_ahead_and_beyond_the_budget_are_not_held():
    end = End(limit=10_000)
    end.reader.match(WRITER, True, 0.0)
    end.reader.on_heartbeat(WRITER, heartbeat(1, 2**40, 1), 0.0)
    receive(end, 2**39)
    (proxy,) = end.reader.writers.values()
    assert not proxy.held
    for number in range(2, 4000):
        receive(end, number, 1000)
    assert 0 < end.budget.used <= 10_000 and not end.samples
    end.reader.close()
    assert end.budget.used == 0


def test_a_heartbeat_of_any_range_costs_one_acknowledgement_of_256():
    end = End()
    end.reader.match(WRITER, True, 0.0)
    end.reader.on_heartbeat(WRITER, heartbeat(5, 2**62, 1), 0.0)
    ((writer, octets),) = end.reader.poll(0.0)
    (acknack,) = submessages.read(memoryview(submessages.header(bytes(12)) + octets))
    assert writer == WRITER and acknack.missing == tuple(range(5, 261))


def test_a_gap_of_any_range_costs_little():
    end = End(limit=10**6)
    end.reader.match(WRITER, True, 0.0)
    end.reader.on_heartbeat(WRITER, heartbeat(5, 10, 1), 0.0)
    end.reader.on_gap(WRITER, Gap(bytes(4), WRITER[12:], 7, 2**60, ()))
    (proxy,) = end.reader.writers.values()
    assert proxy.expected == 5 and end.budget.used <= 10**6
    end.reader.on_gap(WRITER, Gap(bytes(4), WRITER[12:], 1, 2**60, ()))
    assert proxy.expected == 2**60 and end.budget.used == 0


def test_an_acknowledgement_of_what_was_never_written_counts_as_all():
    link = Link()
    end = End()
    link.join(end)
    link.write(payload(0))
    acknack = AckNack(end.guid[12:], WRITER[12:], 2**50, (2**50 + 5,), 9, True)
    link.writer.on_acknack(end.guid, acknack, 0.0)
    (proxy,) = link.writer.readers.values()
    assert proxy.acked == 1 and not proxy.requested


def test_requests_for_all_of_a_large_sample_are_answered_at_a_pace():
    link = Link(depth=1)
    end = End()
    link.join(end)
    link.write(payload(0, 1_000_000))
    for counter in range(1, 100):
        acknack = AckNack(end.guid[12:], WRITER[12:], 1, (1,), counter, True)
        link.writer.on_acknack(end.guid, acknack, link.now)
    octets = sum(len(packet.submessages) for packet in link.writer.poll(link.now))
    assert octets < 40_000 and not list(link.writer.poll(link.now))
    assert link.writer.next_deadline() > link.now


def fragment(number, first, size, total):
    octets = bytes(min(size, max(0, total - size * (first - 1))))
    return DataFrag(bytes(4), WRITER[12:], number, first, 1, size, total, None,
                    memoryview(octets), False, True)  # fmt: skip


def test_a_sample_that_is_announced_too_large_is_passed_over():
    end = End()
    end.reader.match(WRITER, True, 0.0)
    end.reader.on_heartbeat(WRITER, heartbeat(1, 2, 1), 0.0)
    end.reader.on_fragments(WRITER, fragment(1, 1, 1000, MAX_SAMPLE + 1), 0.0)
    receive(end, 2)
    assert end.numbers == [2] and end.budget.used == 0


def test_many_samples_that_are_never_complete_hold_a_bounded_part():
    for reliable in (True, False):
        end = End(reliable=reliable, limit=100_000)
        end.reader.match(WRITER, True, 0.0)
        if reliable:
            end.reader.on_heartbeat(WRITER, heartbeat(1, 1000, 1), 0.0)
        for number in range(1, 1000):
            for first in range(1, 10):
                end.reader.on_fragments(WRITER, fragment(number, first, 1000, 50_000), 0.0)
        (proxy,) = end.reader.writers.values()
        assert len(proxy.incomplete) <= 8 and end.budget.used <= 100_000
        end.reader.unmatch(WRITER)
        assert end.budget.used == 0


def test_fragments_of_an_octet_are_refused():
    end = End(reliable=False)
    end.reader.match(WRITER, False, 0.0)
    for first in range(1, 200):
        end.reader.on_fragments(WRITER, fragment(1, first, 1, 50_000), 0.0)
    (proxy,) = end.reader.writers.values()
    assert not proxy.incomplete


def test_counters_must_rise_and_may_wrap():
    assert is_newer(1, None) and is_newer(2, 1) and is_newer(0, 0xFFFF_FFFF)
    assert not is_newer(1, 1) and not is_newer(0xFFFF_FFFF, 0) and not is_newer(1, 2)


def test_repeated_acknowledgements_and_heartbeats_change_nothing():
    link = Link()
    end = End()
    link.join(end)
    link.settle()
    link.write(payload(0))
    acknack = AckNack(end.guid[12:], WRITER[12:], 1, (1,), 50, True)
    link.writer.on_acknack(end.guid, acknack, link.now)
    assert list(link.writer.poll(link.now))
    link.writer.on_acknack(end.guid, acknack, link.now)
    (proxy,) = link.writer.readers.values()
    assert proxy.resend_at is None
    end.reader.on_heartbeat(WRITER, heartbeat(1, 1, 1000), link.now)
    assert list(end.reader.poll(link.now))
    end.reader.on_heartbeat(WRITER, heartbeat(1, 1, 1000), link.now)
    assert not list(end.reader.poll(link.now))


def test_of_writers_and_readers_that_are_not_matched_nothing_is_taken():
    link, end = Link(), End()
    receive(end, 1)
    end.reader.on_fragments(WRITER, fragment(1, 1, 100, 200), 0.0)
    end.reader.on_heartbeat(WRITER, heartbeat(1, 1, 1), 0.0)
    end.reader.on_gap(WRITER, Gap(bytes(4), WRITER[12:], 1, 2, ()))
    assert not end.samples and end.reader.next_deadline() is None
    link.writer.on_acknack(guid(9), AckNack(bytes(4), bytes(4), 1, (), 1, True), 0.0)
    link.writer.on_nack_frag(guid(9), NackFrag(bytes(4), bytes(4), 1, (1,), 1), 0.0)
    assert link.writer.next_deadline() is None


def test_without_a_heartbeat_a_reader_asks_six_times_and_begins_with_the_lowest_sample():
    """Fast DDS repeats its own heartbeat after 3 s: that one answers."""
    end = End()
    end.reader.match(WRITER, True, 0.0)
    for number in (6, 5):
        receive(end, number)
    asked = []
    while not end.samples:
        now = end.reader.next_deadline()
        assert now is not None and len(asked) < 7
        asked += [now for _ in end.reader.poll(now)]
    assert end.numbers == [5, 6] and len(asked) == 7 and 3.0 < asked[-1] < 10.0


def test_a_reader_asks_more_and_more_seldom_until_a_heartbeat_answers():
    """All questions so far may have been lost, or were too early for a writer that began anew."""
    end = End()
    end.reader.match(WRITER, True, 0.0)
    asked = []
    while len(asked) < 30:
        now = end.reader.next_deadline()
        asked += [now for _ in end.reader.poll(now)]
    pauses = [round(b - a, 3) for a, b in zip(asked, asked[1:], strict=False)]
    assert pauses == sorted(pauses) and 5.0 < pauses[-1] < 10.0
    end.reader.receive(WRITER, Heartbeat(bytes(4), bytes(4), 1, 0, 1, True, False), now)
    assert not list(end.reader.poll(now + 100)) and end.reader.next_deadline() is None


@given(
    payload=st.binary(min_size=4, max_size=2 * FRAGMENT), time_ns=st.integers(0, 2**62),
    number=st.integers(0, 2**40), transient_local=st.booleans(), reliable=st.booleans(),
)  # fmt: skip
def test_what_nobody_keeps_is_written_as_by_the_plain_form(
    payload, time_ns, number, transient_local, reliable
):
    once, plain = (StatefulWriter(WRITER, True, transient_local, 10, FRAGMENT) for _ in range(2))
    for writer in (once, plain):
        writer.last = number
        writer.match(guid(1), reliable, False, 0.0)
    octets = once.write_once(payload, time_ns)
    if transient_local or reliable or len(payload) > FRAGMENT:
        assert octets is None and once.last == number
        return
    (packet,) = plain.write(payload, time_ns, 0.0)
    assert packet.reader is None
    assert octets == submessages.encode_info_ts(packet.time_ns) + packet.submessages
    assert once.last == plain.last == number + 1


def test_what_nobody_reads_is_counted_and_not_encoded():
    writer = StatefulWriter(WRITER, False, False, 10, FRAGMENT)
    assert writer.write_once(b"\0\1\0\0", 1) == b"" and writer.last == 1
