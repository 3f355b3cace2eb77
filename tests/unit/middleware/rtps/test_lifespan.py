"""Samples whose lifespan is over: writers do not repeat them, readers do not give them out."""

import math
import struct

import pytest
from support.rtps_network import LATCHED, Inbox, Network, Stranger, cdr, pair, writer_of

from uros.middleware.rtps import ids, parameters, submessages
from uros.middleware.rtps.kinds import AckNack, DataFrag, Gap, Heartbeat
from uros.middleware.rtps.reader import StatefulReader
from uros.middleware.rtps.reassembly import OctetBudget
from uros.qos import DurabilityPolicy, HistoryPolicy, QoSProfile

WRITER = b"\x01\x75" + bytes(10) + b"\0\0\1\3"


@pytest.fixture
def network():
    return Network()


def of_a_second(**more):
    return QoSProfile(lifespan_ms=1000, **more)


def test_a_late_reader_gets_what_is_not_over(network):
    one, two = pair(network)
    writer = writer_of(network, one, qos=of_a_second(durability=DurabilityPolicy.TRANSIENT_LOCAL))
    writer.write(cdr(1), 0, network.now)
    network.step(0.1, 6)
    writer.write(cdr(2), 0, network.now)
    network.step(0.1, 6)
    inbox = Inbox(network, two, qos=LATCHED)
    network.until(lambda: inbox.samples)
    network.step(0.1, 20)
    assert inbox.samples == [cdr(2)]


def test_a_reader_that_matches_late_in_a_turn_gets_what_is_not_over(network):
    """Nothing was polled between the end of the lifespan and the match."""
    one = network.add(1)
    qos = of_a_second(durability=DurabilityPolicy.TRANSIENT_LOCAL)
    state = writer_of(network, one, qos=qos).state
    state.write(cdr(1), 0, network.now)
    state.write(cdr(2), 0, network.now + 0.5)
    assert not state.match(bytes(16), False, True, network.now + 2.0)
    state.write(cdr(3), 0, network.now + 2.0)
    assert [change.number for change in state.history(network.now + 2.0)] == [3]
    assert not state.history(network.now + 3.0)


def test_what_was_lost_for_a_lifespan_is_not_repeated(network):
    one, two = pair(network)
    writer, inbox = writer_of(network, one, qos=of_a_second()), Inbox(network, two)
    network.until(writer.matched)
    network.step(0.1, 10)
    network.loss = 1.0
    writer.write(cdr(1), 0, network.now)
    network.step(0.1, 12)
    network.loss = 0.0
    writer.write(cdr(2), 0, network.now)
    network.until(lambda: inbox.samples)
    network.step(0.1, 30)
    assert inbox.samples == [cdr(2)]
    (proxy,) = writer.state.readers.values()
    assert proxy.acked == 2


def test_a_request_for_what_is_over_is_answered_by_a_gap(network):
    one = network.add(1)
    state = writer_of(network, one, qos=of_a_second()).state
    state.match(bytes(16), True, False, network.now)
    state.on_acknack(bytes(16), AckNack(bytes(4), bytes(4), 1, (), 1, True), network.now)
    state.write(cdr(1), 0, network.now)
    late = network.now + 1.0
    state.on_acknack(bytes(16), AckNack(bytes(4), bytes(4), 1, (1,), 2, True), late)
    octets = b"".join(packet.submessages for packet in state.poll(late))
    gap, heartbeat = submessages.read(memoryview(bytes(20) + octets))
    assert isinstance(gap, Gap) and (gap.start, gap.base) == (1, 2)
    assert isinstance(heartbeat, Heartbeat) and (heartbeat.first, heartbeat.last) == (2, 1)


def test_a_history_that_is_full_has_room_after_the_lifespan(network):
    one, two = pair(network)
    writer = writer_of(network, one, qos=of_a_second(history=HistoryPolicy.KEEP_ALL))
    Inbox(network, two, qos=QoSProfile(history=HistoryPolicy.KEEP_ALL))
    network.until(writer.matched)
    network.loss = 1.0
    while writer.write(cdr(1), 0, network.now):
        pass
    network.step(0.5)
    assert not writer.write(cdr(1), 0, network.now)
    network.step(0.5)
    network.step(0.1, 2)
    assert writer.write(cdr(1), 0, network.now)


def test_a_writer_has_something_to_do_when_the_oldest_is_over(network):
    qos = of_a_second(durability=DurabilityPolicy.TRANSIENT_LOCAL)
    state = writer_of(network, network.add(1), qos=qos).state
    for later in (0.0, 0.25):
        state.write(cdr(1), 0, network.now + later)
    for later in (1.0, 1.25):
        assert state.next_deadline() == network.now + later
        assert not list(state.poll(network.now + later))
    assert state.next_deadline() is None


def test_without_a_lifespan_an_idle_writer_has_nothing_to_do(network):
    state = writer_of(network, network.add(1), qos=LATCHED).state
    state.write(cdr(1), 0, network.now)
    assert state.next_deadline() is None
    assert len(state.history(network.now + 1e9)) == 1


def reader(samples):
    made = StatefulReader(
        bytes(16), True, False, lambda sample: bool(samples.append(sample)) or True,
        OctetBudget(10**6),
    )  # fmt: skip
    made.match(WRITER, True, 0.0, 2.0)
    made.on_heartbeat(WRITER, Heartbeat(bytes(4), WRITER[12:], 1, 3, 1, False, False), 0.0)
    return made


def test_a_lifespan_begins_when_a_sample_arrives():
    """Not when it is in order: what is held grows old meanwhile."""
    samples = []
    made = reader(samples)
    made.on_data(WRITER, 2, cdr(2), None, True, False, 5.0)
    made.on_data(WRITER, 1, cdr(1), None, True, False, 6.0)
    body = memoryview(cdr(3, 200))
    for first, now in ((1, 7.0), (2, 8.0)):
        part = body[108 * (first - 1) : 108 * first]
        made.on_fragments(
            WRITER,
            DataFrag(bytes(4), WRITER[12:], 3, first, 1, 108, len(body), None, part, False, True),
            now,
        )
    assert [(sample.number, sample.expires) for sample in samples] == [(1, 8.0), (2, 7.0), (3, 10)]


def test_a_writer_may_announce_another_lifespan(network):
    one = network.add(1)
    inbox = Inbox(network, one)
    stranger = Stranger(network, one)
    stranger.announce()
    guid = stranger.endpoint("rt/chatter", True, qos=of_a_second())
    assert inbox.reader.state.writers[guid].lifespan == 1.0
    stranger.endpoint("rt/chatter", True, guid=guid, qos=QoSProfile(lifespan_ms=3000))
    assert inbox.reader.state.writers[guid].lifespan == 3.0


@pytest.mark.parametrize("form", [(0x7FFFFFFF, 0xFFFFFFFF), (-1, 0xFFFFFFFF), None])
def test_infinite_in_both_forms_and_an_absent_lifespan_have_no_end(network, form):
    one = network.add(1)
    inbox = Inbox(network, one)
    stranger = Stranger(network, one)
    stranger.announce()
    guid = stranger.prefix + b"\0\0\1\3"
    payload = parameters.write_endpoint(
        parameters.EndpointData(guid, True, "rt/chatter", inbox.reader.data.type_name, QoSProfile())
    )
    own = struct.pack("<HHiI", ids.PID_LIFESPAN, 8, 0x7FFFFFFF, 0xFFFFFFFF)
    assert own in payload
    other = b"" if form is None else struct.pack("<HHiI", ids.PID_LIFESPAN, 8, *form)
    entity = ids.PUBLICATIONS_WRITER
    stranger.send(
        submessages.encode_heartbeat(bytes(4), entity, 1, 0, 1),
        submessages.encode_data(bytes(4), entity, 1, payload.replace(own, other)),
    )
    assert inbox.reader.state.writers[guid].lifespan == math.inf
