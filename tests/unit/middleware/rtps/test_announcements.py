"""What a participant announces of itself and of its endpoints, and when."""

import struct

import pytest
from support.rtps_network import (
    BEST_EFFORT,
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

from uros.middleware.rtps import ids, parameters, spdp, submessages
from uros.middleware.rtps.kinds import Data, DataFrag, HeartbeatFrag
from uros.middleware.rtps.locators import UDPV4, Locator
from uros.middleware.rtps.parameters import EndpointData
from uros.middleware.rtps.participant import Participant
from uros.qos import QoSProfile

PLACE = Locator(UDPV4, 7410, "10.0.0.1")


@pytest.fixture
def network():
    return Network()


def data_of(datagram, writer):
    """The DATA of a writer's entity id in a datagram."""
    return [
        submessage
        for submessage in submessages.read(memoryview(datagram))
        if isinstance(submessage, Data) and submessage.writer == writer
    ]


def pids_of(payload):
    return {pid for pid, _ in parameters.parameters(payload[4:], True)}


# --- participants ---------------------------------------------------------------------------------


def test_a_participant_announces_version_domain_lease_locators_and_enclave(network):
    one = network.add(1, domain=7)
    one.poll(network.now)
    ((datagram, place),) = one.take_datagrams()
    assert place == GROUP
    # One constant is the vendor, and begins the prefix: neither 01 0F nor 01 10 nor 00 00.
    assert submessages.read_header(memoryview(datagram)) == (b"\2\3", ids.VENDOR, one.guid[:12])
    assert one.guid.startswith(ids.VENDOR)
    (data,) = data_of(datagram, b"\0\1\0\xc2")
    assert data.reader == b"\0\1\0\xc7" and not data.is_key
    found = parameters.read_participant(data.payload)
    assert found.guid == one.guid
    said = dict(parameters.parameters(data.payload[4:], True))
    assert said[ids.PID_VENDOR_ID][:2] == ids.VENDOR
    assert said[ids.PID_PROTOCOL_VERSION][:2] == b"\2\3"
    assert found.domain == 7 and found.domain_tag == "" and found.lease_ms == spdp.LEASE_MS
    assert found.metatraffic_unicast == found.default_unicast == [PLACE]
    assert found.metatraffic_multicast == [GROUP] and not found.default_multicast
    assert found.user_data == b"enclave=/;"


def test_announcements_are_early_and_then_several_in_a_lease(network):
    one = network.add(1)
    start, times = network.now, []
    while network.now < start + 100:
        network.now = one.next_deadline()
        one.poll(network.now)
        times += [network.now - start for _, place in one.take_datagrams() if place == GROUP]
    assert times[:4] == pytest.approx([0.0, 0.1, 0.2, 0.5])
    pauses = [after - before for before, after in zip(times[4:], times[5:], strict=False)]
    lease = spdp.LEASE_MS / 1000
    assert all(lease / 10 < pause < lease / 3 for pause in pauses)


def test_a_new_participant_is_answered_at_once_and_by_unicast(network):
    one = network.add(1)
    one.poll(network.now)
    one.take_datagrams()
    stranger = Stranger(network, one)
    stranger.announce(user_data=bytes(200))  # it is sent no more octets than came
    (datagram, place), *_ = one.take_datagrams()  # heartbeats of SEDP follow
    assert place == stranger.place and data_of(datagram, ids.SPDP_WRITER)
    stranger.announce(user_data=bytes(200))
    assert not one.take_datagrams()


def test_a_farewell_is_a_key_with_the_status_disposed_and_unregistered(network):
    one, _ = pair(network)
    one.close()
    sent = one.take_datagrams()
    assert {place for _, place in sent} == {GROUP, Locator(UDPV4, 7410, "10.0.0.2")}
    for datagram, _ in sent:
        (data,) = data_of(datagram, ids.SPDP_WRITER)
        assert data.is_key and parameters.read_key(data.payload) == one.guid
        raw = dict(parameters.parameters(data.inline_qos, True))
        assert raw[ids.PID_STATUS_INFO] == b"\0\0\0\3"
        assert raw[ids.PID_KEY_HASH] == one.guid


def test_our_own_multicast_is_dropped(network):
    """It comes back from our own addresses, with our prefix."""
    one = network.add(1)
    inbox = Inbox(network, one, qos=BEST_EFFORT)
    writer = writer_of(network, one, qos=BEST_EFFORT)
    one.poll(network.now)
    (announced,) = {datagram for datagram, place in one.take_datagrams() if place == GROUP}
    network.inject("10.0.0.1", announced, one)
    own = submessages.header(one.guid[:12]) + submessages.encode_data(
        bytes(4), writer.data.guid[12:], 1, cdr(1)
    )
    network.inject("10.0.0.1", own, one)
    assert not one.remotes and not inbox.samples and not one.malformed


# --- endpoints ------------------------------------------------------------------------------------

WRITTEN = {
    "writer": {
        ids.PID_ENDPOINT_GUID, ids.PID_PARTICIPANT_GUID, ids.PID_TOPIC_NAME, ids.PID_TYPE_NAME,
        ids.PID_RELIABILITY, ids.PID_DURABILITY, ids.PID_DEADLINE, ids.PID_LIVELINESS,
        ids.PID_OWNERSHIP, ids.PID_DATA_REPRESENTATION, ids.PID_HISTORY, ids.PID_LIFESPAN,
    },
    "reader": {
        ids.PID_ENDPOINT_GUID, ids.PID_PARTICIPANT_GUID, ids.PID_TOPIC_NAME, ids.PID_TYPE_NAME,
        ids.PID_RELIABILITY, ids.PID_DURABILITY, ids.PID_DEADLINE, ids.PID_LIVELINESS,
        ids.PID_OWNERSHIP, ids.PID_DATA_REPRESENTATION, ids.PID_HISTORY,
    },
}  # fmt: skip


@pytest.mark.parametrize("kind", ["writer", "reader"])
def test_an_endpoint_announces_no_type_information_nor_anything_of_vendors(kind):
    guid = prefix(1) + b"\0\0\1\3"
    data = EndpointData(guid, kind == "writer", "rt/a", TYPE, QoSProfile())
    payload = parameters.write_endpoint(data)
    assert pids_of(payload) == WRITTEN[kind]
    assert struct.pack("<HHI", ids.PID_DATA_REPRESENTATION, 8, 1) + b"\0\0\0\0" in payload


@pytest.mark.parametrize(("qos", "number"), [(BEST_EFFORT, 1), (QoSProfile(), 2)])
def test_the_numbers_of_reliability_are_1_and_2(qos, number):
    guid = prefix(1) + b"\0\0\1\3"
    payload = parameters.write_endpoint(EndpointData(guid, True, "rt/a", TYPE, qos))
    raw = dict(parameters.parameters(payload[4:], True))
    assert raw[ids.PID_RELIABILITY][:4] == struct.pack("<I", number)
    assert parameters.read_endpoint(payload, True).qos.reliable == (number == 2)


def test_a_deleted_endpoint_is_a_key_with_the_status_disposed_and_unregistered(network):
    one, _ = pair(network)
    writer = writer_of(network, one)
    network.step(0.1, 5)
    one.delete(writer, network.now, 0)
    one.flush()
    (data,) = [
        data
        for datagram, _ in one.take_datagrams()
        for data in data_of(datagram, ids.PUBLICATIONS_WRITER)
    ]
    assert data.is_key and parameters.read_key(data.payload) == writer.data.guid
    raw = dict(parameters.parameters(data.inline_qos, True))
    assert raw[ids.PID_STATUS_INFO] == b"\0\0\0\3"


@pytest.mark.parametrize("own", [True, False])
def test_an_endpoint_without_locators_receives_at_those_of_its_participant(network, own):
    one = network.add(1)
    writer = writer_of(network, one, qos=BEST_EFFORT)
    stranger = Stranger(network, one)
    default, special = (Locator(UDPV4, port, stranger.address) for port in (7777, 8888))
    stranger.announce(default_unicast=[default])
    stranger.endpoint("rt/chatter", False, places=[special] if own else [], qos=BEST_EFFORT)
    acknack = submessages.encode_acknack(
        ids.PUBLICATIONS_READER, ids.PUBLICATIONS_WRITER, 1, [], 1, True
    )
    stranger.send(submessages.encode_info_dst(one.guid[:12]), acknack)  # so it has answered
    one.poll(network.now)
    one.take_datagrams()
    writer.write(cdr(1), 0, network.now)
    one.flush()
    ((_, place),) = one.take_datagrams()
    assert place == (special if own else default)


def test_partitions_do_not_match_and_are_named(network):
    one = network.add(1)
    named = []
    one.on_mismatch = lambda ours, theirs, why: named.append([item.policy for item in why])
    writer = writer_of(network, one, qos=LATCHED)
    stranger = Stranger(network, one)
    stranger.announce()
    stranger.endpoint("rt/chatter", False, qos=QoSProfile(partitions=("lab",)))
    assert writer.matched() == 0 and named == [["partition"]]
    stranger.endpoint("rt/chatter", False, qos=QoSProfile(partitions=("lab", "")))
    assert writer.matched() == 1


@pytest.mark.parametrize("size", [600, 1400, 14_720])
def test_the_size_of_messages_is_an_option(network, size):
    one = Participant(prefix(1), 0, [PLACE], [GROUP], [], b"", network.now, size)
    network.members["10.0.0.1"] = one
    two = network.add(2)
    writer, inbox = writer_of(network, one), Inbox(network, two)
    network.until(writer.matched)
    network.step(0.1, 10)
    network.log.clear()
    writer.write(cdr(1, 100_000), 0, network.now)
    network.until(lambda: inbox.samples)
    assert size - 200 < max(map(len, network.sent("10.0.0.1"))) <= size
    fragments = [
        fragment
        for datagram in network.sent("10.0.0.1")
        for fragment in submessages.read(memoryview(datagram))
        if isinstance(fragment, DataFrag)
    ]
    assert len(fragments) == pytest.approx(100_012 / fragments[0].fragment_size, abs=1)


def test_no_heartbeat_of_fragments_is_sent(network):
    """Fast DDS ignores it: what lacks is asked for after a heartbeat."""
    one, two = pair(network)
    writer, inbox = writer_of(network, one), Inbox(network, two)
    network.until(writer.matched)
    network.loss = 0.2
    writer.write(cdr(1, 50_000), 0, network.now)
    network.until(lambda: inbox.samples)
    kinds = {
        type(submessage)
        for _, datagram, _ in network.log
        for submessage in submessages.read(memoryview(datagram))
    }
    assert DataFrag in kinds and HeartbeatFrag not in kinds
