"""Objects of one client: created in every format, deleted, read, and services."""

import struct
import time

import pytest
from unit.agent import helpers
from unit.agent.helpers import (
    EXISTS,
    INT32,
    INVALID,
    MATCHED,
    MISMATCH,
    OK,
    PARTICIPANT,
    PUBLISHER,
    READER,
    REFS,
    REPLACE,
    REPLIER,
    REQUESTER,
    REUSE,
    STRING,
    SUBSCRIBER,
    TOPIC,
    UNKNOWN,
    WRITER,
    Board,
    Desk,
    by_reference,
    create,
    delete,
    endpoint,
    get_info,
    group,
    message,
    oid,
    parse,
    participant,
    publisher_entities,
    read_data,
    service,
    sub,
    subscriber_entities,
    topic,
    write_data,
    xml,
)

from uros.agent.clock import Clock
from uros.agent.objects.kinds import KIND_NAMES
from uros.agent.objects.object_table import node_name
from uros.agent.policy.limits import Limits
from uros.middleware.base import MiddlewareError
from uros.middleware.memory import Bus
from uros.wire import ids, session
from uros.wire.cdr import Reader

NONE = 0
BOTH = REUSE | REPLACE


# --- three formats, every kind -----------------------------------------------------------

PARENTS = {
    ids.KIND_PARTICIPANT: 0,
    ids.KIND_TOPIC: PARTICIPANT,
    ids.KIND_PUBLISHER: PARTICIPANT,
    ids.KIND_SUBSCRIBER: PARTICIPANT,
    ids.KIND_DATAWRITER: PUBLISHER,
    ids.KIND_DATAREADER: SUBSCRIBER,
    ids.KIND_REQUESTER: PARTICIPANT,
    ids.KIND_REPLIER: PARTICIPANT,
}
KINDS = list(PARENTS)
ENDPOINT_XML = (
    "<dds><{0}><topic><kind>NO_KEY</kind><name>Square</name><dataType>{1}</dataType></topic>"
    "</{0}></dds>"
)
SERVICE_XML = (
    '<dds><{0} profile_name="my_requester"service_name="{1}"'
    'request_type="request_type"reply_type="reply_type"></{0}></dds>'
)
PARTICIPANT_XML = "<dds><participant><rtps><name>{}</name></rtps></participant></dds>"
TOPIC_XML = "<dds><topic><name>{}</name><dataType>ShapeType</dataType></topic></dds>"
GROUP_XML = "<dds><{0}><qos><partition><names><name>p</name></names></partition></qos></{0}></dds>"

# kind: content as XML, XML of another object
XML = {
    ids.KIND_PARTICIPANT: (PARTICIPANT_XML.format("one"), PARTICIPANT_XML.format("two")),
    ids.KIND_TOPIC: (TOPIC_XML.format("Square"), TOPIC_XML.format("Circle")),
    ids.KIND_PUBLISHER: ("", GROUP_XML.format("publisher")),
    ids.KIND_SUBSCRIBER: ("", GROUP_XML.format("subscriber")),
    ids.KIND_DATAWRITER: tuple(
        ENDPOINT_XML.format("data_writer", item) for item in ("ShapeType", "Other")
    ),
    ids.KIND_DATAREADER: tuple(
        ENDPOINT_XML.format("data_reader", item) for item in ("ShapeType", "Other")
    ),
    ids.KIND_REQUESTER: tuple(SERVICE_XML.format("requester", item) for item in ("a", "b")),
    ids.KIND_REPLIER: tuple(SERVICE_XML.format("replier", item) for item in ("a", "b")),
}
MORE_REFS = REFS.replace(
    "</profiles>",
    """
    <participant profile_name="second"><rtps><name>second</name></rtps></participant>
    <topic profile_name="second"><name>Circle</name><dataType>ShapeType</dataType></topic>
    <publisher profile_name="first"/><subscriber profile_name="first"/>
    <publisher profile_name="second"><qos><partition><names><name>p</name></names></partition>
    </qos></publisher>
    <subscriber profile_name="second"><qos><partition><names><name>p</name></names></partition>
    </qos></subscriber>
    <data_writer profile_name="second"><topic><name>Circle</name><dataType>ShapeType</dataType>
    </topic></data_writer>
    <data_reader profile_name="second"><topic><name>Circle</name><dataType>ShapeType</dataType>
    </topic></data_reader>
    <requester profile_name="second" service_name="b" request_type="A" reply_type="B"/>
    <replier profile_name="second" service_name="b" request_type="A" reply_type="B"/>
    </profiles>""",
)
REFERENCES = {
    ids.KIND_PARTICIPANT: "default_xrce_participant",
    ids.KIND_TOPIC: "shapetype_topic",
    ids.KIND_PUBLISHER: "first",
    ids.KIND_SUBSCRIBER: "first",
    ids.KIND_DATAWRITER: "shapetype_data_writer",
    ids.KIND_DATAREADER: "shapetype_data_reader",
    ids.KIND_REQUESTER: "shapetype_requester",
    ids.KIND_REPLIER: "shapetype_replier",
}


def binary(kind, flags, second):
    if kind == ids.KIND_PARTICIPANT:
        return participant(name="two" if second else "one", flags=flags)
    if kind == ids.KIND_TOPIC:
        return topic(type_name=STRING if second else INT32, flags=flags)
    if kind in (ids.KIND_PUBLISHER, ids.KIND_SUBSCRIBER):
        return group(oid(1, kind), partitions=["p"] if second else None, flags=flags)
    if kind in (ids.KIND_DATAWRITER, ids.KIND_DATAREADER):
        return endpoint(oid(1, kind), parent=PARENTS[kind], depth=3 if second else 1, flags=flags)
    return service(oid(1, kind), name="b" if second else "a", flags=flags)


def specimen(form, kind, flags=NONE, second=False):
    """Return a CREATE of that kind; with ``second``, of another object with the same id."""
    if form == "binary":
        return binary(kind, flags, second)
    if form == "xml":
        return create(oid(1, kind), ids.AS_XML, XML[kind][second], PARENTS[kind], flags=flags)
    content = "second" if second else REFERENCES[kind]
    return create(oid(1, kind), ids.BY_REFERENCE, content, PARENTS[kind], flags=flags)


@pytest.fixture
def refs_board(tmp_path):
    file = tmp_path / "agent.refs"
    file.write_text(MORE_REFS)
    desk = Desk(refs=file)
    yield Board(desk)
    desk.close()


FORMS = ["binary", "xml", "reference"]


@pytest.mark.parametrize("form", FORMS)
def test_all_kinds_in_one_format(refs_board, form):
    answers = refs_board.ask(*[specimen(form, kind) for kind in KINDS])
    assert answers == [OK] * len(KINDS), refs_board.desk.log()
    bus = refs_board.desk.middleware.bus
    assert sum(map(len, bus.writers.values())) == 3  # one of each kind belongs to a service
    assert sum(map(len, bus.readers.values())) == 3


@pytest.mark.parametrize(
    ("flags", "equal", "different"),
    [(NONE, EXISTS, EXISTS), (REPLACE, OK, OK), (REUSE, MATCHED, MISMATCH), (BOTH, MATCHED, OK)],
    ids=["none", "replace", "reuse", "both"],
)
@pytest.mark.parametrize("kind", KINDS, ids=lambda kind: KIND_NAMES[kind])
@pytest.mark.parametrize("form", FORMS)
def test_creating_an_existing_object_follows_the_reuse_and_replace_flags(
    refs_board, form, kind, flags, equal, different
):
    board = refs_board
    client = board.desk.agent.clients[board.key]
    board.ask(*[specimen(form, item) for item in KINDS])
    before = client.objects[oid(1, kind)]
    for second, status in ((False, equal), (True, different)):
        answer = board.ask(specimen(form, kind, flags, second))
        assert answer == [status]
        now = client.objects[oid(1, kind)]
        assert (now is before) == (status != OK)
        before = now
    assert len(client.objects) == len(KINDS)
    assert not client.objects[oid(1, kind)].orphaned


def test_equal_counts_across_formats(board):
    board.ask(participant(name="one"), topic(name="Square", type_name="ShapeType"))
    same = [
        create(PARTICIPANT, ids.AS_XML, PARTICIPANT_XML.format("one"), 0, flags=REUSE),
        create(TOPIC, ids.AS_XML, TOPIC_XML.format("Square"), PARTICIPANT, flags=REUSE),
    ]
    assert board.ask(*same) == [MATCHED] * 2


def test_another_parent_is_a_mismatch(board):
    board.ask(participant(), participant(oid(2, 1)), topic())
    assert board.ask(topic(parent=oid(2, 1), flags=REUSE)) == [MISMATCH]
    assert board.ask(topic(parent=oid(2, 1), flags=BOTH)) == [OK]


def test_an_undefined_reference_is_an_error_that_names_the_remedy(board):
    assert board.ask(create(PARTICIPANT, ids.BY_REFERENCE, "nobody", 0)) == [UNKNOWN]
    assert "--refs FILE" in board.desk.log()


def test_a_topic_of_the_xml_writer_is_found_by_its_name(board):
    """The C examples name the writer's topic; the type may stand on the topic alone."""
    board.ask(participant(), topic(name="Square", type_name="ShapeType"), group())
    xml = "<dds><data_writer><topic><name>{}</name></topic></data_writer></dds>"
    assert board.ask(create(WRITER, ids.AS_XML, xml.format("Square"), PUBLISHER)) == [OK]
    assert board.ask(create(oid(2, 5), ids.AS_XML, xml.format("None"), PUBLISHER)) == [UNKNOWN]


def test_a_topic_that_ros_does_not_see_is_created_with_a_warning(board):
    assert board.ask(participant(), topic(name="rt/a"), topic(oid(2, 2), name="Square")) == [OK] * 3
    (warning,) = [line for line in board.desk.log().splitlines() if "not a ROS topic" in line]
    assert "topic: Square," in warning


# --- what cannot be created --------------------------------------------------------------


@pytest.mark.parametrize("kind", KINDS[1:], ids=lambda kind: KIND_NAMES[kind])
def test_unknown_parents(board, kind):
    before = KINDS[: KINDS.index(kind)]
    board.ask(*[specimen("binary", item) for item in before])
    client = board.desk.agent.clients[board.key]
    parent = (PARENTS[kind] & 0xF) | 0x70
    wrong = specimen("binary", kind)
    wrong = (wrong[0], wrong[1], wrong[2][:-2] + parent.to_bytes(2, "big"))
    assert board.ask(wrong) == [UNKNOWN]
    assert oid(1, kind) not in client.objects
    assert "does not exist" in board.desk.log()


def test_unknown_topic(board):
    board.ask(participant(), group())
    assert board.ask(endpoint(topic_id=oid(9, ids.KIND_TOPIC))) == [UNKNOWN]
    assert "its topic 0x009(2) does not exist" in board.desk.log()


@pytest.mark.parametrize(
    "kind", [0, ids.KIND_TYPE, ids.KIND_QOS_PROFILE, ids.KIND_APPLICATION, ids.KIND_CLIENT, 15]
)
def test_kinds_that_cannot_be_created(board, kind):
    board.ask(participant())
    for form, content in ((ids.IN_BINARY, b""), (ids.AS_XML, "<a/>")):
        assert board.ask(create(oid(1, kind), form, content, PARTICIPANT)) == [INVALID]


@pytest.mark.parametrize(
    ("xml", "why"),
    [
        ("<dds>", "broken XML"),
        ("<dds/>", "no <topic>"),
        ("<dds><topic/></dds>", "needs <name>"),
        ("<!DOCTYPE d [<!ENTITY a 'b'>]><dds>&a;</dds>", "document types and entities"),
        ("<d>" * 40 + "</d>" * 40, "nested deeper"),
        ("<dds>" + " " * 65_400 + "</dds>", "no <topic>"),
    ],
)
def test_bad_xml_is_refused_by_status_and_named_in_the_log(desk, xml, why):
    board = Board(desk, mtu=512)
    board.ask(participant())
    submessage = create(TOPIC, ids.AS_XML, xml, PARTICIPANT)
    raw = helpers.whole(submessage)
    parts = [raw[i : i + 400] for i in range(0, len(raw), 400)]
    for i, part in enumerate(parts):
        board.send(helpers.fragment(part, i == len(parts) - 1))
    assert board.statuses() == [INVALID]
    assert why in desk.log()
    assert board.ask(topic()) == [OK]


def test_the_middlewares_refusal_is_a_status(board):
    assert board.ask(participant(domain=233)) == [ids.STATUS_ERR_DDS_ERROR]
    assert "domain 233 is not within 0 to 232" in board.desk.log()


def test_most_objects(board):
    board.desk.agent.limits = Limits(objects=5)
    board.ask(participant())
    answers = board.ask(*[topic(oid(i, 2)) for i in range(6)])
    assert answers == [OK] * 4 + [ids.STATUS_ERR_RESOURCES] * 2
    assert board.ask(topic(oid(0, 2), flags=REPLACE)) == [OK]
    assert "over 5 objects" in board.desk.log()
    board.ask(delete(oid(0, 2)))
    assert board.ask(topic(oid(9, 2))) == [OK]


def test_most_participants(board):
    answers = []
    for i in range(40):
        answers += board.ask(participant(oid(i, 1)))
    assert answers.count(OK) == Limits().participants
    assert set(answers) == {OK, ids.STATUS_ERR_RESOURCES}
    assert len(board.desk.middleware.bus.nodes) == Limits().participants


@pytest.mark.parametrize("cut", range(1, 40, 3))
def test_truncated_creations_do_no_harm(board, cut):
    kind, flags, payload = topic()
    board.ask(participant())
    board.send((kind, flags, payload[:-cut]))
    board.payloads(ids.STATUS)
    assert board.ask(topic(oid(2, 2))) == [OK]


# --- domains and names ---------------------------------------------------------------------


@pytest.mark.parametrize(
    ("requested", "agent", "override", "domain"),
    [(7, 3, None, 7), (0, 3, None, 0), (255, 3, None, 3), (255, 3, 9, 9), (7, 3, 0, 0)],
)
@pytest.mark.parametrize("form", [ids.IN_BINARY, ids.AS_XML])
def test_domains(requested, agent, override, domain, form):
    desk = Desk(domain_of_agent=agent, domain_override=override)
    board = Board(desk)
    content = (
        ""
        if form == ids.AS_XML
        else helpers.built(helpers.entities.push_binary_participant, None, None)
    )
    assert board.ask(create(PARTICIPANT, form, content, requested)) == [OK]
    assert [node.domain for node in desk.middleware.bus.nodes] == [domain]
    desk.close()


@pytest.mark.parametrize(
    ("participant_name", "namespace", "name"),
    [
        (None, "/", "xrce_client"),
        ("", "/", "xrce_client"),
        ("/", "/", "xrce_client"),
        ("talker", "/", "talker"),
        ("/talker", "/", "talker"),
        ("ns/sub/talker", "/ns/sub", "talker"),
        ("//a//b", "/a", "b"),
        ("1st/2nd", "/_1st", "_2nd"),
        ("my node!", "/", "my_node_"),
        ("Ωμέγα", "/", "_____"),
    ],
)
def test_node_names(participant_name, namespace, name):
    assert node_name(participant_name) == (namespace, name)


# --- deleting --------------------------------------------------------------------------------

ALL = [
    participant(), topic(), group(), group(SUBSCRIBER), endpoint(),
    endpoint(READER, parent=SUBSCRIBER), service(), service(REPLIER),
]  # fmt: skip
ALL_IDS = [PARTICIPANT, TOPIC, PUBLISHER, SUBSCRIBER, WRITER, READER, REQUESTER, REPLIER]


@pytest.mark.parametrize("turn", range(len(ALL_IDS)))
@pytest.mark.parametrize("backwards", [False, True])
def test_delete_in_any_order(board, turn, backwards):
    order = ALL_IDS[turn:] + ALL_IDS[:turn]
    if backwards:
        order.reverse()
    assert board.ask(*ALL) == [OK] * 8
    assert board.ask(*[delete(item) for item in order]) == [OK] * 8
    assert board.ask(*[delete(item) for item in order]) == [UNKNOWN] * 8
    bus = board.desk.middleware.bus
    assert not bus.nodes and not any(bus.writers.values()) and not any(bus.readers.values())
    assert not board.desk.agent.clients[board.key].session.writers


def test_deleting_a_participant_closes_its_endpoints_alone(board):
    board.ask(*ALL)
    second_participant = [
        participant(oid(2, 1)), topic(oid(2, 2), parent=oid(2, 1)),
        group(oid(2, 3), parent=oid(2, 1)), endpoint(oid(2, 5), oid(2, 2), oid(2, 3)),
    ]  # fmt: skip
    assert board.ask(*second_participant) == [OK] * 4
    board.ask(delete(PARTICIPANT))
    bus = board.desk.middleware.bus
    assert sum(map(len, bus.writers.values())) == 1
    assert sum(map(len, bus.readers.values())) == 0
    assert list(board.desk.agent.clients[board.key].session.writers) == [oid(2, 5)]
    board.send(write_data(WRITER, b"x"), read_data(READER))
    assert board.statuses() == [UNKNOWN]
    assert "unknown object" in board.desk.log()


def test_the_writer_closes_though_its_publisher_was_deleted_before_the_participant(board):
    board.ask(*publisher_entities())
    board.ask(delete(PUBLISHER), delete(PARTICIPANT))
    assert not board.desk.agent.clients[board.key].session.writers
    board.send(write_data(WRITER, b"x"))
    assert "unknown object" in board.desk.log()


@pytest.mark.parametrize("flags", [REUSE, REPLACE, BOTH])
def test_an_object_that_lost_its_endpoint_is_created_anew(board, flags):
    board.ask(*ALL)
    board.ask(delete(PARTICIPANT), participant())
    assert board.ask(endpoint(), endpoint(READER, parent=SUBSCRIBER)) == [EXISTS] * 2
    again = [
        endpoint(flags=flags), endpoint(READER, parent=SUBSCRIBER, flags=flags),
        service(flags=flags), service(REPLIER, flags=flags),
    ]  # fmt: skip
    assert board.ask(*again) == [OK] * 4
    board.send(read_data(READER), write_data(WRITER, b"data"))
    board.settle()
    assert board.samples() == [b"data"]


def test_replacing_a_participant_replaces_its_node(board):
    board.ask(*publisher_entities())
    board.ask(participant(name="other", flags=BOTH))
    (node,) = board.desk.middleware.bus.nodes
    assert node.full_name == "/other"
    assert board.ask(endpoint(flags=BOTH)) == [OK]


def test_submessages_behind_a_delete_of_the_client_create_nothing(desk):
    board = Board(desk)
    board.send(delete(ids.OBJECT_CLIENT), *publisher_entities(), write_data(WRITER, b"x"))
    assert board.statuses() == [OK]
    assert not desk.agent.clients and not desk.middleware.bus.nodes


# --- writing and reading ----------------------------------------------------------------------


@pytest.fixture
def pair():
    """Two boards that publish to each other's subscriptions, on one agent."""
    desk = Desk()
    first, second = Board(desk, 1, 0x11), Board(desk, 2, 0x22)
    first.ask(*publisher_entities())
    second.ask(*subscriber_entities())
    yield first, second
    desk.close()


def publish(first, second, *samples, stream=ids.STREAM_RELIABLE):
    """Write samples on ``first``; deliver to ``second`` what it requested."""
    for sample in samples:
        first.send(write_data(WRITER, sample), stream=stream)
        second.settle()


def test_unlimited_reading(pair):
    first, second = pair
    second.send(read_data(READER, request=77))
    publish(first, second, *[bytes([i]) * 4 for i in range(50)])
    payloads = second.payloads(ids.DATA)
    assert payloads == [b"\0\x4d\0\x16" + bytes([i]) * 4 for i in range(50)]


def test_no_sample_is_sent_without_read_data(pair):
    first, second = pair
    publish(first, second, b"kept")
    assert second.samples() == []
    second.send(read_data(READER, control=None))
    assert second.samples() == [b"kept"]
    publish(first, second, b"more")
    assert second.samples() == []


def test_max_samples_ends_a_delivery_and_a_new_request_goes_on(pair):
    first, second = pair
    second.send(read_data(READER, control=(2, 0, 0, 0), request=1))
    publish(first, second, b"a", b"b", b"c")
    assert second.samples() == [b"a", b"b"]
    second.send(read_data(READER, control=(2, 0, 0, 0), request=2))
    publish(first, second, b"d", b"e")
    assert [item[:2] + item[4:] for item in second.payloads(ids.DATA)] == [b"\0\2c", b"\0\2d"]


def test_a_request_replaces_the_one_before(pair):
    first, second = pair
    second.send(read_data(READER, request=1), read_data(READER, 1, request=2))
    publish(first, second, b"a")
    assert second.payloads(ids.DATA) == [b"\0\2\0\x16a"]


def test_cancelling_is_confirmed_on_the_best_effort_stream(pair):
    first, second = pair
    second.send(read_data(READER))
    expected = dict(second.expected)
    second.polite = False
    sent = second.desk.hear(
        message([read_data(READER, control=(0, 0, 0, 0), request=9)], 0x80, 2, 0x81, second.key), 2
    )
    heads = [parse(item)[0] for _, item in sent]
    statuses = [s for _, item in sent for s in parse(item)[1] if s[0] == ids.STATUS]
    assert (0x81, 1, 0) in heads
    assert statuses == [(ids.STATUS, 1, b"\0\x09\0\x16\0\0")]
    publish(first, second, b"a")
    assert second.samples() == [] and second.expected == expected


def test_max_elapsed_time_ends_a_delivery(pair):
    first, second = pair
    second.send(read_data(READER, control=(0xFFFF, 5, 0, 0)))
    publish(first, second, b"early")
    second.wait(5000)
    publish(first, second, b"late")
    assert second.samples() == [b"early"]
    second.send(read_data(READER))
    assert second.samples() == [b"late"]


def test_min_pace_period_and_max_bytes_per_second_delay_samples(pair):
    first, second = pair
    second.send(read_data(READER, control=(0xFFFF, 0, 0, 100)))
    publish(first, second, b"a", b"b", b"c")
    assert second.samples() == [b"a"]
    second.wait(99)
    assert second.samples() == []
    second.wait(1)
    assert second.samples() == [b"b"]
    second.send(read_data(READER, control=(0xFFFF, 0, 10, 0)))
    assert second.samples() == [b"c"]
    publish(first, second, bytes(20), b"next")
    second.wait(99)
    assert second.samples() == []
    second.wait(1)
    assert second.samples() == [bytes(20)]
    second.wait(1999)
    assert second.samples() == []
    second.wait(1)
    assert second.samples() == [b"next"]


def test_a_reset_resumes_a_delivery_that_waited_for_room(pair):
    first, second = pair
    second.send(read_data(READER))
    second.polite = False
    publish(first, second, *[bytes([i]) for i in range(20)])
    assert len(second.samples()) == 16
    second.polite = True
    second.expected.clear()
    second.sequence.clear()
    second.send(sub(ids.RESET), stream=0)
    assert second.samples() == [bytes([i]) for i in range(16, 20)]


def test_more_than_64_kilobytes_both_ways(pair):
    first, second = pair
    second.send(read_data(READER))
    sample = bytes(i * 31 & 0xFF for i in range(150_000))
    raw = helpers.whole(write_data(WRITER, sample))
    for start in range(0, len(raw), 500):
        first.send(helpers.fragment(raw[start : start + 500], start + 500 >= len(raw)))
    second.settle()
    assert second.samples() == [sample]


def test_a_delivery_on_a_stream_over_the_limit_ends_with_a_warning(pair):
    first, second = pair
    for stream in range(0x81, 0xB0):
        second.send(read_data(READER, stream))
        publish(first, second, b"x")
    assert "delivery ended" in first.desk.log()
    publish(first, second, b"y")


@pytest.mark.parametrize("object_id", [WRITER, TOPIC, 0x0996, ids.OBJECT_CLIENT])
def test_read_data_of_an_object_that_is_no_reader_is_refused(board, object_id):
    board.ask(*publisher_entities())
    assert board.ask(read_data(object_id)) == [UNKNOWN]


def test_filters_and_formats_are_refused(pair):
    _, second = pair
    assert second.ask(read_data(READER, content_filter="x > 1")) == [INVALID]
    assert second.ask(read_data(READER, data_format=ids.FORMAT_SAMPLE_SEQ)) == [INVALID]


def test_write_data_to_an_object_that_is_no_writer_is_logged(board):
    board.ask(*subscriber_entities())
    for object_id in (WRITER, READER, TOPIC, 0xFFFF, 0):
        board.send(write_data(object_id, b"data"))
    assert "unknown object" in board.desk.log()
    assert board.ask(topic(oid(2, 2))) == [OK]


@pytest.mark.parametrize("size", range(5))
def test_write_data_without_a_sample(board, size):
    board.ask(*publisher_entities())
    board.send(sub(ids.WRITE_DATA, b"\0\1\0\x15"[:size]))
    assert f"WRITE_DATA of {size} bytes" in board.desk.log()
    assert board.ask(topic(oid(2, 2))) == [OK]


@pytest.mark.parametrize("flags", [ids.FORMAT_SAMPLE, ids.FORMAT_PACKED_SAMPLES])
def test_write_data_in_other_formats(board, flags):
    board.ask(*publisher_entities())
    board.send(write_data(WRITER, b"data", flags=1 | flags))
    assert "data format" in board.desk.log() and "not supported" in board.desk.log()


def test_partitions_of_the_publisher_apply_to_its_writers(board):
    board.ask(participant(), topic(), group(partitions=["a", "b"]), endpoint())
    (writers,) = [writer for writer in board.desk.middleware.bus.writers.values() if writer]
    assert writers[0].qos.partitions == ("a", "b")


# --- services ---------------------------------------------------------------------------------


def services(replier_key=0x11, requester_key=0x22):
    desk = Desk()
    server, asker = Board(desk, 1, replier_key), Board(desk, 2, requester_key)
    server.ask(participant(), service(REPLIER))
    asker.ask(participant(), service(REQUESTER))
    server.send(read_data(REPLIER, request=3))
    asker.send(read_data(REQUESTER, request=4))
    return desk, server, asker


def test_a_service_across_two_clients():
    desk, server, asker = services()
    for number in range(300):
        body = struct.pack("<II", number, 1)
        asker.send(write_data(REQUESTER, body, request=0x1000 + number))
        server.settle()
        (request,) = server.payloads(ids.DATA)
        assert request[:4] == b"\0\3\0\x18" and request[28:] == body
        answer = struct.pack("<I", number + 1)
        server.send(write_data(REPLIER, request[4:28] + answer))
        server.settle()
        (reply,) = asker.payloads(ids.DATA)
        assert reply[:4] == b"\0\4\0\x17"
        assert reply[4:] == (0x1000 + number).to_bytes(2, "big") + b"\0\x17" + answer
    desk.close()


def test_replies_reach_their_requester_alone_in_any_order():
    desk, server, asker = services()
    other_client = Board(desk, 3, 0x33)
    other_client.ask(participant(), service(REQUESTER))
    other_client.send(read_data(REQUESTER))
    asker.send(write_data(REQUESTER, b"1234", request=1))
    asker.send(write_data(REQUESTER, b"5678", request=2))
    server.settle()
    requests = server.payloads(ids.DATA)
    for request in reversed(requests):
        server.send(write_data(REPLIER, request[4:28] + b"re: " + request[28:]))
    server.settle()
    assert [item[4:6] + item[8:] for item in asker.payloads(ids.DATA)] == [
        b"\0\2re: 5678", b"\0\1re: 1234"
    ]  # fmt: skip
    assert other_client.payloads(ids.DATA) == []
    desk.close()


def test_replies_to_other_requesters_do_not_hide_its_own_reply():
    """Each requester takes all replies of a service, here one at a time."""
    desk, server, asker = services()
    other_client = Board(desk, 3, 0x33)
    other_client.ask(participant(), service(REQUESTER))
    for i in range(3):
        other_client.send(write_data(REQUESTER, bytes([i]) * 4))
    asker.send(write_data(REQUESTER, b"mine"))
    server.settle()
    asker.send(read_data(REQUESTER, control=(0, 0, 0, 0)))
    for request in server.payloads(ids.DATA):
        server.send(write_data(REPLIER, request[4:28] + b"re: " + request[28:]))
    asker.payloads(ids.DATA)
    asker.send(read_data(REQUESTER, control=None))
    assert [item[8:] for item in asker.payloads(ids.DATA)] == [b"re: mine"]
    desk.close()


def test_a_second_reply_to_one_request_does_not_hide_the_next_reply():
    desk, server, asker = services()
    asker.send(read_data(REQUESTER, control=(0, 0, 0, 0)))
    for request in (1, 2):
        asker.send(write_data(REQUESTER, b"ask!", request=request))
    server.settle()
    first, second = server.payloads(ids.DATA)
    for request in (first, first, second):
        server.send(write_data(REPLIER, request[4:28] + b"answer"))
    for number in (1, 2):
        asker.send(read_data(REQUESTER, control=None))
        (reply,) = asker.payloads(ids.DATA)
        assert reply[4:6] == number.to_bytes(2, "big")
    desk.close()


def test_requests_without_replies_take_bounded_memory():
    desk, server, asker = services()
    for i in range(1000):
        asker.send(write_data(REQUESTER, b"data", request=i & 0xFF))
        desk.settle()
    requester = desk.agent.clients[asker.key].objects[REQUESTER]
    assert len(requester.endpoint._pending) <= 256
    desk.close()


@pytest.mark.parametrize(
    "body",
    [b"", bytes(23), bytes(16) + b"\xff" * 8 + b"body"],
    ids=["empty", "short", "negative"],
)
def test_malformed_replies_are_logged_and_the_service_goes_on(body):
    desk, server, asker = services()
    server.send(write_data(REPLIER, body))
    assert "deserialization error" in desk.log()
    asker.send(write_data(REQUESTER, b"ask!"))
    server.settle()
    assert len(server.payloads(ids.DATA)) == 1
    desk.close()


def test_a_middleware_error_of_a_request_is_a_fault_and_a_status():
    desk, _, asker = services()

    def fail(cdr):
        raise MiddlewareError("big-endian service payloads cannot be passed on")

    desk.agent.clients[asker.key].objects[REQUESTER].endpoint._requester.request = fail
    statuses = asker.ask(write_data(REQUESTER, b"data"), topic())
    assert statuses == [ids.STATUS_ERR_DDS_ERROR, OK]
    assert "big-endian service payloads" in desk.log()
    desk.close()


# --- the rest ---------------------------------------------------------------------------------


@pytest.mark.parametrize("stream", [0, 1, 0x80])
def test_get_info_within_a_session(board, stream):
    board.send(get_info(request=0x0708), stream=stream)
    (info,) = board.payloads(ids.INFO)
    request, object_id, status, info_mask, _ = session.pull_info(Reader(info, 0, len(info)))
    assert (request, object_id, status, info_mask) == (0x0708, ids.OBJECT_AGENT, OK, 1)


def test_timestamp(board):
    before = time.time_ns()
    board.send(sub(ids.TIMESTAMP, struct.pack("<II", 12, 345)), stream=0)
    (reply,) = board.payloads(ids.TIMESTAMP_REPLY)
    transmit, receive, originate = session.pull_timestamp_reply(Reader(reply, 0, len(reply)))
    assert originate == (12, 345)
    times = [seconds * 1_000_000_000 + ns for seconds, ns in (receive, transmit)]
    assert before <= times[0] <= times[1] <= time.time_ns()


@pytest.mark.parametrize(
    "kind", [ids.CREATE_CLIENT, ids.STATUS, ids.STATUS_AGENT, ids.DATA, ids.TIMESTAMP_REPLY, 16, 99]
)
def test_submessages_that_are_not_for_an_agent(board, kind):
    board.send(sub(kind, bytes(20)), topic())
    assert f"submessage {kind} is not for an agent" in board.desk.log()
    assert board.ask(participant()) == [OK]


def test_an_info_answers_our_probe_silently(board):
    board.send(sub(ids.INFO, bytes(20)))
    assert "error" not in board.desk.log()


def test_statuses_use_a_stream_of_the_reliability_of_the_request(board):
    board.send(participant(request=0x0102))
    sent = board.desk.hear(message([topic(request=0x0304)], 1, 0), 1)
    assert parse(sent[0][1]) == (
        (0x81, 1, 0), [(ids.STATUS, 1, bytes.fromhex("0304" "0012" "0000"))]
    )  # fmt: skip
    sent = board.desk.hear(message([group()], 0x85, 0), 1)
    assert (0x81, 0x80, 1) in [parse(item)[0] for _, item in sent]


# --- types that differ -----------------------------------------------------------------------


def test_a_topic_of_another_type_is_named_with_both_types():
    bus = Bus()
    desk, elsewhere = Desk(bus), Desk(bus)
    Board(elsewhere).ask(*subscriber_entities(type_name=STRING))
    Board(desk).ask(*publisher_entities(type_name=INT32))
    warnings = [line for line in desk.log().splitlines() if "type differs" in line]
    assert len(warnings) == 1
    assert " warning " in warnings[0]
    for word in ("rt/chatter", f"type: {INT32}", f"elsewhere on the network: {STRING}"):
        assert word in warnings[0]
    Board(desk, 2, 0x77).ask(*publisher_entities(type_name=INT32))
    assert desk.log().count("type differs") == 1
    elsewhere.close()
    desk.close()


def test_topics_of_other_names_and_domains_may_have_other_types(desk):
    Board(desk, 1, 0x11).ask(*publisher_entities(type_name=INT32))
    Board(desk, 2, 0x22).ask(*publisher_entities("rt/other", STRING))
    Board(desk, 3, 0x33).ask(*publisher_entities(type_name=STRING, domain=5))
    assert "type differs" not in desk.log()


def test_refused_objects_are_known_until_they_are_created_or_no_longer_wanted():
    desk = Desk()
    board = Board(desk)
    other = oid(2, ids.KIND_TOPIC)
    board.ask(topic(), topic(other))  # they have no participant
    client = desk.agent.clients[board.key]
    why = "its participant 0x001(1) does not exist"
    assert client.refused == {TOPIC: why, other: why}
    board.ask(participant(), topic())
    assert client.refused == {other: why}
    board.ask(delete(other))
    assert client.refused == {}
    desk.close()


def test_a_refusal_to_replace_an_object_that_stays_is_no_missing_object():
    desk = Desk()
    board = Board(desk)
    board.ask(*publisher_entities())
    client = desk.agent.clients[board.key]
    assert board.ask(xml(TOPIC, "<dds><topic", PARTICIPANT, flags=REPLACE)) == [INVALID]
    assert client.refused == {}
    desk.close()


def test_a_session_that_is_established_again_has_no_refused_objects():
    desk = Desk()
    board = Board(desk)
    board.ask(topic())
    assert desk.agent.clients[board.key].refused
    Board(desk)
    assert not desk.agent.clients[board.key].refused
    desk.close()


def test_few_refused_objects_are_remembered_however_many_there_are():
    desk = Desk()
    board = Board(desk)
    for number in range(1, 100):
        board.send(topic(oid(number, ids.KIND_TOPIC)))
        board.send(by_reference(oid(number, ids.KIND_DATAWRITER), "x" * 300, PUBLISHER))
    refused = desk.agent.clients[board.key].refused
    assert len(refused) == 16 and max(map(len, refused.values())) <= 200
    desk.close()


def test_refused_objects_write_a_limited_number_of_log_lines():
    desk = Desk(clock=Clock(lambda: 100.0))  # everything happens within one second
    board = Board(desk)
    for _ in range(300):
        board.send(topic())  # it has no participant
    assert desk.log().count("topic refused") < 5
    for number in range(1, 300):
        board.send(topic(oid(number, ids.KIND_TOPIC)))
    assert 10 < desk.log().count("topic refused") < 60
    assert board.ask(participant(), topic()) == [ids.STATUS_OK] * 2
    desk.close()
