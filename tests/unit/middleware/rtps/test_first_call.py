"""How soon the first sample passes between endpoints that have just found each other."""

import pytest
from support.rtps_network import TYPE, Inbox, Network, Stranger, cdr, pair, writer_of

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
