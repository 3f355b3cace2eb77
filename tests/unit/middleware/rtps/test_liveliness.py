"""Writers show that they are alive: by participant messages, and by what they write."""

import pytest
from support.rtps_network import (
    BEST_EFFORT,
    GROUP,
    Inbox,
    Network,
    Stranger,
    cdr,
    pair,
    prefix,
    writer_of,
)

from uros.middleware.rtps import ids, parameters, submessages
from uros.middleware.rtps.kinds import Data, Heartbeat
from uros.middleware.rtps.liveliness import write_participant_message
from uros.qos import LivelinessPolicy, QoSProfile

MANUAL = LivelinessPolicy.MANUAL_BY_TOPIC


@pytest.fixture
def network():
    return Network()


def lease(milliseconds, liveliness=LivelinessPolicy.AUTOMATIC):
    return QoSProfile(liveliness=liveliness, liveliness_lease_ms=milliseconds)


def messages(network, address="10.0.0.1"):
    """The participant messages in the log, as payloads."""
    return [
        bytes(submessage.payload)
        for datagram in network.sent(address)
        for submessage in submessages.read(memoryview(datagram))
        if isinstance(submessage, Data) and submessage.writer == ids.PARTICIPANT_MESSAGE_WRITER
    ]


def test_a_message_has_prefix_kind_and_no_data():
    """9.6.3.1; the kind is four octets in any byte order, and Fast DDS wants the length."""
    ours = prefix(1)
    assert write_participant_message(ours) == (
        bytes.fromhex("00010000") + ours + bytes.fromhex("00000001 00000000")
    )


def test_the_endpoints_are_announced():
    network = Network()
    network.add(1)
    network.carry()
    (announcement,) = {datagram for _, datagram, place in network.log if place == GROUP}
    (data,) = submessages.read(memoryview(announcement))
    assert parameters.read_participant(data.payload).builtin == 0xC3F


def test_a_lease_is_asserted_three_times_in_its_time_and_only_while_it_lasts(network):
    one, two = pair(network)
    writer = writer_of(network, one, qos=lease(600))
    network.step(0.02, 5)
    network.log.clear()
    network.step(0.01, 600)  # 6 s
    assert 28 <= len(messages(network)) <= 32
    assert set(messages(network)) == {write_participant_message(prefix(1))}
    shorter = writer_of(network, one, qos=lease(300))
    network.step(0.02, 5)
    network.log.clear()
    network.step(0.01, 600)
    assert 56 <= len(messages(network)) <= 64
    one.delete(shorter, network.now, 0)
    network.step(0.02, 20)
    network.log.clear()
    network.step(0.01, 600)
    assert 28 <= len(messages(network)) <= 32
    one.delete(writer, network.now, 0)
    network.step(0.02, 20)
    network.log.clear()
    network.step(0.01, 600)
    assert not messages(network)


def test_a_new_lease_is_asserted_at_once(network):
    one, _ = pair(network)
    network.step(0.02, 5)
    network.log.clear()
    for _ in range(2):  # the second one waits for no period of the first
        writer_of(network, one, qos=lease(60_000))
        network.step(0.02, 2)
    assert len(messages(network)) == 2


@pytest.mark.parametrize("profile", [QoSProfile(), lease(0), lease(None), lease(500, MANUAL)])
def test_writers_without_a_lease_or_with_manual_liveliness_send_no_messages(network, profile):
    one, two = pair(network)
    writer_of(network, one, qos=profile)
    Inbox(network, two, qos=BEST_EFFORT)
    network.step(0.05, 100)
    assert not messages(network)


def test_a_lease_of_a_millisecond_makes_no_flood(network):
    one, _ = pair(network)
    writer_of(network, one, qos=lease(1))
    network.log.clear()
    network.step(0.001, 1000)
    assert 20 < len(messages(network)) <= 51


def test_messages_arrive_and_are_acknowledged(network):
    one, two = pair(network)
    writer_of(network, one, qos=lease(500))
    network.step(0.05, 50)
    (proxy,) = two.readers[ids.PARTICIPANT_MESSAGE_READER].state.writers.values()
    assert proxy.guid == prefix(1) + ids.PARTICIPANT_MESSAGE_WRITER
    assert proxy.expected > 10
    (proxy,) = one.writers[ids.PARTICIPANT_MESSAGE_WRITER].state.readers.values()
    assert proxy.acked > 10


def test_what_a_participant_sends_renews_its_lease(network):
    """Its announcements go by multicast, which Wi-Fi loses more often."""
    one = network.add(1)
    stranger = Stranger(network, one)
    stranger.announce(lease_ms=1000)
    data = submessages.encode_data(
        ids.PARTICIPANT_MESSAGE_READER, ids.PARTICIPANT_MESSAGE_WRITER, 1,
        write_participant_message(stranger.prefix),
    )  # fmt: skip
    for _ in range(5):
        network.step(0.8)
        stranger.send(data)
    network.step(0.8)
    assert one.remotes
    stranger.send(data, address="10.0.0.67")  # of somebody else
    network.step(0.8, 2)
    assert not one.remotes


@pytest.mark.parametrize("kind", [LivelinessPolicy.AUTOMATIC, MANUAL])
def test_the_heartbeat_behind_a_sample_asserts_manual_liveliness(network, kind):
    """So a reader knows it even where the sample is lost; repeated heartbeats assert nothing."""
    one, two = pair(network)
    writer = writer_of(network, one, qos=lease(5000, kind))
    Inbox(network, two, qos=QoSProfile())
    network.until(writer.matched)
    network.step(0.05, 10)
    network.log.clear()
    network.loss = 1.0
    writer.write(cdr(1), 0, network.now)
    network.step(0.05, 20)
    flags = [
        submessage.liveliness
        for datagram in network.sent("10.0.0.1")
        for submessage in submessages.read(memoryview(datagram))
        if isinstance(submessage, Heartbeat) and submessage.writer == writer.data.guid[12:]
    ]
    assert flags[0] is (kind == MANUAL) and len(flags) > 2 and not any(flags[1:])
