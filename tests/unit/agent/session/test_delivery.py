"""Deliveries of READ_DATA, with a clock that the test sets."""

import pytest
from unit.agent.helpers import KEY, SESSION, acknack, message, parse

from uros.agent.session.delivery import Delivery
from uros.agent.session.session import Session
from uros.wire import ids

STREAMS = [0x01, 0x80]


class Source:
    def __init__(self, samples=()):
        self.samples = list(samples)
        self.takes = []

    def take(self, limit):
        self.takes.append(limit)
        samples, self.samples = self.samples[:limit], self.samples[limit:]
        return [(1, sample) for sample in samples]


class Talk:
    def __init__(self, samples, control, stream, mtu=512):
        self.now = 7000
        self.session = Session(KEY, SESSION, mtu, self)
        self.source = Source(samples)
        self.delivery = Delivery(
            self.session, self.source, 0x1234, 0x0016, stream, control, self.now
        )
        self.stream = stream
        self.next = 0

    def room(self, stream):
        pass

    def pump(self):
        """Pump the delivery; return the samples that were sent."""
        self.delivery.pump(self.now)
        return self.sent()

    def sent(self):
        out = []
        for datagram in self.session.outgoing:
            (_, stream, _), submessages = parse(datagram)
            assert stream == self.stream
            self.next += 1
            for kind, _, payload in submessages:
                if kind == ids.DATA:
                    assert payload[:4] == b"\x12\x34\x00\x16"
                    out.append(payload[4:])
        self.session.outgoing.clear()
        return out

    def acknowledge(self):
        buf = bytearray(message([acknack(self.next, 0, self.stream)], 0))
        self.session.receive(buf, memoryview(buf), len(buf), self.now)

    def wait(self, milliseconds):
        """Advance the clock; return (ms since the start, sample) of what timers send."""
        out = []
        start, end = self.now, self.now + milliseconds
        while True:
            at = self.delivery.next_deadline()
            if at is None or at > end or self.delivery.finished(self.now):
                break
            self.now = max(self.now, at)
            out += [(self.now - start, sample) for sample in self.pump()]
        self.now = end
        return out


def numbered(count):
    return [i.to_bytes(2, "big") * 50 for i in range(count)]


@pytest.fixture(params=STREAMS, ids=["best_effort", "reliable"])
def stream(request):
    return request.param


def test_without_delivery_control_one_sample_is_sent(stream):
    talk = Talk(numbered(5), None, stream)
    assert talk.pump() == numbered(1)
    assert talk.delivery.finished(talk.now)
    assert len(talk.source.samples) == 4


def test_max_samples_limits_a_delivery(stream):
    talk = Talk(numbered(2), (3, 0, 0, 0), stream)
    assert talk.pump() == numbered(2)
    assert not talk.delivery.finished(talk.now)
    talk.source.samples += numbered(5)
    assert len(talk.pump()) == 1
    assert talk.delivery.finished(talk.now)
    assert len(talk.source.samples) == 4


def test_unlimited(stream):
    talk = Talk([], (ids.MAX_SAMPLES_UNLIMITED, 0, 0, 0), stream)
    for _ in range(200):
        talk.source.samples += numbered(10)
        assert len(talk.pump()) == 10
        talk.acknowledge()
    assert not talk.delivery.finished(talk.now + 3_600_000)
    assert talk.delivery.next_deadline() is None


def test_max_elapsed_time_ends_a_delivery(stream):
    talk = Talk(numbered(1), (ids.MAX_SAMPLES_UNLIMITED, 2, 0, 0), stream)
    assert len(talk.pump()) == 1
    talk.now += 1999
    talk.source.samples += numbered(1)
    assert len(talk.pump()) == 1
    talk.now += 1
    talk.source.samples += numbered(1)
    assert talk.delivery.finished(talk.now)
    assert talk.pump() == [] and len(talk.source.samples) == 1


def test_min_pace_period_delays_samples(stream):
    talk = Talk(numbered(4), (ids.MAX_SAMPLES_UNLIMITED, 0, 0, 250), stream)
    assert talk.pump() == numbered(1)
    assert talk.pump() == []
    assert [at for at, _ in talk.wait(1000)] == [250, 500, 750]
    assert talk.delivery.next_deadline() is None  # nothing is left to send


def test_max_bytes_per_second_delays_samples(stream):
    talk = Talk(numbered(11), (ids.MAX_SAMPLES_UNLIMITED, 0, 400, 0), stream)
    assert len(talk.pump()) == 1
    assert [at for at, _ in talk.wait(2000)] == list(range(250, 2001, 250))


def test_the_slower_of_pace_and_rate_applies(stream):
    talk = Talk(numbered(3), (ids.MAX_SAMPLES_UNLIMITED, 0, 400, 1000), stream)
    talk.pump()
    assert [at for at, _ in talk.wait(2000)] == [1000, 2000]
    talk = Talk(numbered(3), (ids.MAX_SAMPLES_UNLIMITED, 0, 50, 1000), stream)
    talk.pump()
    assert [at for at, _ in talk.wait(4000)] == [2000, 4000]


def test_pace_with_max_samples_and_max_elapsed_time(stream):
    talk = Talk(numbered(9), (3, 0, 0, 100), stream)
    talk.pump()
    assert [at for at, _ in talk.wait(1000)] == [100, 200]
    assert talk.delivery.finished(talk.now)
    talk = Talk(numbered(99), (ids.MAX_SAMPLES_UNLIMITED, 1, 0, 300), stream)
    talk.pump()
    assert [at for at, _ in talk.wait(999)] == [300, 600, 900]
    talk.now += 1
    talk.delivery.pump(talk.now)
    assert talk.delivery.finished(talk.now) and talk.sent() == []


def test_a_full_window_leaves_samples_where_they_are():
    talk = Talk(numbered(100), (ids.MAX_SAMPLES_UNLIMITED, 0, 0, 0), 0x80)
    assert len(talk.pump()) == 16
    assert len(talk.source.samples) == 84
    assert talk.pump() == []
    talk.acknowledge()
    assert len(talk.pump()) == 16
    assert len(talk.source.samples) == 68


def test_best_effort_goes_on_in_the_next_turn():
    talk = Talk(numbered(200), (ids.MAX_SAMPLES_UNLIMITED, 0, 0, 0), 0x01)
    sent = talk.pump()
    assert len(sent) == 64
    assert talk.delivery.next_deadline() == talk.now
    sent += [sample for _, sample in talk.wait(0)]
    assert sent == numbered(200)
    assert talk.delivery.next_deadline() is None


def test_samples_in_fragments_come_one_by_one():
    big = [bytes([i]) * 2000 for i in range(20)]
    talk = Talk(big, (ids.MAX_SAMPLES_UNLIMITED, 0, 0, 0), 0x80)
    talk.source.samples = big[:1]
    talk.pump()
    talk.source.samples = big[1:]
    talk.source.takes.clear()
    talk.pump()
    assert set(talk.source.takes) == {1}
    assert len(talk.session._out[0x80]) <= 16 + 4


def test_times_wrap():
    talk = Talk(numbered(5), (ids.MAX_SAMPLES_UNLIMITED, 2, 0, 0), 0x01)
    talk.now = 0x3FFFFFFF - 500
    talk.delivery = Delivery(
        talk.session, talk.source, 0x1234, 0x0016, 1, (0xFFFF, 2, 0, 0), talk.now
    )
    assert len(talk.pump()) == 5
    assert not talk.delivery.finished(1000)
    assert talk.delivery.finished(1499)


@pytest.mark.parametrize("stream", STREAMS)
def test_without_delivery_control_one_sample_is_awaited_for_ever(stream):
    talk = Talk([], None, stream)
    assert talk.pump() == []
    talk.now += 3_600_000
    assert not talk.delivery.finished(talk.now)
    talk.source.samples += [b"late", b"later"]
    assert talk.pump() == [b"late"]
    assert talk.delivery.finished(talk.now)


@pytest.mark.parametrize("stream", STREAMS)
def test_the_session_tells_that_samples_were_sent(stream):
    talk = Talk([], (0xFFFF, 0, 0, 0), stream)
    talk.pump()
    assert not talk.session.delivered
    talk.source.samples = [b"1234"]
    talk.pump()
    assert talk.session.delivered
