"""How soon the first sample passes between endpoints that have just found each other."""

import pytest
from support.rtps_network import (
    GROUP,
    LATCHED,
    TYPE,
    Inbox,
    Network,
    Stranger,
    cdr,
    pair,
    prefix,
    writer_of,
)

from uros.middleware.rtps import ids, parameters, submessages
from uros.middleware.rtps.parameters import EndpointData
from uros.middleware.rtps.reader import StatefulReader
from uros.middleware.rtps.reassembly import OctetBudget
from uros.middleware.rtps.writer import StatefulWriter
from uros.qos import QoSProfile


@pytest.fixture
def network():
    return Network()


def announce(remote, number, data):
    payload = parameters.write_endpoint(data)
    remote.send(submessages.encode_data(bytes(4), ids.PUBLICATIONS_WRITER, number, payload))


def endpoint(remote, key, topic="rt/chatter"):
    return EndpointData(remote.prefix + bytes([0, 0, key, 3]), True, topic, TYPE, QoSProfile())


def begin(network, member):
    """A stranger that has announced itself, and will announce endpoints from number 1 on."""
    remote = Stranger(network, member)
    remote.announce()
    remote.send(submessages.encode_heartbeat(bytes(4), ids.PUBLICATIONS_WRITER, 1, 0, 1))
    return remote


def test_the_first_sample_arrives_within_the_turn_of_the_match(network):
    """Four datagrams pass from the match to the sample: heartbeat and acknowledgement, then it."""
    one, two = pair(network)
    inbox = Inbox(network, two)
    network.step()
    writer = writer_of(network, one)
    network.carry()  # all without a step of time
    assert writer.matched()
    network.log.clear()
    writer.write(cdr(1), 0, network.now)
    network.carry()
    assert inbox.samples == [cdr(1)] and len(network.log) <= 4


def test_endpoints_match_within_the_turn_in_which_participants_meet(network):
    """Neither waits for the time after which heartbeats are repeated."""
    one = network.add(1)
    writer = writer_of(network, one)
    network.step(0.1, 50)
    inbox = Inbox(network, network.add(2))
    network.carry()  # all without a step of time
    assert writer.matched() and inbox.reader.state.writers


def asked(network):
    """What the stranger was asked since the last call: (heartbeats, acknowledgements)."""
    network.carry()
    sent = [
        submessage
        for _, datagram, place in network.log
        if place != GROUP
        for submessage in submessages.read(memoryview(datagram))
    ]
    network.log.clear()
    return tuple(
        {one.writer for one in sent if isinstance(one, kind)}
        for kind in (submessages.Heartbeat, submessages.AckNack)
    )


BUILTIN = {
    ids.PUBLICATIONS_WRITER, ids.SUBSCRIPTIONS_WRITER, ids.PARTICIPANT_MESSAGE_WRITER
}  # fmt: skip


def greet(network):
    """A stranger that was answered by an announcement, and by nothing else: that was too much."""
    one = network.add(1)
    network.carry()
    network.log.clear()
    stranger = Stranger(network, one)
    stranger.announce(builtin=0xC3F, user_data=bytes(50))
    assert asked(network) == (set(), set())
    (remote,) = one.remotes.values()
    assert not remote.lacks_announcement
    return stranger


@pytest.mark.parametrize("kind", ["acknowledgement", "heartbeat"])
def test_what_was_left_out_is_asked_as_soon_as_a_participant_has_answered(network, kind):
    """It is repeated later too: after 0.05 s and more."""
    stranger = greet(network)

    def answer(count):
        if kind == "heartbeat":
            return submessages.encode_heartbeat(bytes(4), ids.SUBSCRIPTIONS_WRITER, 1, 0, count)
        return submessages.encode_acknack(
            ids.SUBSCRIPTIONS_READER, ids.SUBSCRIPTIONS_WRITER, 1, (), count
        )

    stranger.send(answer(1))
    assert asked(network)[0] == set()  # that may be for anybody
    stranger.send(submessages.encode_info_dst(prefix(1)), answer(2))
    assert asked(network) == (BUILTIN, BUILTIN)
    assert asked(network) == (set(), set())  # once


def test_heartbeats_that_were_left_out_are_sent_as_soon_as_enough_octets_have_come(network):
    stranger = greet(network)
    stranger.announce(builtin=0xC3F, user_data=bytes(50))
    assert asked(network) == (BUILTIN, set())


def discovered(network, pause=0.0, late=False, qos=None):
    """What a writer knows of a reader that it has found after it had written.

    The writer has latched numbers 1 and 2, with 5 s in between. After a pause the participant of
    the reader is found, 0.1 s later number 3 is written, and then the reader is found; ``late`` has
    it created since its participant was found.
    """
    one = network.add(1)
    writer = writer_of(network, one, qos=LATCHED)
    writer.write(cdr(1), 0, network.now)
    network.step(5.0)
    writer.write(cdr(2), 0, network.now)
    network.step(pause)
    stranger = Stranger(network, one)
    stranger.announce()
    topic = ids.SUBSCRIPTIONS_WRITER
    stranger.send(submessages.encode_heartbeat(bytes(4), topic, 1, not late, 1))
    network.step(0.1)
    writer.write(cdr(3), 0, network.now)
    guid = stranger.prefix + b"\0\0\1\4"
    data = EndpointData(guid, False, "rt/chatter", TYPE, qos or QoSProfile())
    payload = parameters.write_endpoint(data)
    stranger.send(submessages.encode_data(bytes(4), topic, 1, payload))
    return writer.state.readers[guid]


def test_a_volatile_reader_gets_what_was_latched_while_it_was_being_discovered(network):
    """It is not from before the reader. With Cyclone, rclpy gets all that is latched."""
    reader = discovered(network)
    assert (reader.first, reader.last_at_match) == (2, 1)


def test_what_was_latched_before_discovery_is_not_for_a_volatile_reader(network):
    assert discovered(network, pause=5.0).first == 3


def test_what_was_latched_before_a_volatile_reader_was_created_is_not_for_it(network):
    reader = discovered(network, late=True)
    assert (reader.first, reader.last_at_match) == (4, 3)


def test_a_late_reader_that_is_latched_too_gets_the_history(network):
    assert discovered(network, pause=5.0, late=True, qos=LATCHED).first == 1


def test_a_sample_asks_a_reader_that_is_silent_whether_it_is_there():
    """Once: a fast writer does not ask with each of its samples."""
    writer = StatefulWriter(ids.VENDOR + bytes(14), True, False, 10, 1000)
    reader = ids.VENDOR + bytes(13) + b"\4"
    writer.match(reader, True, False, 100.0)
    assert writer.next_deadline() > 100.01
    writer.write(cdr(1), 0, 100.01)
    assert writer.next_deadline() == 100.01
    asked = 0
    for turn in range(30):
        now = 100.01 + turn * 0.001
        writer.write(cdr(turn), 0, now)
        asked += sum(1 for _ in writer.poll(now))
    assert asked == 1


def test_an_endpoint_is_matched_before_what_was_announced_earlier(network):
    """Fast DDS sends what it had announced before the match 0.1 s later than what it has since."""
    one = network.add(1)
    inbox = Inbox(network, one)
    remote = begin(network, one)
    announce(remote, 2, endpoint(remote, 2))
    assert list(inbox.reader.state.writers) == [endpoint(remote, 2).guid]
    announce(remote, 1, endpoint(remote, 1))
    assert set(inbox.reader.state.writers) == {endpoint(remote, key).guid for key in (1, 2)}


def test_an_endpoint_stays_away_if_its_announcement_comes_after_its_farewell(network):
    one = network.add(1)
    inbox = Inbox(network, one)
    remote = begin(network, one)
    guid = endpoint(remote, 1).guid
    farewell = submessages.encode_data(
        bytes(4), ids.PUBLICATIONS_WRITER, 2, parameters.write_key(guid),
        parameters.write_farewell_qos(guid), True,
    )  # fmt: skip
    remote.send(farewell)
    announce(remote, 1, endpoint(remote, 1))
    assert not inbox.reader.state.writers and not one.remotes[remote.prefix].endpoints


def test_an_early_sample_is_delivered_in_its_turn_too():
    early, delivered = [], []
    writer = ids.VENDOR + bytes(14)

    def deliver(sample):
        delivered.append(sample.number)
        return True

    reader = StatefulReader(
        ids.VENDOR + bytes(13) + b"\4", True, True, deliver, OctetBudget(10**6),
        lambda sample: early.append(sample.number),
    )  # fmt: skip
    reader.match(writer, True, 100.0)
    for number in (3, 2, 3):
        reader.on_data(writer, number, cdr(number), None, True, False, 100.0)
    assert early == [3, 2] and not delivered
    reader.on_heartbeat(writer, submessages.Heartbeat(bytes(4), writer[12:], 1, 3, 1, True, False),
                        100.0)  # fmt: skip
    reader.on_data(writer, 1, cdr(1), None, True, False, 100.0)
    assert early == [3, 2] and delivered == [1, 2, 3]


def heartbeats(packets):
    """The heartbeats in packets."""
    octets = submessages.header(bytes(12)) + b"".join(packet.submessages for packet in packets)
    found = submessages.read(memoryview(octets))
    return [one for one in found if isinstance(one, submessages.Heartbeat)]


@pytest.mark.parametrize(("size", "asked_from"), [(16, 16), (4096, 4)])
def test_readers_are_asked_to_acknowledge_what_is_much_and_else_after_a_pause(size, asked_from):
    """An acknowledgement for each request would cost both ends as much as the request."""
    writer = StatefulWriter(ids.VENDOR + bytes(14), True, False, None, 5000)
    reader = ids.VENDOR + bytes(13) + b"\4"
    writer.match(reader, True, False, 100.0)
    answer = submessages.AckNack(reader[12:], ids.ENTITY_UNKNOWN, 1, (), 1, True)
    writer.on_acknack(reader, answer, 100.0)
    for number in range(1, 20):
        writer.write(cdr(number, size), 0, 100.0)
        (heartbeat,) = heartbeats(writer.heartbeats_for_burst())
        assert heartbeat.last == number and heartbeat.final == (number < asked_from)
    assert writer.next_deadline() == 100.05
    (heartbeat,) = heartbeats(writer.poll(100.05))
    assert not heartbeat.final
