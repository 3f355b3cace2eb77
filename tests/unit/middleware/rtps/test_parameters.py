"""Parameter lists: discovery data that Fast DDS and Cyclone sent, and round trips of our own.

The vectors are those of test_submessages: what tshark's dissector reads is compared.
"""

import json
import struct
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from uros.middleware.guid import FAST_DDS
from uros.middleware.rtps import ids, parameters
from uros.middleware.rtps.kinds import Data
from uros.middleware.rtps.locators import UDPV4, UDPV6, Locator
from uros.middleware.rtps.parameters import (
    EndpointData,
    ParticipantData,
    read_endpoint,
    read_inline_qos,
    read_key,
    read_participant,
    write_endpoint,
    write_participant,
)
from uros.middleware.rtps.submessages import MalformedError, read
from uros.qos import (
    DurabilityPolicy,
    HistoryPolicy,
    LivelinessPolicy,
    QoSProfile,
    ReliabilityPolicy,
)

VECTORS = json.loads((Path(__file__).parent / "vectors.json").read_text("utf-8"))
PREFIX = bytes(range(1, 13))
GUID = PREFIX + ids.ENTITY_PARTICIPANT
ENDPOINTS = {ids.PUBLICATIONS_WRITER: True, ids.SUBSCRIPTIONS_WRITER: False}


def recorded():
    """(DATA, its fields as tshark prints them) of each recorded DATA with a parameter list."""
    for vector in VECTORS:
        datagram = memoryview(bytes.fromhex(vector["datagram"]))
        known = [pair for pair in vector["submessages"] if pair[0] != "0x80"]
        for submessage, (_, pairs) in zip(read(datagram), known, strict=True):
            if isinstance(submessage, Data) and submessage.payload is not None:
                yield vector["source"], submessage, pairs


DISCOVERY = [
    pytest.param(data, pairs, id=f"{source}-{data.writer.hex()}-{number}")
    for number, (source, data, pairs) in enumerate(recorded())
    if data.writer in (ids.SPDP_WRITER, *ENDPOINTS)
]


def values(pairs, name):
    return [value for key, value in pairs if key == name]


def test_there_are_participants_writers_and_readers_of_both_vendors():
    kinds = {(source.split()[0], data.writer, data.is_key) for source, data, _ in recorded()}
    for vendor in ("Fast", "Cyclone"):
        for writer in (ids.SPDP_WRITER, *ENDPOINTS):
            assert (vendor, writer, False) in kinds
        assert (vendor, ids.SPDP_WRITER, True) in kinds


@pytest.mark.parametrize(("data", "pairs"), DISCOVERY)
def test_recorded_discovery_data_is_read_as_tshark_reads_it(data, pairs):
    if data.is_key:
        (guid,) = set(
            values(pairs, "param.participant_guid") + values(pairs, "param.endpoint_guid")
        )
        assert read_key(data.payload).hex(":") == guid
        assert read_inline_qos(data.inline_qos, data.little).status == 3
    elif data.writer == ids.SPDP_WRITER:
        compare_participant(read_participant(data.payload), pairs)
    else:
        compare_endpoint(read_endpoint(data.payload, ENDPOINTS[data.writer]), pairs)


def compare_participant(found, pairs):
    assert found.guid.hex(":") == values(pairs, "param.participant_guid")[0]
    assert found.builtin == int(values(pairs, "param.builtin_endpoint_set")[0], 16)
    seconds = int(values(pairs, "param.ntpTime.sec")[0])
    assert found.lease_ms == seconds * 1000
    shown = zip(
        values(pairs, "locator.kind"), values(pairs, "locator.ipv4"), values(pairs, "locator.port"),
        strict=False,
    )  # fmt: skip
    wanted = sorted({(ip, int(port)) for kind, ip, port in shown if int(kind, 16) == UDPV4})
    places = [
        *found.metatraffic_unicast, *found.metatraffic_multicast,
        *found.default_unicast, *found.default_multicast,
    ]  # fmt: skip
    assert sorted({(place.address, place.port) for place in places}) == wanted
    assert found.user_data.startswith(b"enclave=/;")


def compare_endpoint(found, pairs):
    assert found.guid.hex(":") == values(pairs, "param.endpoint_guid")[0]
    assert found.topic == values(pairs, "param.topicName")[0]
    assert found.type_name == values(pairs, "param.typeName")[0]
    kinds = values(pairs, "reliability_kind")
    if kinds:
        assert found.qos.reliable == (int(kinds[0], 16) == 2)
    durabilities = values(pairs, "durability")
    if durabilities:
        assert found.qos.transient_local == (int(durabilities[0], 16) >= 1)


def test_a_reply_of_fast_dds_names_its_request():
    """Both parameters of the related identity are in what rclpy's server sent."""
    for vector in VECTORS:
        for submessage in read(memoryview(bytes.fromhex(vector["datagram"]))):
            if isinstance(submessage, Data) and submessage.inline_qos is not None:
                qos = read_inline_qos(submessage.inline_qos, submessage.little)
                if qos.related is not None:
                    pids = [
                        pid
                        for pid, _ in parameters.parameters(
                            submessage.inline_qos, submessage.little
                        )
                    ]
                    assert {0x0083, 0x800F} <= set(pids)
                    assert qos.related[0][:2] == FAST_DDS
                    return
    raise AssertionError("no recorded DATA has a related sample identity")


def test_fast_dds_before_2_14_relates_requests_and_replies_by_its_own_parameter_alone():
    """rmw_fastrtps of Humble: a request names the reader of the reply, a reply its request."""
    found = []
    for vector in VECTORS:
        if vector["source"] != "Fast DDS 2.9.1":
            continue
        for submessage in read(memoryview(bytes.fromhex(vector["datagram"]))):
            if isinstance(submessage, Data) and submessage.inline_qos is not None:
                raw = submessage.inline_qos, submessage.little
                assert {pid for pid, _ in parameters.parameters(*raw)} == {0x800F}
                found.append(read_inline_qos(*raw).related)
    (client, unknown), (reader, number) = found
    assert client[:2] == FAST_DDS and client[-1] == ids.KIND_READER_NO_KEY and unknown < 1
    assert reader[:2] == ids.VENDOR and reader[-1] == ids.KIND_READER_NO_KEY and number == 1


# --- our own ------------------------------------------------------------------------------------

octets = st.integers(0, 255)
ports = st.integers(1, 65535)
ipv4 = st.tuples(st.integers(1, 223), octets, octets, octets).map(
    lambda numbers: ".".join(map(str, numbers))
)
ipv6 = st.integers(1, 0xFFFF).map(lambda number: f"fe80::{number:x}")
addresses = st.builds(Locator, st.just(UDPV4), ports, ipv4) | st.builds(
    Locator, st.just(UDPV6), ports, ipv6
)
places = st.lists(addresses, max_size=parameters.MAX_LOCATORS)
milliseconds = st.none() | st.integers(1, 10**9)


@given(
    st.builds(
        ParticipantData, st.just(GUID), st.none() | st.integers(0, 232),
        st.sampled_from(["", "lab"]), st.integers(0, 2**32 - 1), milliseconds,
        places, places, places, places, st.binary(max_size=100),
    )
)  # fmt: skip
def test_participants_come_back(data):
    assert read_participant(write_participant(data)) == data


names = st.text(
    st.characters(exclude_characters="\0", exclude_categories=["Cs"]), min_size=1, max_size=50
)
profiles = st.builds(
    QoSProfile,
    depth=st.integers(1, 2**31 - 1),
    history=st.sampled_from([HistoryPolicy.KEEP_LAST, HistoryPolicy.KEEP_ALL]),
    reliability=st.sampled_from([ReliabilityPolicy.RELIABLE, ReliabilityPolicy.BEST_EFFORT]),
    durability=st.sampled_from([DurabilityPolicy.VOLATILE, DurabilityPolicy.TRANSIENT_LOCAL]),
    deadline_ms=milliseconds,
    liveliness=st.sampled_from([LivelinessPolicy.AUTOMATIC, LivelinessPolicy.MANUAL_BY_TOPIC]),
    liveliness_lease_ms=milliseconds,
    ownership_exclusive=st.booleans(),
    partitions=st.lists(names, max_size=5).map(tuple),
    user_data=st.binary(max_size=100),
)


@given(profiles, names, names, st.booleans(), places, places, milliseconds)
def test_endpoints_come_back(qos, topic, type_name, is_writer, unicast, multicast, more):
    if is_writer:
        qos.lifespan_ms = more
    else:
        qos.separation_ms = more
    guid = PREFIX + b"\0\0\1" + bytes([3 if is_writer else 4])
    data = EndpointData(guid, is_writer, topic, type_name, qos, unicast, multicast)
    found = read_endpoint(write_endpoint(data), is_writer)
    if qos.history == HistoryPolicy.KEEP_ALL:
        qos.depth = 0  # it is not announced
    assert vars(found) == vars(data)


def test_a_related_identity_comes_back():
    raw = parameters.write_related_identity(GUID, 2**33 + 5)
    assert read_inline_qos(raw, True).related == (GUID, 2**33 + 5)


def test_a_key_and_a_farewell_come_back():
    for guid in (GUID, PREFIX + b"\0\0\1\3"):
        assert read_key(parameters.write_key(guid)) == guid
        qos = read_inline_qos(parameters.write_farewell_qos(guid), True)
        assert (qos.key_hash, qos.status) == (guid, 3)


# --- by the specification ------------------------------------------------------------------------


def listed(*pairs, little=True):
    """A parameter list put together by RTPS 9.4.2.11."""
    mark = "<" if little else ">"
    out = (b"\0\3" if little else b"\0\2") + b"\0\0"
    for pid, body in pairs:
        out += struct.pack(mark + "HH", pid, len(body)) + body
    return out + struct.pack(mark + "HH", 1, 0)


def endpoint(*more, little=True, is_writer=True):
    mark = "<" if little else ">"
    text = struct.pack(mark + "I", 4) + b"abc\0"
    basic = (ids.PID_ENDPOINT_GUID, GUID[:12] + b"\0\0\1\3"), (5, text), (7, text)
    return read_endpoint(listed(*basic, *more, little=little), is_writer)


def test_absent_policies_have_the_defaults_of_the_specification():
    writer, reader = endpoint(), endpoint(is_writer=False)
    assert writer.qos.reliable and not reader.qos.reliable
    for data in (writer, reader):
        qos = data.qos
        assert not qos.transient_local and qos.liveliness == LivelinessPolicy.AUTOMATIC
        assert qos.deadline_ms is qos.lifespan_ms is qos.liveliness_lease_ms is None
        assert data.representations == (0,) and not qos.ownership_exclusive
        assert qos.partitions == ()
    assert read_participant(listed((0x50, GUID))).lease_ms == 100_000


@pytest.mark.parametrize("infinite", [b"\xff\xff\xff\x7f\xff\xff\xff\xff", b"\xff" * 8,
                                      b"\xff\xff\xff\x7f\xff\xff\xff\x7f"])  # fmt: skip
def test_each_form_of_an_infinite_duration_is_infinite(infinite):
    assert endpoint((ids.PID_DEADLINE, infinite)).qos.deadline_ms is None


def test_durations_are_seconds_and_a_binary_fraction():
    assert endpoint((ids.PID_DEADLINE, b"\2\0\0\0\0\0\0\x80")).qos.deadline_ms == 2500


def test_big_endian_lists_are_read():
    data = endpoint((ids.PID_RELIABILITY, b"\0\0\0\1" + bytes(8)), little=False)
    assert data.topic == "abc" and not data.qos.reliable


def test_locators_of_other_transports_and_of_no_address_are_left_out():
    def place(kind, port, address):
        return ids.PID_UNICAST_LOCATOR, struct.pack("<iI", kind, port) + bytes(12) + address

    home = place(1, 7411, bytes([127, 0, 0, 1]))
    other = [
        place(16, 7411, bytes([127, 0, 0, 1])),  # shared memory of Fast DDS
        place(0x01000000, 7411, bytes([127, 0, 0, 1])),
        place(1, 0, bytes([10, 0, 0, 1])),
        place(1, 70_000, bytes([10, 0, 0, 1])),
        place(1, 7411, bytes(4)),
        place(1, 7411, b"\xff" * 4),
        place(2, 7411, bytes(4)),
    ]
    assert endpoint(*other, home).unicast == [Locator(UDPV4, 7411, "127.0.0.1")]


def test_unknown_parameters_are_skipped_unless_they_must_be_understood():
    assert endpoint((0x3001, b"what"), (0x8019, b"ever")).topic == "abc"
    with pytest.raises(MalformedError, match="0x7001 must be understood"):
        endpoint((0x7001, b"what"))


def text(size):
    return struct.pack("<I", size) + b"a" * (size - 1) + b"\0" + bytes(-size % 4)


INVALID = {
    "another encapsulation": b"\0\1\0\0\1\0\0\0",
    "nothing": b"",
    "a parameter behind the end": b"\0\3\0\0\5\0\xff\0abcd",
    "too many parameters": b"\0\3\0\0" + b"\0\x80\0\0" * 300,
    "no GUID": listed((5, text(4)), (7, text(4))),
    "a short GUID": listed((ids.PID_ENDPOINT_GUID, bytes(8))),
    "no topic": listed((ids.PID_ENDPOINT_GUID, GUID), (7, text(4))),
    "a string without its end": listed((5, struct.pack("<I", 4) + b"abcd")),
    "a string that is not UTF-8": listed((5, struct.pack("<I", 4) + b"\xff\xfe\xfd\0")),
    "a string behind the end": listed((5, struct.pack("<I", 40) + b"abc\0")),
    "a long name": listed((5, text(1000))),
    "user data without end": listed((ids.PID_USER_DATA, struct.pack("<I", 2**31))),
    "partitions without end": listed((ids.PID_PARTITION, struct.pack("<I", 2**31))),
    "a short duration": listed((ids.PID_DEADLINE, b"\1\0\0\0")),
    "representations without end": listed((ids.PID_DATA_REPRESENTATION, b"\xff\xff\xff\xff")),
    "a short locator": listed((ids.PID_UNICAST_LOCATOR, bytes(8))),
}


@pytest.mark.parametrize("name", INVALID)
def test_what_is_not_valid_is_refused(name):
    for is_writer in (True, False):
        with pytest.raises(MalformedError):
            read_endpoint(INVALID[name], is_writer)
    with pytest.raises(MalformedError):
        read_participant(INVALID[name])


def test_locators_beyond_the_limit_are_left_out():
    place = ids.PID_UNICAST_LOCATOR, struct.pack("<iI", 1, 7411) + bytes(12) + b"\x0a\0\0\1"
    assert len(endpoint(*[place] * 100).unicast) == parameters.MAX_LOCATORS


@given(st.binary(max_size=200), st.booleans())
def test_any_octets_are_read_or_refused(body, little):
    payload = (parameters.PL_CDR_LE if little else parameters.PL_CDR_BE) + b"\0\0" + body
    for reader in (
        read_participant, lambda raw: read_endpoint(raw, True), read_key,
        lambda raw: read_inline_qos(raw[4:], little),
    ):  # fmt: skip
        try:
            reader(payload)
        except MalformedError:
            pass


@given(
    st.sampled_from([case.values[0] for case in DISCOVERY]),
    st.lists(st.tuples(st.integers(0, 10**6), st.integers(0, 255)), min_size=1, max_size=8),
)
def test_recorded_discovery_data_with_wrong_octets_is_read_or_refused(data, changes):
    payload = bytearray(data.payload)
    for at, value in changes:
        payload[4 + at % (len(payload) - 4)] = value
    for reader in (read_participant, lambda raw: read_endpoint(raw, True), read_key):
        try:
            reader(bytes(payload))
        except MalformedError:
            pass
