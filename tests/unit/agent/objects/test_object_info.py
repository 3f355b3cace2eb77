"""GET_INFO about objects, the client and the agent, and PERFORMANCE submessages."""

import struct

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from support.examples import examples
from unit.agent import helpers
from unit.agent.helpers import (
    APPLICATION,
    APPLICATION_XML,
    KEY,
    OK,
    PARTICIPANT,
    PUBLISHER,
    QOS,
    QOS_XML,
    READER,
    REPLACE,
    REQUESTER,
    RESOURCES,
    SUBSCRIBER,
    TOPIC,
    TYPE,
    TYPES_XML,
    UNKNOWN,
    WRITER,
    Board,
    Desk,
    create,
    delete,
    message,
    of,
    oid,
    participant,
    publisher_entities,
    read_data,
    sub,
    topic,
    write_data,
    xml,
)

from uros.agent.policy.limits import Limits
from uros.agent.session import session as module
from uros.wire import entities, ids, session
from uros.wire.cdr import Reader

# --- submessages of others -----------------------------------------------------------------------


def test_performance_is_not_for_an_agent(board):
    """The C++ agent ignores PERFORMANCE as well: it only defines its number, 255."""
    board.send(sub(255, struct.pack("<II", 1, 0) + b"echo me", flags=3), topic())
    assert "submessage 255 is not for an agent" in board.desk.log()
    assert board.ask(participant()) == [OK]


def test_performance_of_a_c_client_is_a_timestamp(board):
    """Built with PERFORMANCE_TESTING, a C client sends 14, which is TIMESTAMP: it gets a reply."""
    board.send(sub(14, struct.pack("<II", 77, 0) + b"echo me", flags=3), stream=0)
    (reply,) = board.payloads(ids.TIMESTAMP_REPLY)
    assert session.pull_timestamp_reply(Reader(reply, 0, len(reply)))[2] == (77, 0)


# --- GET_INFO ------------------------------------------------------------------------------------

BOTH = ids.INFO_CONFIGURATION | ids.INFO_ACTIVITY
LONG = "x" * 240


def ask_info(board, object_id, mask=BOTH, request=0x0A0B, stream=0x80):
    payload = helpers.built(session.push_get_info, request, object_id, mask)
    board.send(sub(ids.GET_INFO, payload), stream=stream)
    (info,) = board.payloads(ids.INFO)
    r = Reader(info, 0, len(info))
    assert session.pull_status(r)[:2] == (request, object_id)
    return info[4], info[5], r


def variant(r):
    """ObjectVariant as a C client reads it (uxr_deserialize_ObjectVariant)."""
    kind, form = r.u8(), r.u8()
    content = r.sequence() if form == ids.IN_BINARY else r.string()
    if kind == ids.KIND_PARTICIPANT:
        return kind, form, content, r.i16()
    return kind, form, content, (r.be16() if kind < ids.KIND_TYPE else None)


CREATED = [
    (PARTICIPANT, ids.IN_BINARY, helpers.built(entities.push_binary_participant, LONG, None), 5),
    (TOPIC, ids.AS_XML, f"<topic><name>rt/{LONG}</name><dataType>ü</dataType></topic>",
     PARTICIPANT),
    (PUBLISHER, ids.AS_XML, "", PARTICIPANT),
    (SUBSCRIBER, ids.IN_BINARY, b"\0\0", PARTICIPANT),
    (WRITER, ids.IN_BINARY, b"\0\x12\0", PUBLISHER),
    (READER, ids.IN_BINARY, b"\0\x12\0", SUBSCRIBER),
    (REQUESTER, ids.AS_XML, '<requester service_name="a" request_type="b" reply_type="c"/>',
     PARTICIPANT),
    (TYPE, ids.AS_XML, TYPES_XML, 0),
    (QOS, ids.AS_XML, QOS_XML, 0),
    (APPLICATION, ids.AS_XML, APPLICATION_XML.replace("0x00", "0x01"), 0),
]  # fmt: skip


@pytest.fixture
def full(desk):
    board = Board(desk, mtu=8192)
    for submessage in CREATED:
        assert board.ask(create(*submessage)) == [OK], desk.log()
    return board


@pytest.mark.parametrize("number", range(len(CREATED)))
@pytest.mark.parametrize("stream", [0, 1, 0x80])
def test_the_configuration_equals_the_representation_of_the_create(full, number, stream):
    object_id, form, content, parent = CREATED[number]
    status, info_mask, r = ask_info(full, object_id, ids.INFO_CONFIGURATION, stream=stream)
    assert (status, info_mask) == (OK, 1)
    assert r.boolean()
    kind = object_id & 15
    expected = None if kind >= ids.KIND_TYPE else parent
    assert variant(r) == (kind, form, content, expected)
    assert not r.boolean() and r.remaining() == 0


@pytest.mark.parametrize("number", range(len(CREATED)))
def test_info_contains_only_what_the_mask_requests(full, number):
    status, _, r = ask_info(full, CREATED[number][0], 0)
    assert status == OK
    assert (r.boolean(), r.boolean(), r.remaining()) == (False, False, 0)


def test_the_activity_of_a_writer(full):
    full.send(*[write_data(WRITER, b"x") for _ in range(3)])
    sequence = full.sequence[0x80]
    _, _, r = ask_info(full, WRITER, ids.INFO_ACTIVITY)
    assert not r.boolean() and r.boolean()
    assert r.u8() == ids.KIND_DATAWRITER
    # The message with GET_INFO is being handled, so the stream counts it.
    assert r.u16() == sequence
    r._next(8, 8)
    assert int.from_bytes(r.buf[r.offset - 8 : r.offset], "little") == 3
    assert r.remaining() == 0


def test_a_sample_without_room_is_not_counted(full):
    writer = of(full).objects[WRITER].endpoint
    answers = iter([False, False, True])
    writer._direct = lambda cdr: next(answers)
    full.send(write_data(WRITER, b"x"))
    full.wait(100)
    assert writer.written == 1


def test_the_activity_of_a_reader(full):
    def highest_acknowledged():
        _, _, r = ask_info(full, READER, ids.INFO_ACTIVITY, stream=0)
        assert not r.boolean() and r.boolean()
        assert r.u8() == ids.KIND_DATAREADER
        value = r.i16()
        assert r.remaining() == 0
        return value

    assert highest_acknowledged() == -1
    full.send(read_data(READER, 0x81))
    for _ in range(2):
        full.send(write_data(WRITER, b"x"))
        full.settle()
    assert len(full.samples()) == 2
    assert highest_acknowledged() == 1


@pytest.mark.parametrize("object_id", [oid(7, 1), oid(7, 5), 0, oid(1, 8), oid(5, 15)])
def test_info_about_an_unknown_object(full, object_id):
    status, info_mask, r = ask_info(full, object_id)
    assert (status, info_mask) == (UNKNOWN, 1)
    assert (r.boolean(), r.boolean(), r.remaining()) == (False, False, 0)


@pytest.mark.parametrize("object_id", [ids.OBJECT_CLIENT, ids.OBJECT_SESSION])
def test_info_about_the_client_and_its_session(full, object_id):
    status, _, r = ask_info(full, object_id)
    assert status == OK
    assert r.boolean() and r.u8() == ids.KIND_CLIENT
    cookie, version, _, key, session_id, properties, mtu = session.pull_create_client(r)
    assert (cookie, version, key, session_id) == (ids.COOKIE, (1, 0), KEY, 0x81)
    assert (properties, mtu) == ([], 8192)
    assert not r.boolean() and r.remaining() == 0


@pytest.mark.parametrize("mask", [0, ids.INFO_CONFIGURATION, ids.INFO_ACTIVITY, BOTH, 0xFFFFFFFF])
def test_a_ping_gets_the_same_answer_for_any_mask(board, mask):
    """Recorded in tests/captures: eProsima's clients ask for the activity and get both answers."""
    payload = helpers.built(session.push_get_info, 10, ids.OBJECT_AGENT, mask)
    sent = board.desk.hear(message([sub(ids.GET_INFO, payload)], 0, 0), 1)
    assert [item for _, item in sent] == [
        bytes.fromhex(  # recorded: ping
            "8100000006011c00000afffd0001010d585243450100010f00010d000100000000000000"
        )
    ]


def test_a_configuration_larger_than_a_message(desk):
    board = Board(desk, mtu=128)
    xml_text = "<topic><name>rt/a</name><dataType>T</dataType></topic>" + " " * 500
    raw = helpers.whole(create(TOPIC, ids.AS_XML, xml_text, PARTICIPANT))
    board.send(participant())
    for start in range(0, len(raw), 100):
        board.send(helpers.fragment(raw[start : start + 100], start + 100 >= len(raw)))
    assert board.statuses() == [OK, OK]
    _, _, r = ask_info(board, TOPIC)  # reliable: in fragments
    assert r.boolean() and variant(r)[2] == xml_text
    status, _, r = ask_info(board, TOPIC, stream=0)  # best effort: without fragments
    assert status == OK and not r.boolean()


def test_memory_for_info_is_bounded(board):
    board.desk.agent.limits = Limits(representations=1000)
    board.ask(participant())
    stored_bytes = of(board)._kept
    assert stored_bytes > 0
    fat = "<types><struct name='a'/></types>" + " " * 400
    assert board.ask(xml(TYPE, fat), xml(oid(2, 10), fat)) == [OK, OK]
    assert board.ask(xml(oid(3, 10), fat)) == [RESOURCES]
    assert "over 1000 bytes of representations" in board.desk.log()
    assert board.ask(delete(TYPE), xml(oid(3, 10), fat)) == [OK, OK]
    assert board.ask(xml(oid(3, 10), fat, flags=REPLACE)) == [OK]
    board.ask(delete(oid(2, 10)), delete(oid(3, 10)))
    assert of(board)._kept == stored_bytes


@settings(max_examples=examples(200), deadline=None)
@given(st.binary(max_size=16), st.sampled_from([0, 1, 0x80]))
def test_any_get_info_gets_an_answer_or_is_a_fault(payload, stream):
    desk = Desk()
    board = Board(desk)
    board.ask(*publisher_entities())
    board.send(sub(ids.GET_INFO, payload), stream=stream)
    assert len(board.payloads(ids.INFO)) == (len(payload) >= 8)
    desk.close()


def test_long_answers_without_acknowledgement_take_bounded_memory(desk, monkeypatch):
    monkeypatch.setattr(module, "MAX_ANSWERS", 10_000)
    board = Board(desk, mtu=65507)
    text = "<types><struct name='a'/></types>" + " " * 2000
    assert board.ask(create(TYPE, ids.AS_XML, text, 0)) == [OK]
    board.polite = False
    payload = helpers.built(session.push_get_info, 1, TYPE, BOTH)
    for _ in range(100):
        board.send(sub(ids.GET_INFO, payload))
    held_bytes = sum(item.size for item in of(board).session._out.values())
    assert 10_000 < held_bytes < 13_000
    assert "over 10000 bytes of answers are not acknowledged" in desk.log()
    board.acknowledge()
    assert len(board.payloads(ids.INFO)) == 5
    board.send(sub(ids.GET_INFO, payload))
    assert len(board.payloads(ids.INFO)) == 1
