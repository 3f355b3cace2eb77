"""Both ends of a reliable stream over a lossy wire, on simulated time; and a hostile peer."""

import heapq
import random
from collections.abc import Callable

from hypothesis import given, settings
from hypothesis import strategies as st
from support.examples import examples

from uros.ticks import TIME_MASK
from uros.wire.streams import (
    HEARTBEAT_MS,
    MAX_HELD,
    Fragments,
    ReliableIn,
    ReliableOut,
    split,
)

NUMBERS = st.one_of(st.sampled_from([0, 1, 65500, 65530, 65535]), st.integers(0, 65535))
TIMES = st.one_of(st.sampled_from([0, TIME_MASK, TIME_MASK - 300]), st.integers(0, TIME_MASK))


def check_in(stream: ReliableIn) -> None:
    """Check the invariants of a receiving end, whatever the peer sends."""
    assert all(0 <= (n - stream.next) & 0xFFFF < stream.depth for n in stream.waiting)
    assert 0 <= (stream.announced + 1 - stream.next) & 0xFFFF <= MAX_HELD
    first, missing = stream.acknack()
    assert first == stream.next and 0 <= missing <= 0xFFFF


def check_out(stream: ReliableOut) -> None:
    """Check the invariants of a sending end, whatever the peer sends."""
    held_count = (stream.next - stream.acked) & 0xFFFF
    in_flight = (stream.sent - stream.acked) & 0xFFFF
    assert len(stream) == held_count <= stream.limit
    assert in_flight <= min(held_count, stream.window)
    assert {(stream.acked + i) & 0xFFFF for i in range(held_count)} == set(stream._held)
    assert {(stream.acked + i) & 0xFFFF for i in range(in_flight)} == set(stream._sent_at)
    assert (stream.deadline is None) == (in_flight == 0)
    assert stream.available() == max(0, stream.window - held_count)


class Wire:
    """Carries messages and acknacks with a delay; loses, doubles and reorders some."""

    def __init__(self, seed: int, lost: float, doubled: float, delay_ms: int) -> None:
        self.random = random.Random(seed)
        self.lost = lost
        self.doubled = doubled
        self.delay_ms = delay_ms
        self._travelling: list[tuple[int, int, Callable[[int], None]]] = []
        self._count = 0
        self.steps = 0

    def send(self, now: int, arrive: Callable[[int], None]) -> None:
        for _ in range(2 if self.random.random() < self.doubled else 1):
            if self.random.random() >= self.lost:
                self.at(now + self.random.randint(0, self.delay_ms), arrive)

    def at(self, when: int, call: Callable[[int], None]) -> None:
        self._count += 1
        heapq.heappush(self._travelling, (when, self._count, call))

    def run(self) -> int:
        """Run until no message is in transit; return the time."""
        now = 0
        while self._travelling:
            now, _, call = heapq.heappop(self._travelling)
            call(now)
            self.steps += 1
            assert self.steps < 50_000, "the streams do not come to an end"
        return now


class Link:
    """A ReliableOut and a ReliableIn at the ends of a Wire. The clock starts at `epoch`."""

    def __init__(self, wire: Wire, first: int, epoch: int) -> None:
        self.wire = wire
        self.epoch = epoch
        self.out = ReliableOut()
        self.out.next = self.out.sent = self.out.acked = first
        self.into = ReliableIn()
        self.into.next = first
        self.into.announced = (first - 1) & 0xFFFF
        self.arrived: list[bytes] = []
        self._timer = False

    def put(self, body: bytes, now: int) -> None:
        # Messages begin with their number, in place of a header.
        self.out.put(self.out.next.to_bytes(2, "little") + body)
        self._send(self.out.take(self._ticks(now)), now)

    def _ticks(self, now: int) -> int:
        return (self.epoch + now) & TIME_MASK

    def _send(self, messages: list[bytes], now: int) -> None:
        check_out(self.out)
        for message in messages:
            self.wire.send(now, lambda then, message=message: self._receive(message, then))
        if not self._timer and self.out.deadline is not None:
            self._timer = True
            self.wire.at(now + 1, self._tick)

    def _tick(self, now: int) -> None:
        self._timer = False
        due = self.out.heartbeat(self._ticks(now))
        if due is not None:
            self.wire.send(now, lambda then: self._heartbeat(due, then))
        if self.out.deadline is not None:
            wait = (self.out.deadline - self._ticks(now)) & TIME_MASK
            assert 0 < wait <= HEARTBEAT_MS
            self._timer = True
            # ACKNACKs move the deadline, so check it again soon.
            self.wire.at(now + min(wait, 10), self._tick)

    def _receive(self, message: bytes, now: int) -> None:
        if self.into.receive(int.from_bytes(message[:2], "little"), message[2:]):
            self.arrived.append(message[2:])
            while (body := self.into.pop()) is not None:
                self.arrived.append(body)
        self._acknack(now)

    def _heartbeat(self, ends: tuple[int, int], now: int) -> None:
        assert not self.into.heartbeat(*ends, self._ticks(now))
        self._acknack(now)

    def _acknack(self, now: int) -> None:
        check_in(self.into)
        ends = self.into.acknack()
        self.wire.send(
            now, lambda then: self._send(self.out.acknack(*ends, self._ticks(then)), then)
        )


@settings(deadline=None, max_examples=examples(60))
@given(
    seed=st.integers(0, 1 << 32),
    first=NUMBERS,
    epoch=TIMES,
    lost=st.sampled_from([0.0, 0.05, 0.3]),
    doubled=st.sampled_from([0.0, 0.3]),
    delay_ms=st.sampled_from([0, 3, 50, 400]),
    count=st.integers(0, 80),
)
def test_everything_arrives_once_and_in_order(
    seed: int, first: int, epoch: int, lost: float, doubled: float, delay_ms: int, count: int
) -> None:
    wire = Wire(seed, lost, doubled, delay_ms)
    link = Link(wire, first, epoch)
    sent = [b"message %d" % n for n in range(count)]
    for n, body in enumerate(sent):
        wire.at(n // 7 * 5, lambda now, body=body: link.put(body, now))
    took = wire.run()
    assert link.arrived == sent
    assert len(link.out) == 0 and link.into.waiting == {}
    assert took < 2000 + count * 1000


@settings(deadline=None, max_examples=examples(20))
@given(
    seed=st.integers(0, 1 << 32),
    first=NUMBERS,
    room=st.integers(4, 600),
    sizes=st.lists(st.integers(0, 3000), max_size=3),
)
def test_fragmented_messages_arrive_whole_over_a_lossy_wire(
    seed: int, first: int, room: int, sizes: list[int]
) -> None:
    wire = Wire(seed, 0.2, 0.2, 10)
    link = Link(wire, first, 0)
    sent = [wire.random.randbytes(size) for size in sizes]
    for whole in sent:
        for start, stop, flags in split(len(whole), room):
            link.put(bytes([flags]) + whole[start:stop], 0)
    wire.run()
    fragments = Fragments()
    submessages = [fragments.add(memoryview(body)[1:], bool(body[0] & 2)) for body in link.arrived]
    assert [whole for whole in submessages if whole is not None] == sent
    assert fragments.pending == 0


def test_without_loss_nothing_is_sent_twice() -> None:
    wire = Wire(0, 0.0, 0.0, 5)
    link = Link(wire, 65530, TIME_MASK - 10)
    for n in range(100):
        link.put(b"%d" % n, 0)
    wire.run()
    assert len(link.arrived) == 100
    # each message, one acknack for it, and the timer
    assert wire.steps < 2 * 100 + 60


NEAR = st.one_of(st.integers(-40, 40), st.sampled_from([0x7FFE, 0x7FFF, 0x8000, 0x8001]))


@settings(deadline=None, max_examples=examples(300))
@given(
    first=NUMBERS,
    calls=st.lists(
        st.one_of(
            st.tuples(st.just("receive"), NEAR, st.just(0)),
            st.tuples(st.just("heartbeat"), NEAR, NEAR),
        ),
        max_size=40,
    ),
)
def test_a_hostile_sender(first: int, calls: list[tuple[str, int, int]]) -> None:
    stream = ReliableIn()
    stream.next = first
    stream.announced = (first - 1) & 0xFFFF
    now = 0
    for name, a, b in calls:
        before = stream.next
        if name == "receive":
            handed_on = stream.receive((stream.next + a) & 0xFFFF, b"x")
            assert handed_on == (a == 0)
            assert (stream.next - before) & 0xFFFF == handed_on
        else:
            now += 300
            ends = (stream.next + a) & 0xFFFF, (stream.next + b) & 0xFFFF
            if stream.heartbeat(*ends, now):
                assert a > 0 or b < -1  # no plausible heartbeat
                stream.restart(*ends)
            else:
                assert stream.next == before
        check_in(stream)
        while stream.pop() is not None:
            check_in(stream)
    # the stream still works
    if stream.next not in stream.waiting:
        assert stream.receive(stream.next, b"x")


@settings(deadline=None, max_examples=examples(300))
@given(
    first=NUMBERS,
    epoch=TIMES,
    limit=st.sampled_from([1, 20, MAX_HELD]),
    calls=st.lists(
        st.tuples(st.integers(0, 25), NEAR, st.integers(0, 0xFFFF), st.integers(0, 500)),
        max_size=30,
    ),
)
def test_a_hostile_receiver(
    first: int, epoch: int, limit: int, calls: list[tuple[int, int, int, int]]
) -> None:
    stream = ReliableOut(limit=limit)
    stream.next = stream.sent = stream.acked = first
    now = epoch
    for count, ahead, missing, wait in calls:
        for _ in range(count):
            if len(stream) < limit:
                stream.put(stream.next.to_bytes(2, "little"))
        out = stream.take(now)
        check_out(stream)
        in_flight = (stream.sent - stream.acked) & 0xFFFF
        acked = stream.acked
        now = (now + wait) & TIME_MASK
        again = stream.acknack((acked + ahead) & 0xFFFF, missing, now)
        check_out(stream)
        true = 0 <= ahead <= in_flight
        assert stream.acked == ((acked + ahead) & 0xFFFF if true else acked)
        assert true or again == []
        assert len(out) <= 16 and len(again) <= 16 + 16
        assert len(set(again)) == len(again)
        stream.heartbeat(now)
        check_out(stream)
