"""RTPS submessages: against what Fast DDS and Cyclone sent, and round trips of our own.

``vectors.json`` has datagrams recorded on loopback between rclpy nodes (Fast DDS 3.2.3, UDP
transport) and between nodes on Cyclone DDS 11.0.1, and those that a program on Fast DDS 2.9.1 of
Debian sent to uros, each with the fields that tshark's dissector reads in it. Neither the datagrams
nor the fields come from code of uros.
"""

import json
from datetime import datetime, timezone
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.rtps_network import encode_heartbeat_frag

from uros.middleware.rtps import ids, submessages
from uros.middleware.rtps.kinds import (
    AckNack,
    Data,
    DataFrag,
    Gap,
    Heartbeat,
    HeartbeatFrag,
    InfoDestination,
    InfoReply,
    InfoSource,
    InfoTimestamp,
    NackFrag,
)
from uros.middleware.rtps.locators import UDPV4, UDPV6, Locator
from uros.middleware.rtps.submessages import MalformedError, read, read_header

VECTORS = json.loads((Path(__file__).parent / "vectors.json").read_text("utf-8"))
KINDS = {
    "0x15": Data, "0x16": DataFrag, "0x07": Heartbeat, "0x06": AckNack, "0x13": HeartbeatFrag,
    "0x12": NackFrag, "0x09": InfoTimestamp, "0x0e": InfoDestination,
}  # fmt: skip
VENDOR_SPECIFIC = "0x80"
PREFIX = bytes(range(12))
READER, WRITER = b"\x00\x00\x01\x04", b"\x00\x00\x02\x03"
IDS = [f"{vector['source']}-{number}" for number, vector in enumerate(VECTORS)]


def message(*parts):
    return memoryview(submessages.header(PREFIX) + b"".join(parts))


def only(*parts):
    (submessage,) = read(message(*parts))
    return submessage


def time_of(text):
    """Nanoseconds since 1970 of a time as tshark prints it."""
    whole, fraction = text.removesuffix(" UTC").split(".")
    seconds = datetime.strptime(whole, "%b %d, %Y %H:%M:%S").replace(tzinfo=timezone.utc)
    return int(seconds.timestamp()) * 10**9 + int(fraction)


# --- recorded datagrams ---------------------------------------------------------------------------


def test_the_vectors_have_the_kinds_that_both_vendors_send():
    kinds = {(v["source"].split()[0], kind) for v in VECTORS for kind, _ in v["submessages"]}
    common = {"0x15", "0x16", "0x07", "0x06", "0x09", "0x0e"}
    assert kinds >= {(vendor, kind) for vendor in ("Fast", "Cyclone") for kind in common}
    assert ("Cyclone", "0x13") in kinds


@pytest.mark.parametrize("vector", VECTORS, ids=IDS)
def test_recorded_datagrams_are_read_as_tshark_reads_them(vector):
    datagram = memoryview(bytes.fromhex(vector["datagram"]))
    version, vendor, prefix = read_header(datagram)
    assert version[0] == 2 and vendor == prefix[:2]
    found = list(read(datagram))
    wanted = [(kind, fields) for kind, fields in vector["submessages"] if kind != VENDOR_SPECIFIC]
    assert [type(submessage) for submessage in found] == [KINDS[kind] for kind, _ in wanted]
    for submessage, (_, pairs) in zip(found, wanted, strict=True):
        compare(submessage, pairs)


def compare(submessage, pairs):
    def values(name):
        return [value for key, value in pairs if key == name]

    flags = int(values("flags")[0], 16)
    if isinstance(submessage, InfoTimestamp):
        # tshark prints whole nanoseconds of a fraction of 2^-32 s.
        assert abs(submessage.time_ns - time_of(values("info_ts.timestamp")[0])) <= 1
        return
    if isinstance(submessage, InfoDestination):
        assert submessage.prefix.hex(":") == values("guidPrefix.dst")[0]
        return
    assert submessage.reader.hex() == values("sm.rdEntityId")[0][2:]
    assert submessage.writer.hex() == values("sm.wrEntityId")[0][2:]
    numbers = [int(value) for value in values("sm.seqNumber")]
    if isinstance(submessage, Data):
        assert [submessage.number] == numbers[:1]
        assert (submessage.inline_qos is not None) == bool(flags & 2)
        assert (submessage.payload is not None) == bool(flags & 0x0C)
        assert submessage.is_key == bool(flags & 8)
    elif isinstance(submessage, DataFrag):
        assert [submessage.number] == numbers[:1]
        read_back = submessage[3:7]
        names = ("number", "num_fragments", "size", "sample_size")
        assert read_back == tuple(int(values(f"data_frag.{name}")[0]) for name in names)
        assert len(submessage.payload) == min(
            submessage.fragments * submessage.fragment_size,
            submessage.sample_size - (submessage.first - 1) * submessage.fragment_size,
        )
    elif isinstance(submessage, Heartbeat):
        assert [submessage.first, submessage.last] == numbers
        assert submessage.counter == int(values("heartbeat_count")[0])
        assert (submessage.final, submessage.liveliness) == (bool(flags & 2), bool(flags & 4))
    elif isinstance(submessage, AckNack):
        assert [submessage.base] == numbers[:1]
        assert submessage.counter == int(values("acknack.count")[0])
        assert submessage.final == bool(flags & 2)
        (bits,) = values("bitmap.num_bits")
        assert len(submessage.missing) <= int(bits)
    elif isinstance(submessage, NackFrag):
        assert [submessage.number] == numbers and submessage.missing
    else:
        assert [submessage.number] == numbers
        assert submessage.counter == int(values("heartbeat_frag.count")[0])


# --- our own ------------------------------------------------------------------------------------

numbers = st.integers(1, 2**62)
words = st.integers(0, 2**32 - 1)


@given(numbers, st.binary(max_size=200), st.booleans(), st.booleans())
def test_data_comes_back(number, payload, with_qos, is_key):
    qos = b"\x70\0\x10\0" + bytes(range(16)) + b"\1\0\0\0" if with_qos else b""
    data = only(submessages.encode_data(READER, WRITER, number, payload, qos, is_key))
    assert data[:3] == (READER, WRITER, number) and data.is_key == is_key and data.little
    assert (data.inline_qos or b"") == qos
    assert len(data.payload) % 4 == 0
    if len(payload) > 3:
        plain = payload[:3] + bytes([payload[3] & ~3]) + payload[4:]
        whole = submessages.unpadded(bytes(data.payload)) if len(payload) % 4 else data.payload
        assert whole == (plain if len(payload) % 4 else payload)


def test_data_without_a_payload_comes_back():
    data = only(submessages.encode_data(READER, WRITER, 1, None, b"\1\0\0\0"))
    assert data.payload is None and data.inline_qos == b"\1\0\0\0"


def test_data_longer_than_its_length_field_reaches_to_the_end_of_the_message():
    payload = bytes(range(256)) * 300
    encoded = submessages.encode_data(READER, WRITER, 1, payload)
    assert encoded[2:4] == b"\0\0"
    assert bytes(only(encoded).payload) == payload


@given(numbers, st.integers(1, 2000), st.integers(1, 5000), st.data())
def test_fragments_come_back(number, size, total, data):
    last = -(-total // size)
    first = data.draw(st.integers(1, last))
    fragment = bytes(min(size, total - size * (first - 1)))
    found = only(submessages.encode_data_frag(READER, WRITER, number, first, size, total, fragment))
    assert found[:7] == (READER, WRITER, number, first, 1, size, total)
    assert found.payload == fragment


@given(numbers, st.integers(0, 1000), words, st.booleans(), st.booleans())
def test_heartbeats_come_back(first, more, counter, final, liveliness):
    last = first - 1 + more
    encoded = submessages.encode_heartbeat(READER, WRITER, first, last, counter, final, liveliness)
    assert only(encoded) == (READER, WRITER, first, last, counter, final, liveliness)


@given(numbers, st.sets(st.integers(0, 255)), words, st.booleans())
def test_acknacks_come_back(base, offsets, counter, final):
    missing = tuple(sorted(base + offset for offset in offsets))
    encoded = submessages.encode_acknack(READER, WRITER, base, missing, counter, final)
    assert only(encoded) == (READER, WRITER, base, missing, counter, final)


@given(numbers, st.integers(0, 1000), st.sets(st.integers(0, 255)))
def test_gaps_come_back(start, more, offsets):
    base = start + more
    irrelevant = tuple(sorted(base + offset for offset in offsets))
    encoded = submessages.encode_gap(READER, WRITER, start, base, irrelevant)
    assert only(encoded) == (READER, WRITER, start, base, irrelevant)


@given(numbers, st.integers(1, 2**31), st.sets(st.integers(0, 255)), words)
def test_fragment_acknacks_come_back(number, base, offsets, counter):
    missing = tuple(sorted({base} | {base + offset for offset in offsets}))
    encoded = submessages.encode_nack_frag(READER, WRITER, number, missing, counter)
    assert only(encoded) == (READER, WRITER, number, missing, counter)


@given(numbers, st.integers(1, 2**32 - 1), words)
def test_fragment_heartbeats_come_back(number, last, counter):
    encoded = encode_heartbeat_frag(READER, WRITER, number, last, counter)
    assert only(encoded) == (READER, WRITER, number, last, counter)


@given(st.none() | st.integers(0, 2**31 * 10**9 - 1))
def test_times_come_back_to_the_nanosecond(time_ns):
    assert only(submessages.encode_info_ts(time_ns)) == (time_ns,)


def test_destinations_come_back():
    assert only(submessages.encode_info_dst(PREFIX)) == (PREFIX,)


def test_numbers_outside_a_bitmap_are_refused():
    for missing in ([4], [5 + 256]):
        with pytest.raises(ValueError, match="is not within 256 of 5"):
            submessages.encode_acknack(READER, WRITER, 5, missing, 1)
    with pytest.raises(ValueError, match="no fragment"):
        submessages.encode_nack_frag(READER, WRITER, 5, [], 1)


# --- by the specification: bytes put together from RTPS 9.4.5 -------------------------------------


def big(kind, flags, body):
    return bytes([kind, flags & ~1]) + len(body).to_bytes(2, "big") + body


def number_be(value):
    return (value >> 32).to_bytes(4, "big") + (value & 0xFFFFFFFF).to_bytes(4, "big")


@pytest.mark.parametrize(
    ("encoded", "wanted"),
    [
        (
            big(ids.HEARTBEAT, 2, READER + WRITER + number_be(3) + number_be(2**33) + bytes(4)),
            Heartbeat(READER, WRITER, 3, 2**33, 0, True, False),
        ),
        (
            big(
                ids.ACKNACK, 0,
                READER + WRITER + number_be(10) + (3).to_bytes(4, "big") + b"\xbf\xff\xff\xff"
                + (7).to_bytes(4, "big"),
            ),
            AckNack(READER, WRITER, 10, (10, 12), 7, False),
        ),
        (
            big(
                ids.GAP, 0,
                READER + WRITER + number_be(4) + number_be(6) + (2).to_bytes(4, "big")
                + b"\x40\0\0\0",
            ),
            Gap(READER, WRITER, 4, 6, (7,)),
        ),
        (
            big(
                ids.NACK_FRAG, 0,
                READER + WRITER + number_be(4) + (33).to_bytes(4, "big")
                + (33).to_bytes(4, "big") + b"\x80\0\0\0\x80\0\0\0" + (1).to_bytes(4, "big"),
            ),
            NackFrag(READER, WRITER, 4, (33, 65), 1),
        ),
        (
            big(ids.HEARTBEAT_FRAG, 0, READER + WRITER + number_be(4) + b"\0\0\0\x05\0\0\0\x09"),
            HeartbeatFrag(READER, WRITER, 4, 5, 9),
        ),
        (big(ids.INFO_TS, 0, b"\0\0\0\x01\x80\0\0\0"), InfoTimestamp(1_500_000_000)),
        (big(ids.INFO_TS, 2, b""), InfoTimestamp(None)),
        (
            big(ids.INFO_SRC, 0, bytes(4) + b"\x02\x01\x01\x0f" + PREFIX),
            InfoSource(b"\x02\x01", b"\x01\x0f", PREFIX),
        ),
        (
            big(
                ids.INFO_REPLY, 2,
                b"\0\0\0\x03" + b"\0\0\0\x01\0\0\x1c\xf2" + bytes(12) + b"\x0a\0\0\x07"
                + b"\0\0\0\x10\0\0\x1c\xf2" + bytes(16)  # shared memory
                + b"\0\0\0\x02\0\0\x1c\xf4" + b"\xfd" + bytes(14) + b"\x09"
                + b"\0\0\0\x01" + b"\0\0\0\x01\0\0\x1c\xe8" + bytes(12) + b"\xef\xff\0\x01",
            ),
            InfoReply((Locator(UDPV4, 7410, "10.0.0.7"), Locator(UDPV6, 7412, "fd00::9"))),
        ),
        (
            big(ids.INFO_REPLY_IP4, 0, b"\x0a\0\0\x07\0\0\x1c\xf2"),
            InfoReply((Locator(UDPV4, 7410, "10.0.0.7"),)),
        ),
    ],
    ids=lambda value: type(value).__name__ if isinstance(value, tuple) else "",
)  # fmt: skip
def test_big_endian_submessages(encoded, wanted):
    assert only(encoded) == wanted


def test_info_reply_ip4_little_endian():
    """An IPv4 address is a number there."""
    body = bytes.fromhex("0700000a f21c0000 0100ffef e81c0000")
    reply = only(bytes([ids.INFO_REPLY_IP4, 3]) + len(body).to_bytes(2, "little") + body)
    assert reply == InfoReply((Locator(UDPV4, 7410, "10.0.0.7"),))


def test_unknown_and_vendor_specific_submessages_are_skipped():
    heartbeat = submessages.encode_heartbeat(READER, WRITER, 1, 0, 1)
    assert len(list(read(message(b"\x80\x01\x04\0abcd", b"\x7f\0\0\0", heartbeat)))) == 0
    assert len(list(read(message(b"\x80\x01\x04\0abcd", heartbeat)))) == 1
    assert len(list(read(message(b"\x01\x01\0\0", heartbeat)))) == 1  # PAD of no octets


# --- what is not valid ---------------------------------------------------------------------------


@pytest.mark.parametrize(
    "datagram", [b"", b"RTPS", b"RTPX" + bytes(16), b"RTPS\x01\x00" + bytes(14)]
)
def test_what_is_not_rtps_2_is_refused(datagram):
    with pytest.raises(MalformedError, match="not an RTPS 2 message"):
        read_header(memoryview(datagram))


HEADS = READER + WRITER
INVALID = {
    "number 0": submessages.encode_data(READER, WRITER, 0, b""),
    "negative number": big(ids.DATA, 4, bytes(2) + b"\0\x10" + HEADS + b"\xff" * 8),
    "inline QoS in the header": big(ids.DATA, 4, bytes(2) + b"\0\x04" + HEADS + number_be(1)),
    "sample and key": big(ids.DATA, 12, bytes(2) + b"\0\x10" + HEADS + number_be(1)),
    "payload behind the end": big(ids.DATA, 4, bytes(2) + b"\xff\x00" + HEADS + number_be(1)),
    "endless inline QoS": submessages.encode_data(READER, WRITER, 1, b"", b"\x70\0\xf0\0"),
    "fragment 0": submessages.encode_data_frag(READER, WRITER, 1, 0, 10, 10, bytes(10)),
    "fragment behind the last": submessages.encode_data_frag(
        READER, WRITER, 1, 2, 10, 10, bytes(10)
    ),
    "fragments of 0 octets": submessages.encode_data_frag(READER, WRITER, 1, 1, 0, 10, b""),
    "a sample of 0 octets": submessages.encode_data_frag(READER, WRITER, 1, 1, 10, 0, b""),
    "a short fragment": submessages.encode_data_frag(READER, WRITER, 1, 1, 10, 10, bytes(4)),
    "a heartbeat from 0": submessages.encode_heartbeat(READER, WRITER, 0, 5, 1),
    "a heartbeat backwards": submessages.encode_heartbeat(READER, WRITER, 5, 3, 1),
    "a bitmap of 257": big(
        ids.ACKNACK, 0, HEADS + number_be(1) + (257).to_bytes(4, "big") + bytes(40)
    ),
    "a gap backwards": big(ids.GAP, 0, HEADS + number_be(4) + number_be(3) + bytes(4)),
    "a gap from 0": big(ids.GAP, 0, HEADS + number_be(0) + number_be(3) + bytes(4)),
    "fragment numbers from 0": big(
        ids.NACK_FRAG, 0, HEADS + number_be(4) + bytes(4) + bytes(4) + bytes(4)
    ),
    "INFO_REPLY_IP4 without its multicast locator": big(ids.INFO_REPLY_IP4, 2, bytes(8)),
    "too many locators": big(ids.INFO_REPLY, 0, b"\xff\xff\xff\xff" + bytes(24)),
    "a short destination": big(ids.INFO_DST, 0, bytes(11)),
    "a short heartbeat": big(ids.HEARTBEAT, 0, HEADS + number_be(1)),
    "longer than the message": b"\x07\x01\xff\x00" + bytes(20),
    "octets at the end": b"\x07\x01",
}


@pytest.mark.parametrize("name", INVALID)
def test_what_is_not_valid_ends_its_message(name):
    heartbeat = submessages.encode_heartbeat(READER, WRITER, 1, 0, 1)
    found = read(message(heartbeat, INVALID[name], heartbeat))
    assert isinstance(next(found), Heartbeat)
    with pytest.raises(MalformedError):
        list(found)


@given(st.binary(max_size=300))
def test_any_octets_are_read_or_refused(octets):
    try:
        for submessage in read(memoryview(submessages.header(PREFIX) + octets)):
            assert isinstance(submessage, tuple)
    except MalformedError:
        pass


@given(
    st.sampled_from(VECTORS),
    st.lists(st.tuples(st.integers(0, 10**6), st.integers(0, 255)), min_size=1, max_size=8),
)
def test_recorded_datagrams_with_wrong_octets_are_read_or_refused(vector, changes):
    datagram = bytearray.fromhex(vector["datagram"])
    for at, value in changes:
        datagram[at % len(datagram)] = value
    try:
        read_header(memoryview(datagram))
        list(read(memoryview(datagram)))
    except MalformedError:
        pass
