"""Messages as lines of text: recorded ones, each kind, and arbitrary bytes."""

import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.replay import CAPTURES, load, messages
from unit.agent.helpers import (
    acknack,
    create,
    create_client,
    delete,
    fragment,
    heartbeat,
    message,
    oid,
    read_data,
    sub,
    whole,
    write_data,
    xml,
)

from uros.agent.observability.format import MAX_LINE, MAX_SUBMESSAGES, format_message, parse_message
from uros.wire import ids

NAMES = sorted(path.stem for path in CAPTURES.glob("*.jsonl"))
WRITER = oid(1, ids.KIND_DATAWRITER)
READER = oid(1, ids.KIND_DATAREADER)


def recorded():
    for name in NAMES:
        records = load(name)
        for from_client in (True, False):
            yield from (record for _, record in messages(name, records, from_client))


RECORDED = list(recorded())


def format_one(submessage, **more):
    return format_message(message([submessage], 0x80, 5, **more)).removeprefix("0x81 reliable 5: ")


def test_every_recorded_message_is_formatted_without_errors():
    for record in RECORDED:
        assert "??" not in format_message(record), format_message(record)
    kinds = {part.kind for record in RECORDED for part in parse_message(record).parts}
    assert kinds == {
        "CREATE_CLIENT", "CREATE", "GET_INFO", "DELETE", "STATUS_AGENT", "STATUS", "INFO",
        "WRITE_DATA", "READ_DATA", "DATA", "ACKNACK", "HEARTBEAT", "FRAGMENT", "TIMESTAMP",
        "TIMESTAMP_REPLY",
    }  # fmt: skip


def test_the_lines_of_a_recorded_conversation():
    lines = [
        format_message(record) for _, record in messages("rclc_trigger", load("rclc_trigger"), True)
    ]
    lines += [
        format_message(record)
        for _, record in messages("rclc_trigger", load("rclc_trigger"), False)
    ]
    for line in (
        "0x80: CREATE_CLIENT key 0x00000011 session 0x81 mtu 508 XRCE 1.0 vendor 010F",
        "0x81 reliable 0: CREATE #10 participant 0x000(1) in domain 0 'trigger_server_node'"
        " [reuse replace]",
        "0x81 reliable 1: CREATE #11 replier 0x000(8) in participant 0x000(1) rq/triggerRequest of"
        " type std_srvs::srv::dds_::Trigger_Request_, rr/triggerReply of type"
        " std_srvs::srv::dds_::Trigger_Response_ [reuse replace]",
        "0x81 reliable 2: READ_DATA #12 0x000(8) on reliable all samples",
        "0x81: STATUS_AGENT OK",
        "0x81 reliable 0: STATUS #10 0x000(1) OK",
        "0x81: ACKNACK reliable: all before 1 arrived",
    ):
        assert line in lines
    assert any("DATA #12 0x000(8) call 1 of 010f7f01" in line for line in lines)
    assert any("answer to #13 0x000(7), 20 bytes: 01 00" in line for line in lines)


def test_a_datawriter_with_its_qos():
    content = bytes.fromhex("0012 01 00 0700 01 00 0a00 01 00 d0070000 00 00 00")
    text = format_one(
        create(WRITER, ids.IN_BINARY, content, oid(3, ids.KIND_PUBLISHER), flags=2 | 4)
    )
    assert text == (
        "CREATE #10 datawriter 0x001(5) in publisher 0x003(3) on topic 0x001(2) reliable"
        " keep_last 10 deadline 2000 ms ownership exclusive [reuse replace]"
    )


@pytest.mark.parametrize(
    ("submessage", "text"),
    [
        (delete(WRITER), "DELETE #20 0x001(5)"),
        (delete(ids.OBJECT_CLIENT), "DELETE #20 client"),
        (
            write_data(WRITER, bytes(range(20))),
            "WRITE_DATA #30 0x001(5) 20 bytes: 00 01 02 03 04 05 06 07 08 09 0A 0B 0C 0D 0E 0F ...",
        ),
        (write_data(WRITER, b"", flags=0), "WRITE_DATA #30 0x001(5) 0 bytes [big endian]"),
        (write_data(WRITER, b"\1", flags=9), "WRITE_DATA #30 0x001(5) as data sequence 1 byte: 01"),
        (
            read_data(READER, control=(3, 4, 500, 6)),
            "READ_DATA #40 0x001(6) on reliable 3 samples for 4 s at most 500 bytes/s 6 ms apart",
        ),
        (
            read_data(READER, stream=1, control=(0, 0, 0, 0)),
            "READ_DATA #40 0x001(6) on best effort stop",
        ),
        (
            read_data(READER, control=None, content_filter="x > 1"),
            "READ_DATA #40 0x001(6) on reliable filter 'x > 1' one sample",
        ),
        (acknack(7, 0b101), "ACKNACK reliable: all before 7 arrived but not 7, 9"),
        (acknack(0xFFFF, 0b11, 0x82), "ACKNACK reliable (0x82): all before 65535 arrived but not"
         " 65535, 0"),
        (heartbeat(3, 5), "HEARTBEAT reliable: 3 to 5 are to be acknowledged"),
        (heartbeat(0, 0xFFFF), "HEARTBEAT reliable: nothing before 0 is to be acknowledged"),
        (fragment(b"\1\2"), "FRAGMENT 2 bytes: 01 02"),
        (fragment(b"\1", last=True), "FRAGMENT last, 1 byte: 01"),
        (sub(ids.RESET), "RESET"),
        (sub(16, b"\1\2\3\4"), "PERFORMANCE 4 bytes: 01 02 03 04"),
        (sub(99, b"\7"), "submessage 99 of 1 byte: 07"),
        (
            sub(ids.STATUS, b"\0\x0a\0\x15\x84\2"),
            "STATUS #10 0x001(5) ERR_UNKNOWN_REFERENCE/2",
        ),
        (sub(ids.GET_INFO, b"\0\x0a\xff\xfd\3\0\0\0"), "GET_INFO #10 agent configuration and"
         " activity"),
        (
            sub(ids.TIMESTAMP, (7).to_bytes(4, "little") + (5).to_bytes(4, "little")),
            "TIMESTAMP 7.000000005 s",
        ),
        (
            create(oid(1, ids.KIND_PARTICIPANT), ids.BY_REFERENCE, "arm\n\x1b[31m", 7),
            "CREATE #10 participant 0x001(1) in domain 7 by reference 'arm \\x1b[31m'",
        ),
        (
            xml(oid(2, ids.KIND_TOPIC), "<dds><topic><name>rt/x</name></topic></dds>", 0x11),
            "CREATE #10 topic 0x002(2) in participant 0x001(1) XML ?? a topic needs <name> and"
            " <dataType>: '<dds><topic><name>rt/x</name></topic></dds>'",
        ),
    ],
)  # fmt: skip
def test_each_kind(submessage, text):
    assert format_one(submessage) == text


def test_the_header():
    low = message([sub(ids.RESET)], 3, 9, session_id=0x01, key=0x4B0CBE99)
    assert format_message(low) == "0x01 key 0x4B0CBE99 best effort (0x03) 9: RESET"
    assert format_message(message([sub(ids.RESET)], 0, 0)) == "0x81: RESET"
    assert "mtu 512 XRCE 1.0 vendor 010F [uxr_sm=1, uxr_hl=2]" in format_message(
        create_client(properties=[("uxr_sm", "1"), ("uxr_hl", "2")])
    )


@pytest.mark.parametrize(
    ("octets", "text"),
    [
        ("", "?? 0 bytes, too few for a header"),
        ("81", "?? 1 byte, too few for a header: 81"),
        ("01800000aabb", "?? 6 bytes, too few for a header: 01 80 00 00 AA BB"),
        ("81800000", "0x81 reliable 0: ?? no submessage"),
        ("8180000007", "0x81 reliable 0: ?? 1 byte left over: 07"),
        (
            "818000000701ff00aabb",
            "0x81 reliable 0: ?? WRITE_DATA: submessage 7 announces 255 bytes, 2 are there:"
            " 07 01 FF 00 AA BB",
        ),
        (
            "818000000b010300010002",
            "0x81 reliable 0: HEARTBEAT ?? truncated: 2 bytes wanted, 1 left: 01 00 02",
        ),
        (
            "81800000030105000001001503",
            "0x81 reliable 0: DELETE #1 0x001(5) ?? 1 byte more: 03",
        ),
    ],
)
def test_the_position_of_a_decode_error_is_shown(octets, text):
    assert format_message(bytes.fromhex(octets)) == text


def check(octets):
    text = format_message(octets)
    assert len(text) <= MAX_LINE
    assert text.isascii() and text.isprintable()
    assert len(parse_message(octets).parts) <= MAX_SUBMESSAGES


@given(st.binary(max_size=400))
def test_any_bytes(octets):
    check(octets)


@given(st.sampled_from(RECORDED), st.data())
def test_recorded_messages_with_wrong_octets(recorded, data):
    octets = bytearray(recorded)
    for _ in range(data.draw(st.integers(1, 4))):
        octets[data.draw(st.integers(0, len(octets) - 1))] = data.draw(st.integers(0, 255))
    check(bytes(octets[: data.draw(st.integers(0, len(octets)))]))


@given(
    st.sampled_from(list(range(17))), st.integers(0, 15), st.integers(1, 3),
    st.binary(max_size=300), st.integers(0, 255),
)  # fmt: skip
def test_creates_of_every_kind_and_form(kind, object_id, form, content, flags):
    head = (
        bytes((0, 1, 0, object_id, object_id, form)) + b"\0\0" + len(content).to_bytes(4, "little")
    )
    check(message([sub(kind, head + content + b"\0\0", flags)], 0x80, 0))


def test_the_length_of_a_line_is_limited():
    check(message([delete(WRITER)] * 5000))
    long = create(oid(1, ids.KIND_PARTICIPANT), ids.BY_REFERENCE, "x" * 60_000, 0)
    check(b"\x81\x80\0\0" + whole(long))
    check(message([xml(oid(2, ids.KIND_TOPIC), "<a>" * 20_000, 0x11)]))
    names = "".join(f"<struct name='t{i}'/>" for i in range(300))
    check(message([xml(oid(1, ids.KIND_TYPE), f"<types>{names}</types>")]))
