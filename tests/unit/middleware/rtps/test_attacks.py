"""Attacks on an RTPS participant, among them those on other implementations that have CVE numbers.

No test counts seconds: work is counted in calls of a hot function, memory in the accounts of the
participant, traffic in octets.
"""

import struct
import tracemalloc
from collections import Counter

import pytest
from support.rtps_network import (
    BEST_EFFORT,
    GROUP,
    TYPE,
    Inbox,
    Network,
    Stranger,
    announcement,
    cdr,
    encode_heartbeat_frag,
    is_acknowledged,
    pair,
    prefix,
    writer_of,
)

from uros.middleware.rtps import (
    ids,
    parameters,
    participant,
    reader,
    remote,
    submessages,
    writer,
)
from uros.middleware.rtps.locators import UDPV4, Locator
from uros.middleware.rtps.parameters import EndpointData, ParticipantData
from uros.middleware.rtps.reassembly import OctetBudget
from uros.qos import HistoryPolicy, QoSProfile

NO_ENTITY = bytes(4)
LARGEST = 65_000  # octets of a datagram over UDP, about


@pytest.fixture
def network():
    return Network()


@pytest.fixture
def stranger(network):
    """A participant that has a reliable writer, which our reader of rt/chatter has matched."""
    one = network.add(1)
    network.inbox = Inbox(network, one)
    stranger = Stranger(network, one)
    stranger.announce()
    stranger.writer = stranger.endpoint("rt/chatter", True)
    return stranger


def proxy_of(network, stranger):
    return network.inbox.reader.state.writers[stranger.writer]


def works(network, member):
    """Whether a participant that comes now exchanges samples with ours."""
    friend = network.add(9)
    inbox = Inbox(network, friend, topic="rt/works")
    sender = writer_of(network, member, topic="rt/works")
    network.until(lambda: sender.matched() and inbox.reader.state.writers)
    sender.write(cdr(1), 0, network.now)
    network.until(lambda: inbox.samples)
    return inbox.samples == [cdr(1)]


def prove(stranger):
    """Answer our participant, so that it may send more than came from the stranger."""
    answer = submessages.encode_acknack(ids.PUBLICATIONS_READER, ids.PUBLICATIONS_WRITER, 1, (), 1)
    stranger.send(submessages.encode_info_dst(prefix(1)), answer)


def raw(kind, body, flags=1, length=None):
    """A submessage, of which all may be wrong."""
    return struct.pack("<BBH", kind, flags, len(body) if length is None else length) + body


def parameter(pid, body, length=None):
    return struct.pack("<HH", pid, len(body) if length is None else length) + body


def spdp(list_of_parameters, entity=ids.SPDP_WRITER):
    """DATA of SPDP, or of another builtin topic, with this parameter list."""
    payload = parameters.PL_CDR_LE + b"\0\0" + list_of_parameters
    return submessages.encode_data(NO_ENTITY, entity, 2, payload)


def octets_to(network, address):
    return sum(len(datagram) for _, datagram, place in network.log if place.address == address)


# --- traffic to others ----------------------------------------------------------------------------


def test_an_announcement_makes_nobody_send_to_a_third_host(network):
    """CVE-2021-38425 (Fast DDS), -38429 (OpenDDS), -38487 (Connext), -43547 (CoreDX)."""
    one = network.add(1)
    stranger = Stranger(network, one, said="192.0.2.99")
    third = Locator(UDPV4, 7410, "192.0.2.99")
    stranger.announce(
        metatraffic_multicast=[third], default_multicast=[third], metatraffic_unicast=[third] * 16
    )
    prove(stranger)
    stranger.endpoint("rt/chatter", False, places=[third])
    sender = writer_of(network, one)
    sender.write(cdr(1), 0, network.now)
    network.step(0.2, 100)
    assert octets_to(network, "192.0.2.99") == 0 and octets_to(network, "10.0.0.66") > 0


def test_many_participants_in_one_datagram_get_no_more_octets_than_it_has(network):
    """INFO_SRC gives each announcement of a datagram a participant of its own."""
    one = network.add(1)
    for _ in range(50):
        writer_of(network, one)
    network.step(0.1, 40)
    network.log.clear()
    body = b""
    for number in range(200):
        other = ids.VENDOR + struct.pack("<Qxx", number)
        data = ParticipantData(
            other + ids.ENTITY_PARTICIPANT, domain=0, builtin=0x3F,
            metatraffic_unicast=[Locator(UDPV4, 7410, "10.0.0.66")],
        )  # fmt: skip
        body += raw(ids.INFO_SRC, NO_ENTITY + ids.VERSION + ids.VENDOR + other)
        body += announcement(data)[20:]
    Stranger(network, one).send(body)
    assert len(one.remotes) == 200
    network.step(0.1, 100)
    assert octets_to(network, "10.0.0.66") <= len(body) + 20


def test_octets_from_a_foreign_address_do_not_count_as_those_of_a_participant(network):
    one = network.add(1)
    victim = Stranger(network, one)
    victim.announce()
    (known,) = one.remotes.values()
    before = known.received
    victim.send(bytes(1000), address="10.0.0.67")
    assert known.received == before
    victim.send(bytes(1000))
    assert known.received > before


def test_no_farewell_goes_to_participants_that_have_not_answered(network):
    one = network.add(1)
    stranger = Stranger(network, one)
    stranger.announce()
    network.step(0.1, 100)
    network.log.clear()
    (known,) = one.remotes.values()
    known.received = 0
    one.close()
    network.log += [("10.0.0.1", *item) for item in one.take_datagrams()]
    assert octets_to(network, GROUP.address) and not octets_to(network, "10.0.0.66")


def test_addresses_that_a_participant_was_heard_from_are_limited(network):
    """A participant that announces further addresses again and again, and is heard from each."""
    one = network.add(1)
    stranger = Stranger(network, one)
    stranger.announce()
    for number in range(100):
        address = f"10.1.0.{number}"
        place = [Locator(UDPV4, 7410, stranger.address), Locator(UDPV4, 7410, address)]
        stranger.announce(metatraffic_unicast=place)
        stranger.address = address
        stranger.announce(metatraffic_unicast=place)
    (known,) = one.remotes.values()
    assert len(known.heard) <= remote.MAX_ADDRESSES


def test_all_readers_together_get_repetitions_at_a_limited_rate(network, stranger):
    """CVE-2021-38447 (OpenDDS): traffic without end is requested by small datagrams."""
    one = stranger.target
    prove(stranger)
    readers = [stranger.endpoint("rt/big", False) for _ in range(1)]
    stranger.count = 0
    readers += [stranger.endpoint("rt/big", False) for _ in range(40)]
    sender = writer_of(network, one, topic="rt/big", qos=QoSProfile(depth=100))
    for _ in range(50):
        sender.write(cdr(1, 20_000), 0, network.now)
    network.now += 2.0
    sent = 0
    for turn in range(100):
        stranger.send(*(
            submessages.encode_acknack(guid[12:], sender.data.guid[12:], 1, range(1, 51), turn + 1)
            for guid in readers
        ))  # fmt: skip
        one.poll(network.now)
        sent += sum(
            len(item) for item, place in one.take_datagrams() if place.address == "10.0.0.66"
        )
        network.now += 0.002
    allowed = writer._REPEAT_BURST + 0.2 * writer._REPEAT_RATE
    assert 1_000_000 < sent < 1.2 * allowed + 100 * writer._RESEND_OCTETS / 10


def test_a_reader_that_asks_without_end_does_not_keep_others_from_their_samples(network, stranger):
    one = stranger.target
    prove(stranger)
    sender = writer_of(network, one, topic="rt/big", qos=QoSProfile(depth=200))
    hostile = stranger.endpoint("rt/big", False)
    friend = network.add(2)
    inbox = Inbox(network, friend, topic="rt/big")
    network.until(lambda: sender.matched() == 2 and inbox.reader.state.writers)
    network.loss = 0.3
    for number in range(100):
        sender.write(cdr(number, 20_000), 0, network.now)
    for count in range(3000):
        stranger.send(submessages.encode_acknack(
            hostile[12:], sender.data.guid[12:], 1, range(1, 101), count + 1
        ))  # fmt: skip
        network.step(0.01)
        if len(inbox.samples) == 100:
            break
    assert inbox.samples == [cdr(number, 20_000) for number in range(100)]


# --- names of others ------------------------------------------------------------------------------


def test_a_forged_farewell_does_not_disconnect_a_participant(network):
    """CVE-2023-50257 (Fast DDS): a disposal with the GUID of another, even with SROS 2."""
    one, two = pair(network)
    sender, inbox = writer_of(network, one), Inbox(network, two)
    network.until(sender.matched)
    farewells = [
        announcement(ParticipantData(two.guid), parameters.write_farewell_qos(two.guid), True,
                     parameters.write_key(two.guid)),
        # Without a payload, with the key hash alone, and through INFO_SRC of another.
        submessages.header(prefix(2)) + submessages.encode_data(
            ids.SPDP_READER, ids.SPDP_WRITER, 1, None, parameters.write_farewell_qos(two.guid)
        ),
    ]  # fmt: skip
    farewells.append(
        submessages.header(prefix(66))
        + raw(ids.INFO_SRC, NO_ENTITY + ids.VERSION + ids.VENDOR + prefix(2))
        + farewells[0][20:]
    )
    for farewell in farewells:
        network.inject("10.0.0.66", farewell, one)
    assert set(one.remotes) == {prefix(2)} and sender.matched() == 1
    sender.write(cdr(1), 0, network.now)
    network.until(lambda: inbox.samples)


def test_a_participant_ends_endpoints_of_its_own_alone(network, stranger):
    one = stranger.target
    friend = network.add(2)
    sender = writer_of(network, friend)
    network.until(lambda: len(network.inbox.reader.state.writers) == 2)
    farewell = submessages.encode_data(
        NO_ENTITY, ids.PUBLICATIONS_WRITER, 2, parameters.write_key(sender.data.guid),
        parameters.write_farewell_qos(sender.data.guid), True,
    )  # fmt: skip
    stranger.send(farewell)
    assert sender.data.guid in network.inbox.reader.state.writers
    assert sender.data.guid in one.remotes[prefix(2)].endpoints


@pytest.mark.parametrize("through", ["header", "INFO_SRC"])
def test_somebody_with_our_own_prefix_is_not_heard(network, through):
    """Two participants with one GUID, of which one is ours: we do not match ourselves."""
    one, two = pair(network)
    sender, inbox = writer_of(network, one), Inbox(network, two)
    network.until(sender.matched)
    ours = ParticipantData(
        one.guid, domain=0, builtin=0x3F,
        metatraffic_unicast=[Locator(UDPV4, 7410, "10.0.0.66")],
    )  # fmt: skip
    if through == "header":
        network.inject("10.0.0.66", announcement(ours), one)
    else:
        source = raw(ids.INFO_SRC, NO_ENTITY + ids.VERSION + ids.VENDOR + prefix(1))
        Stranger(network, one).send(source + announcement(ours)[20:])
    assert set(one.remotes) == {prefix(2)}
    # Others keep to the address that they know.
    network.inject("10.0.0.66", announcement(ours), two)
    assert two.remotes[prefix(1)].heard == {"10.0.0.1": None}
    sender.write(cdr(1), 0, network.now)
    network.until(lambda: inbox.samples)


# --- octets that are not valid --------------------------------------------------------------------


MALFORMED = {
    # CVE-2023-39534 (Fast DDS): a GAP whose set begins before it. CVE-2023-39949: sequence numbers
    # that cannot be, in HEARTBEAT, DATA, ACKNACK.
    "gap before its start": raw(
        ids.GAP, NO_ENTITY + b"\0\0\5\3" + struct.pack("<iIiII", 0, 9, 0, 3, 0)
    ),
    "gap of zero": raw(ids.GAP, NO_ENTITY + b"\0\0\5\3" + struct.pack("<iIiII", 0, 0, 0, 3, 0)),
    "gap of negative numbers": raw(
        ids.GAP, NO_ENTITY + b"\0\0\5\3" + struct.pack("<iIiII", -1, 9, -1, 9, 0)
    ),
    "heartbeat from zero": raw(
        ids.HEARTBEAT, NO_ENTITY + b"\0\0\5\3" + struct.pack("<iIiII", 0, 0, 0, 3, 1)
    ),
    "heartbeat that ends before it begins": raw(
        ids.HEARTBEAT, NO_ENTITY + b"\0\0\5\3" + struct.pack("<iIiII", 0, 9, 0, 3, 1)
    ),
    "heartbeat of negative numbers": raw(
        ids.HEARTBEAT, NO_ENTITY + b"\0\0\5\3" + struct.pack("<iIiII", -2, 0, -1, 0, 1)
    ),
    "data of negative number": raw(
        ids.DATA, struct.pack("<HH4s4siI", 0, 16, NO_ENTITY, b"\0\0\5\3", -1, 7), flags=5
    ),
    # CVE-2020-18734 (Cyclone): bitmaps beyond 256 bits. CVE-2021-38435, -38423: sizes that are not
    # those of the octets.
    "bitmap of 2^32 - 1 bits": raw(
        ids.NACK_FRAG, NO_ENTITY + b"\0\0\5\3" + struct.pack("<iIIII", 0, 1, 1, 0xFFFFFFFF, 0)
    ),
    "bitmap without its words": raw(
        ids.ACKNACK, NO_ENTITY + b"\0\0\5\3" + struct.pack("<iII", 0, 1, 256)
    ),
    "submessage longer than the datagram": raw(ids.DATA, bytes(24), length=0xFFFC),
    # CVE-2023-42459 (Fast DDS): DATA with neither payload nor inline QoS behind its flags.
    "flags without what they announce": raw(
        ids.DATA, struct.pack("<HH4s4siI", 0, 0x9210, NO_ENTITY, ids.SPDP_WRITER, 0, 2), flags=0x17
    ),
    # CVE-2024-28231, -30259 (Fast DDS): inline QoS that ends behind its submessage.
    "inline QoS longer than DATA": raw(
        ids.DATA,
        struct.pack("<HH4s4siI", 0, 16, NO_ENTITY, b"\0\0\5\3", 0, 1)
        + parameter(ids.PID_KEY_HASH, bytes(8), 0xFFF0),
        flags=7,
    ),
    "inline QoS without an end": raw(
        ids.DATA,
        struct.pack("<HH4s4siI", 0, 16, NO_ENTITY, b"\0\0\5\3", 0, 1)
        + parameter(ids.PID_KEY_HASH, bytes(16)),
        flags=7,
    ),
    # CVE-2023-50716 (Fast DDS): DATA_FRAG whose inline QoS or sizes contradict its octets.
    "fragment with inline QoS beyond its octets": raw(
        ids.DATA_FRAG,
        struct.pack("<HH4s4siIIHHI", 0, 28, NO_ENTITY, b"\0\0\5\3", 0, 1, 1, 1, 100, 200)
        + parameter(ids.PID_KEY_HASH, bytes(4), 0x7FFC),
        flags=3,
    ),
    "fragment of 4 GB in fragments of no octets": raw(
        ids.DATA_FRAG,
        struct.pack("<HH4s4siIIHHI", 0, 28, NO_ENTITY, b"\0\0\5\3", 0, 1, 1, 1, 0, 0xFFFFFFFF),
    ),
    "more locators than octets": raw(ids.INFO_REPLY, struct.pack("<I", 0xFFFFFFFF)),
}  # fmt: skip


@pytest.mark.parametrize("name", MALFORMED)
def test_a_submessage_that_is_not_valid_is_counted_and_changes_nothing(network, stranger, name):
    """CVE-2023-39534, -39949, -42459, -50716, CVE-2024-28231, -30258, -30259, CVE-2020-18734,
    CVE-2021-38423, -38435: crashes by one submessage."""
    one = stranger.target
    before = one.malformed
    stranger.send(MALFORMED[name])
    stranger.send(submessages.encode_info_dst(prefix(1)), MALFORMED[name])
    network.inject("10.0.0.77", submessages.header(prefix(77)) + MALFORMED[name], one)
    assert one.malformed > before
    assert network.inbox.samples == [] and proxy_of(network, stranger).expected is None
    assert works(network, one)


PARAMETERS = {
    # CVE-2021-38445 (OpenDDS): the length of PID_BUILTIN_ENDPOINT_QOS; CVE-2023-37915 (OpenDDS),
    # -39946, -39947 (Fast DDS): of PID_PROPERTY_LIST and the strings in it.
    "longer than the list": parameter(0x0077, bytes(4), 0xFFFC),
    "properties without end": parameter(0x0059, struct.pack("<II", 1, 0xFFFFFFF0) + b"name"),
    "2^32 - 1 properties": parameter(0x0059, struct.pack("<I", 0xFFFFFFFF) + bytes(8)),
    # CVE-2023-39945, -39948 (Fast DDS): what a CDR reader refuses raises an error that nobody
    # catches.
    "user data longer than its octets": parameter(ids.PID_USER_DATA, struct.pack("<I", 5000)),
    "text without its end": parameter(ids.PID_DOMAIN_TAG, struct.pack("<I", 4) + b"abcd"),
    "text that is not UTF-8": parameter(
        ids.PID_DOMAIN_TAG, struct.pack("<I", 4) + b"\xff\xfe\xfd\0"
    ),
    "text of 2^31 octets": parameter(ids.PID_DOMAIN_TAG, struct.pack("<I", 1 << 31)),
    "a short locator": parameter(ids.PID_DEFAULT_UNICAST_LOCATOR, bytes(8)),
    "a short GUID": parameter(ids.PID_PARTICIPANT_GUID, bytes(8)),
    "a short lease": parameter(ids.PID_PARTICIPANT_LEASE_DURATION, b"\1\0\0\0"),
    "no octets": parameter(ids.PID_BUILTIN_ENDPOINT_SET, b""),
    "2^32 - 1 partitions": parameter(ids.PID_PARTITION, struct.pack("<I", 0xFFFFFFFF)),
    "partitions that overlap": parameter(
        ids.PID_PARTITION, struct.pack("<III", 64, 0xFFFFFFFC, 4)
    ),
    "2^32 - 1 representations": parameter(
        ids.PID_DATA_REPRESENTATION, struct.pack("<I", 0xFFFFFFFF)
    ),
    "a bad kind of history": parameter(0x0040, struct.pack("<iI", -7, 0)),
    "a negative lease": parameter(ids.PID_PARTICIPANT_LEASE_DURATION, struct.pack("<iI", -9, 0)),
    "a thousand parameters": parameter(ids.PID_PAD, b"") * 1000,
}  # fmt: skip


@pytest.mark.parametrize("name", PARAMETERS)
@pytest.mark.parametrize("where", ["SPDP", "publications", "subscriptions", "inline QoS"])
def test_a_parameter_that_is_not_valid_ends_nothing_but_its_list(network, stranger, name, where):
    """CVE-2021-38445, CVE-2023-37915, -39945, -39946, -39947, -39948, CVE-2024-26369, -30916,
    -30917: crashes by one parameter of discovery data."""
    one = stranger.target
    bad = PARAMETERS[name]
    own = parameter(ids.PID_PARTICIPANT_GUID, stranger.prefix + ids.ENTITY_PARTICIPANT)
    sentinel = parameter(ids.PID_SENTINEL, b"")
    if where == "SPDP":
        stranger.send(spdp(own + bad + sentinel))
        other = Stranger(network, one, 67, "10.0.0.67")
        guid = parameter(ids.PID_PARTICIPANT_GUID, other.prefix + ids.ENTITY_PARTICIPANT)
        other.send(spdp(guid + bad + sentinel))
    elif where == "inline QoS":
        stranger.send(submessages.encode_data(
            NO_ENTITY, stranger.writer[12:], 1, cdr(1), bad + sentinel
        ))  # fmt: skip
    else:
        entity = ids.PUBLICATIONS_WRITER
        if where == "subscriptions":
            entity = ids.SUBSCRIPTIONS_WRITER
            stranger.send(submessages.encode_heartbeat(NO_ENTITY, entity, 2, 1, 1))
        guid = parameter(ids.PID_ENDPOINT_GUID, stranger.prefix + b"\0\0\x09\3")
        topic = parameter(ids.PID_TOPIC_NAME, struct.pack("<I", 3) + b"rt\0\0")
        type_name = parameter(ids.PID_TYPE_NAME, struct.pack("<I", 3) + b"ty\0\0")
        stranger.send(spdp(guid + topic + type_name + bad + sentinel, entity))
    network.step(0.1, 5)
    assert works(network, one)


def test_numbers_at_the_end_of_64_bits_are_refused(network, stranger):
    """Behind them no acknowledgement can be written (CVE-2023-39949 is about such numbers)."""
    entity = stranger.writer[12:]
    last = (1 << 63) - 1
    before = stranger.target.malformed
    for hostile in (
        submessages.encode_heartbeat(NO_ENTITY, entity, last, last, 2),
        submessages.encode_gap(NO_ENTITY, entity, 1, last, [last]),
        submessages.encode_data(NO_ENTITY, entity, last, cdr(1)),
        submessages.encode_acknack(b"\0\0\1\4", b"\0\0\1\3", last, [last], 1),
        submessages.encode_nack_frag(b"\0\0\1\4", b"\0\0\1\3", last, [1], 1),
        encode_heartbeat_frag(NO_ENTITY, entity, last, 1, 1),
    ):
        stranger.send(hostile)
    assert stranger.target.malformed == before + 6
    # The largest that is accepted, delivered, and acknowledged.
    top = submessages.MAX_NUMBER
    stranger.send(submessages.encode_heartbeat(NO_ENTITY, entity, top, top, 3))
    stranger.send(submessages.encode_data(NO_ENTITY, entity, top, cdr(7)))
    stranger.send(submessages.encode_gap(NO_ENTITY, entity, top, top, range(top, top + 0)))
    stranger.send(submessages.encode_heartbeat(NO_ENTITY, entity, top, top, 4))
    network.step(0.1, 5)
    assert network.inbox.samples == [cdr(7)]


def test_a_sample_that_is_not_valid_is_not_requested_again_and_again(network):
    """Found by the fuzzer: request and repetition went on at the speed of the network."""
    one, two = pair(network)
    sender, inbox = writer_of(network, one), Inbox(network, two)
    network.until(lambda: sender.matched() and inbox.reader.state.writers)
    sender.write(cdr(1), 0, network.now, parameter(ids.PID_RELATED_SAMPLE_IDENTITY, bytes(8)) + (
        parameter(ids.PID_SENTINEL, b"")
    ))  # fmt: skip
    sender.write(cdr(2), 0, network.now)
    network.until(lambda: inbox.samples)
    network.step(0.05, 20)
    assert inbox.samples == [cdr(2)] and is_acknowledged(sender.state)


def test_a_sample_that_is_refused_is_requested_less_and_less_often(network):
    one, two = pair(network)
    sender = writer_of(network, one)
    inbox = Inbox(network, two)
    network.until(lambda: sender.matched() and inbox.reader.state.writers)
    inbox.reader.state._deliver = lambda sample: False
    network.log.clear()
    sender.write(cdr(1), 0, network.now)
    for _ in range(4000):
        network.step(0.001)
    assert len(network.log) < 150  # in 4 s, both ways


# --- memory ---------------------------------------------------------------------------------------


def test_each_holder_may_have_as_much_as_remains_free():
    budget = OctetBudget(1000)
    held = Counter()
    for holder in "abc":
        while budget.take(10, holder):
            held[holder] += 10
    assert held == {"a": 500, "b": 250, "c": 130}
    assert not budget.take(500, "d") and budget.take(60, "d")
    budget.give_back(500, "a")
    assert budget.take(200, "d") and budget.used == 640
    for holder, octets in (("b", 250), ("c", 130), ("d", 260)):
        budget.give_back(octets, holder)
    assert budget.used == 0 and not budget._used_by


def test_what_is_known_of_all_participants_is_limited_in_octets(network):
    """Thousands of participants with thousands of endpoints, each with long USER_DATA."""
    one = network.add(1)
    one._known.limit = 500_000
    for number in range(60, 90):
        stranger = Stranger(network, one, number, f"10.0.0.{number}")
        stranger.announce(user_data=bytes(8000))
        for _ in range(10):
            stranger.endpoint("rt/" + 200 * "x", True)
    assert one._known.used <= 500_000 < 30 * 10 * 2500
    known = sum(
        remote.cost(other.data) + sum(map(remote.cost, other.endpoints.values()))
        for other in one.remotes.values()
    )
    assert known == one._known.used
    # One that would grow stays as it was, and one that goes leaves its room to others.
    first = next(iter(one.remotes.values()))
    assert len(first.endpoints) == 10
    for other in list(one.remotes.values()):
        one._forget(other)
    assert one._known.used == 0 and works(network, one)


def test_announcements_that_change_are_accounted_anew(network):
    one = network.add(1)
    stranger = Stranger(network, one)
    for size in (10, 5000, 0, 8000):
        stranger.announce(user_data=bytes(size))
        (known,) = one.remotes.values()
        assert len(known.data.user_data) == size and one._known.used == remote.cost(known.data)
    one._known.limit = 9000
    stranger.announce(user_data=bytes(8192))
    assert len(known.data.user_data) == 8000 and one._known.used == remote.cost(known.data)


def test_one_address_has_a_limited_part_of_the_participants(network, monkeypatch):
    """One machine announces participants without end; those of others still find a place."""
    monkeypatch.setattr(participant, "MAX_PARTICIPANTS_OF_ADDRESS", 5)
    one = network.add(1)
    for number in range(60, 80):
        Stranger(network, one, number, "10.0.0.66").announce()
    assert len(one.remotes) == 5 and works(network, one)


def test_participants_that_never_answer_make_room_for_others(network, monkeypatch):
    """Announcements with forged addresses fill all places."""
    monkeypatch.setattr(participant, "MAX_PARTICIPANTS", 5)
    one, two = pair(network)
    network.step(0.1, 5)
    for number in range(60, 80):
        Stranger(network, one, number, f"10.0.0.{number}").announce()
    assert len(one.remotes) == 5
    network.step(0.2, 10)
    assert works(network, one) and prefix(2) in one.remotes


def test_incomplete_samples_of_one_participant_leave_room_for_others(network, stranger):
    """CVE-2021-38447 (OpenDDS): fragments that never become whole fill the memory."""
    one = stranger.target
    one._budget.limit = 4_000_000
    entity = stranger.writer[12:]
    stranger.send(submessages.encode_heartbeat(NO_ENTITY, entity, 1, 8, 1))
    for number in range(1, 9):
        for first in range(1, 500):
            stranger.send(submessages.encode_data_frag(
                NO_ENTITY, entity, number, first, 1000, 1_500_000, bytes(1000)
            ))  # fmt: skip
    assert 1_500_000 < one._budget.used <= 2_000_000
    friend = network.add(2)
    inbox = Inbox(network, one, topic="rt/big")
    sender = writer_of(network, friend, topic="rt/big")
    network.until(lambda: sender.matched() and inbox.reader.state.writers)
    sender.write(cdr(1, 700_000), 0, network.now)
    network.until(lambda: inbox.samples)
    assert inbox.samples == [cdr(1, 700_000)]


@pytest.mark.parametrize(
    ("sample", "fragment"), [(0xFFFFFFFF, 60_000), (1 << 26, 60_000), (1 << 20, 1), (1 << 24, 64)]
)
def test_a_sample_that_can_never_be_whole_is_passed_over(network, stranger, sample, fragment):
    """It must neither take memory (CVE-2021-38435: sizes) nor be requested without end."""
    entity = stranger.writer[12:]
    stranger.send(submessages.encode_heartbeat(NO_ENTITY, entity, 1, 2, 1))
    stranger.send(submessages.encode_data_frag(
        NO_ENTITY, entity, 1, 1, fragment, sample, bytes(fragment)
    ))  # fmt: skip
    stranger.send(submessages.encode_data(NO_ENTITY, entity, 2, cdr(2)))
    assert network.inbox.samples == [cdr(2)]
    assert stranger.target._budget.used < 1000


def test_a_reader_that_never_acknowledges_does_not_stop_a_writer_that_keeps_all(network, stranger):
    """It announces itself for ever: no lease ends it."""
    one = stranger.target
    prove(stranger)
    stranger.count = 0
    silent = stranger.endpoint("rt/all", False)
    qos = QoSProfile(history=HistoryPolicy.KEEP_ALL)
    sender = writer_of(network, one, topic="rt/all", qos=qos)
    friend = network.add(2)
    inbox = Inbox(network, friend, topic="rt/all", qos=qos)
    network.until(lambda: sender.matched() == 2 and inbox.reader.state.writers)
    count = 0
    while sender.write(cdr(count), 0, network.now):
        count += 1
    assert count == 5000
    for _ in range(30):
        stranger.announce()
        network.step(0.5)
    assert silent in sender.state.readers
    assert sender.write(cdr(count), 0, network.now)
    network.until(lambda: len(inbox.samples) == 5001)
    assert inbox.samples == [cdr(number) for number in range(5001)]
    # When it acknowledges at last, it is told what it will not get, and counts again.
    stranger.send(submessages.encode_acknack(silent[12:], sender.data.guid[12:], 1, [1], 1))
    network.log.clear()
    network.step(0.1, 2)
    sent = [item for _, item, place in network.log if place.address == "10.0.0.66"]
    assert any(
        isinstance(part, submessages.Gap)
        for item in sent for part in submessages.read(memoryview(item))
    )  # fmt: skip


def test_the_history_of_a_writer_that_keeps_all_is_limited_in_octets(network, monkeypatch):
    monkeypatch.setattr(writer, "MAX_HISTORY", 1_000_000)
    one, two = pair(network)
    qos = QoSProfile(history=HistoryPolicy.KEEP_ALL)
    sender, inbox = writer_of(network, one, qos=qos), Inbox(network, two, qos=qos)
    network.until(lambda: sender.matched() and inbox.reader.state.writers)
    count = 0
    while sender.write(cdr(count, 100_000), 0, network.now):
        count += 1
    assert count == 10
    network.until(lambda: len(inbox.samples) == 10)
    network.step(0.1, 5)
    assert sender.write(cdr(count, 100_000), 0, network.now)


# --- time -----------------------------------------------------------------------------------------


def filled(parts):
    """A datagram of the largest size of these submessages, and how many they are."""
    body, count = b"", 0
    for part in parts:
        if len(body) + len(part) > LARGEST:
            return body, count
        body += part
        count += 1
    return body, count


class Calls:
    """Counts calls of a method of a class."""

    def __init__(self, monkeypatch, owner, name):
        self.count = 0
        method = getattr(owner, name)

        def counted(*arguments, **named):
            self.count += 1
            return method(*arguments, **named)

        monkeypatch.setattr(owner, name, counted)


def test_a_gap_of_any_width_costs_little(network, stranger, monkeypatch):
    """CVE-2025-64438 (Fast DDS): each number of a GAP of 2^60 numbers was noted."""
    entity = stranger.writer[12:]
    stranger.send(submessages.encode_heartbeat(NO_ENTITY, entity, 1, 10, 1))
    calls = Calls(monkeypatch, reader.StatefulReader, "_pass_over")
    body, count = filled(
        submessages.encode_gap(NO_ENTITY, entity, 3, 1 << 60) for _ in range(10_000)
    )
    stranger.send(body)
    assert count > 1900 and calls.count <= count * reader._MAX_NOTED
    assert len(proxy_of(network, stranger).held) <= reader._MAX_NOTED
    # What it did not note is asked for in its turn; the gap counts when its start comes.
    stranger.send(submessages.encode_data(NO_ENTITY, entity, 1, cdr(1)))
    stranger.send(submessages.encode_data(NO_ENTITY, entity, 2, cdr(2)))
    stranger.send(submessages.encode_gap(NO_ENTITY, entity, 3, 1 << 60))
    assert network.inbox.samples == [cdr(1), cdr(2)]
    assert proxy_of(network, stranger).expected == 1 << 60


def test_heartbeats_that_rise_by_one_do_not_search_all_that_is_held(network, stranger):
    entity = stranger.writer[12:]
    stranger.send(submessages.encode_heartbeat(NO_ENTITY, entity, 1, 4000, 1))
    proxy = proxy_of(network, stranger)

    class Held(dict):
        searches = 0

        def __iter__(self):
            Held.searches += 1
            return super().__iter__()

    proxy.held = Held()
    for number in range(2500, 4090):
        stranger.send(submessages.encode_data(NO_ENTITY, entity, number, cdr(number)))
    body, count = filled(
        submessages.encode_heartbeat(NO_ENTITY, entity, number, 4000, number)
        for number in range(2, 10_000)
    )
    stranger.send(body)
    assert count > 1900 and Held.searches < 10
    assert proxy.lost == proxy.expected - 1 and not network.inbox.samples


def test_acknowledgements_in_one_datagram_are_answered_once(network, stranger):
    """A thousand requests for 256 samples each, with counters that rise."""
    one = stranger.target
    prove(stranger)
    stranger.count = 0
    asking = stranger.endpoint("rt/big", False)
    sender = writer_of(network, one, topic="rt/big", qos=QoSProfile(depth=300))
    for number in range(300):
        sender.write(cdr(number, 1000), 0, network.now)
    network.step(0.5, 5)
    body, count = filled(
        submessages.encode_acknack(asking[12:], sender.data.guid[12:], 1, range(1, 257), number + 1)
        for number in range(10_000)
    )
    network.log.clear()
    stranger.send(body)
    one.poll(network.now)
    sent = sum(len(item) for item, _ in one.take_datagrams())
    assert count > 900 and sent <= writer._RESEND_OCTETS + 5000


def test_requests_for_fragments_in_one_datagram_are_answered_once(network, stranger):
    """The same with NACK_FRAG, for fragments beyond the last one too."""
    one = stranger.target
    prove(stranger)
    stranger.count = 0
    asking = stranger.endpoint("rt/big", False)
    sender = writer_of(network, one, topic="rt/big")
    sender.write(cdr(1, 1_000_000), 0, network.now)
    network.step(0.5, 5)
    body, count = filled(
        submessages.encode_nack_frag(
            asking[12:], sender.data.guid[12:], 1,
            range(1 + number * 256, 257 + number * 256), number + 1,
        )
        for number in range(10_000)
    )  # fmt: skip
    one.take_datagrams()
    stranger.send(body)
    one.poll(network.now)
    sent = sum(len(item) for item, _ in one.take_datagrams())
    assert count > 900 and sent <= writer._RESEND_OCTETS + 5000
    (proxy,) = sender.state.readers.values()
    assert sum(map(len, proxy.fragments.values())) <= 1 + 1_000_000 // 1000


def test_a_participant_with_thousands_of_endpoints_is_forgotten_in_one_pass(network, monkeypatch):
    one = network.add(1)
    senders = [writer_of(network, one, topic="rt/many") for _ in range(5)]
    stranger = Stranger(network, one)
    stranger.announce()
    for _ in range(500):
        # Entity ids of the helper have one octet.
        number = stranger.count + 2
        guid = stranger.prefix + struct.pack(">I", number << 8 | 4)
        stranger.endpoint("rt/many", False, guid=guid)
    assert senders[0].matched() == 500
    calls = Calls(monkeypatch, writer.StatefulWriter, "_trim")
    stranger.send(announcement(
        ParticipantData(stranger.prefix + ids.ENTITY_PARTICIPANT),
        parameters.write_farewell_qos(stranger.prefix + ids.ENTITY_PARTICIPANT), True,
        parameters.write_key(stranger.prefix + ids.ENTITY_PARTICIPANT),
    )[20:])  # fmt: skip
    assert not one.remotes and senders[0].matched() == 0
    assert calls.count <= len(one.writers)


def test_data_for_nobody_is_parsed_and_dropped(network, stranger):
    """Thousands of submessages for writers and readers that do not exist, and unknown kinds."""
    one = stranger.target
    for part in (
        submessages.encode_data(NO_ENTITY, b"\0\0\x77\3", 1, None),
        submessages.encode_heartbeat(NO_ENTITY, b"\0\0\x77\3", 1, 1, 1),
        submessages.encode_acknack(b"\0\0\x77\4", b"\0\0\x77\3", 1, (1,), 1),
        raw(0x80, bytes(4)),
        raw(ids.PAD, b""),
        submessages.encode_info_ts(None),
    ):
        stranger.send(part * (LARGEST // len(part)))
    assert not one._budget.used and not network.inbox.samples
    assert works(network, one)


def test_a_participant_that_comes_and_goes_leaves_nothing(network):
    one = network.add(1)
    sender = writer_of(network, one)
    stranger = Stranger(network, one)
    guid = stranger.prefix + ids.ENTITY_PARTICIPANT
    for _ in range(50):
        stranger.announce()
        stranger.count = 0
        stranger.endpoint("rt/chatter", False)
        assert sender.matched() == 1
        stranger.send(announcement(
            ParticipantData(guid), parameters.write_farewell_qos(guid), True,
            parameters.write_key(guid),
        )[20:])  # fmt: skip
    assert not one.remotes and one._known.used == 0 and one._budget.used == 0
    assert not sender.state.readers and not one._outbox._pending


def test_an_announcement_of_topics_in_any_number_matches_none_of_ours(network):
    one = network.add(1)
    inbox = Inbox(network, one, qos=BEST_EFFORT)
    stranger = Stranger(network, one)
    stranger.announce()
    for number in range(100):
        data = EndpointData(
            stranger.prefix + bytes([0, 1, number, 3]), True, f"rt/{number}", TYPE, QoSProfile()
        )
        stranger.send(
            submessages.encode_heartbeat(
                NO_ENTITY, ids.PUBLICATIONS_WRITER, number + 1, number + 1, number + 1
            ),
            submessages.encode_data(
                NO_ENTITY, ids.PUBLICATIONS_WRITER, number + 1, parameters.write_endpoint(data)
            ),
        )
    assert not inbox.reader.state.writers and len(one.remotes[stranger.prefix].endpoints) == 100


def test_patterns_of_partitions_are_kept_by_nothing_but_the_account(network, stranger):
    """Attack: one endpoint that is announced again and again, with other patterns each time."""
    guid = stranger.prefix + bytes([0, 1, 0, 3])
    used = []
    tracemalloc.start()
    try:
        for number in range(20):
            patterns = tuple(f"*{number}*{each}" + "*a" * 250 for each in range(60))
            stranger.endpoint("rt/chatter", True, guid, qos=QoSProfile(partitions=patterns))
            used.append(tracemalloc.get_traced_memory()[0])
    finally:
        tracemalloc.stop()
    assert guid in stranger.target.remotes[stranger.prefix].endpoints
    assert guid not in network.inbox.reader.state.writers
    assert used[-1] - used[4] < 100_000


@pytest.mark.parametrize("depth", [0, 1, 2**31 - 1])
def test_any_depth_of_a_profile_is_served(network, depth):
    """CVE-2024-26369 (Fast DDS): a depth of its own profile made a receiver abort."""
    one, two = pair(network)
    qos = QoSProfile(depth=depth)
    sender, inbox = writer_of(network, one, qos=qos), Inbox(network, two, qos=qos)
    network.until(lambda: sender.matched() and inbox.reader.state.writers)
    for number in range(5):
        sender.write(cdr(number), 0, network.now)
        network.step(0.1)
    assert inbox.samples == [cdr(number) for number in range(5)]


def test_readers_take_turns_where_the_rate_of_repetitions_is_used_up(monkeypatch):
    monkeypatch.setattr(writer, "_REPEAT_RATE", 1_000_000)
    monkeypatch.setattr(writer, "_REPEAT_BURST", 1000)
    state = writer.StatefulWriter(prefix(1) + b"\0\0\1\3", True, False, None, 1200)
    hostile, other = prefix(2) + b"\0\0\1\4", prefix(3) + b"\0\0\1\4"
    now = 100.0
    for guid in (hostile, other):
        state.match(guid, True, False, now)
        state.on_acknack(guid, submessages.AckNack(guid[12:], b"", 1, (), 1, True), now)
    for number in range(100):
        state.write(cdr(number, 1000), 0, now)
    everything = tuple(range(1, 101))
    asks = submessages.AckNack(other[12:], b"", 1, everything, 2, True)
    state.on_acknack(other, asks, now)
    got = 0
    for count in range(400):
        asks = submessages.AckNack(hostile[12:], b"", 1, everything, count + 2, True)
        state.on_acknack(hostile, asks, now)
        got += sum(
            packet.reader == other and packet.time_ns is not None for packet in state.poll(now)
        )
        now += 0.001
    assert got == 100
