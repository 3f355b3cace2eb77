"""Types, QoS profiles, applications, GET_INFO about them, and invalid representations."""

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from support.examples import examples
from unit.agent import helpers
from unit.agent.helpers import (
    APPLICATION,
    APPLICATION_XML,
    EXISTS,
    INT32,
    INVALID,
    MATCHED,
    MISMATCH,
    OK,
    PARTICIPANT,
    PUBLISHER,
    QOS,
    QOS_XML,
    READER,
    REPLACE,
    REQUESTER,
    RESOURCES,
    REUSE,
    SUBSCRIBER,
    TOPIC,
    TYPE,
    TYPES_XML,
    UNKNOWN,
    WRITER,
    Board,
    Desk,
    by_reference,
    create,
    delete,
    endpoint,
    group,
    of,
    oid,
    participant,
    publisher_entities,
    read_data,
    service,
    subscriber_entities,
    topic,
    write_data,
    writer_of,
    xml,
)

from uros.agent.objects import application
from uros.agent.objects.xml_profiles import ProfileError, parse_qos_profiles, parse_types
from uros.agent.policy.limits import Limits
from uros.qos import (
    DurabilityPolicy,
    QoSProfile,
    ReliabilityPolicy,
)
from uros.wire import entities, ids
from uros.wire.cdr import Writer


@pytest.fixture
def refs_board(tmp_path):
    file = tmp_path / "agent.refs"
    inside = "".join(
        item.replace("<dds>", "").replace("</dds>", "")
        for item in (TYPES_XML, QOS_XML, APPLICATION_XML)
    )
    file.write_text(f"<dds>{inside}</dds>")
    desk = Desk(refs=file)
    yield Board(desk)
    desk.close()


# --- types ---------------------------------------------------------------------------------


def referring_topic(reference, type_name=None, object_id=TOPIC, **more):
    w = Writer(bytearray(4096))
    w.string("rt/chatter")
    for value in (reference, type_name):
        w.boolean(value is not None)
        if value is not None:
            w.string(value)
    content = bytes(w.buf[: w.offset])
    return create(object_id, ids.IN_BINARY, content, PARTICIPANT, **more)


@pytest.mark.parametrize("name", ["ShapeType", INT32])
def test_a_topic_names_its_type_by_reference(board, name):
    assert board.ask(participant(), xml(TYPE, TYPES_XML), referring_topic(name)) == [OK] * 3
    assert board.ask(group(), endpoint()) == [OK] * 2
    assert writer_of(board).type_name == name
    assert board.ask(delete(TYPE)) == [OK]
    assert board.ask(referring_topic(name, object_id=oid(2, 2))) == [UNKNOWN]
    assert "create an object of kind TYPE" in board.desk.log()


def test_a_type_of_the_agents_files(refs_board):
    board = refs_board
    assert board.ask(participant(), referring_topic("ShapeType")) == [OK] * 2
    assert board.ask(by_reference(TYPE, INT32), by_reference(oid(2, 10), "Nobody")) == [
        OK, UNKNOWN,
    ]  # fmt: skip
    assert board.ask(by_reference(TYPE, INT32, flags=REUSE)) == [MATCHED]
    assert board.ask(by_reference(TYPE, "ShapeType", flags=REUSE)) == [MISMATCH]


def test_the_name_of_a_type_has_precedence_over_its_reference(board):
    assert board.ask(participant(), referring_topic("nobody", "Given")) == [OK] * 2
    assert of(board).objects[TOPIC].spec.type_name == "Given"


def test_a_topic_without_any_type(board):
    assert board.ask(participant(), referring_topic(None)) == [OK, INVALID]
    assert "has no type" in board.desk.log()


@pytest.mark.parametrize("kind", [ids.KIND_TYPE, ids.KIND_QOS_PROFILE, ids.KIND_APPLICATION])
@pytest.mark.parametrize("content", [b"", b"\0\0\0\0"])
def test_kinds_without_a_binary_format_are_refused(board, kind, content):
    assert board.ask(create(oid(1, kind), ids.IN_BINARY, content, 0)) == [INVALID]
    assert "has no binary format" in board.desk.log()


@pytest.mark.parametrize("kind", [ids.KIND_TYPE, ids.KIND_QOS_PROFILE, ids.KIND_APPLICATION])
@pytest.mark.parametrize("text", ["", "<dds/>", "<dds><types/></dds>", "<struct name='x'/>", "<"])
def test_xml_that_defines_nothing(board, kind, text):
    assert board.ask(xml(oid(1, kind), text)) == [INVALID]
    assert not of(board).objects


@pytest.mark.parametrize("kind", [0, 9, ids.KIND_AGENT, ids.KIND_CLIENT, ids.KIND_OTHER])
@pytest.mark.parametrize("form", [ids.BY_REFERENCE, ids.AS_XML])
def test_kinds_that_no_client_creates_are_refused(board, kind, form):
    assert board.ask(create(oid(1, kind), form, "x", 0)) == [INVALID]
    assert f"objects of kind {kind} cannot be created" in board.desk.log()


def test_names_of_types():
    assert parse_types(TYPES_XML) == {"ShapeType", INT32}
    nested = "<type><enum name='E'/></type><module name='m'><union name='U'/></module>"
    assert parse_types(f"<types>{nested}</types>") == {"E", "m::U"}


# --- QoS profiles --------------------------------------------------------------------------


def with_qos(tag, base, inside=""):
    return (
        f"<dds><{tag}><topic><name>rt/q</name><dataType>T</dataType></topic>"
        f'<{tag.replace("_", "")}_qos base_name="{base}">{inside}</{tag.replace("_", "")}_qos>'
        f"</{tag}></dds>"
    )


@pytest.mark.parametrize("name", ["slow", "Lib::slow"])
def test_entities_take_the_qos_of_a_profile_object(board, name):
    board.ask(participant(), group(), group(SUBSCRIBER))
    assert board.ask(xml(QOS, QOS_XML)) == [OK]
    assert board.ask(
        xml(WRITER, with_qos("data_writer", name), PUBLISHER),
        xml(READER, with_qos("data_reader", name), SUBSCRIBER),
    ) == [OK, OK], board.desk.log()
    qos = writer_of(board).qos
    assert qos.reliability == ReliabilityPolicy.BEST_EFFORT
    assert (qos.depth, qos.deadline_ms, qos.user_data) == (7, 2000, b"hello")
    qos = of(board).objects[READER].endpoint._reader.qos
    assert (qos.depth, qos.separation_ms, qos.deadline_ms) == (3, 1000, None)


def test_the_qos_of_an_entity_has_precedence_over_its_profile(board):
    board.ask(participant(), group(), xml(QOS, QOS_XML))
    inside = "<history><depth>2</depth></history>"
    assert board.ask(xml(WRITER, with_qos("data_writer", "Lib::kept", inside), PUBLISHER)) == [OK]
    qos = writer_of(board).qos
    assert (qos.depth, qos.deadline_ms) == (2, 2000)
    assert qos.durability == DurabilityPolicy.TRANSIENT_LOCAL


def test_partitions_of_a_qos_profile(board):
    board.ask(participant(), topic(), xml(QOS, QOS_XML))
    publisher = '<dds><publisher><publisher_qos base_name="slow"/></publisher></dds>'
    assert board.ask(xml(PUBLISHER, publisher, PARTICIPANT), endpoint()) == [OK] * 2
    assert writer_of(board).qos.partitions == ("left",)


def test_a_qos_profile_of_the_agents_files(refs_board):
    board = refs_board
    board.ask(participant(), group())
    assert board.ask(xml(WRITER, with_qos("data_writer", "Lib::slow"), PUBLISHER)) == [OK]
    assert writer_of(board).qos.depth == 7
    assert board.ask(by_reference(QOS, "Lib::kept"), by_reference(oid(2, 11), "no")) == [
        OK, UNKNOWN,
    ]  # fmt: skip


def test_an_undefined_qos_profile_is_an_error(board):
    board.ask(participant(), group())
    assert board.ask(xml(WRITER, with_qos("data_writer", "none"), PUBLISHER)) == [UNKNOWN]
    assert "create an object of kind QOS_PROFILE" in board.desk.log()


def test_qos_profiles_that_are_each_others_base_are_refused(board):
    board.ask(participant(), group())
    text = (
        '<dds><qos_profile name="a" base_name="b"/>'
        '<qos_profile name="b"><datawriter_qos base_name="a"/></qos_profile></dds>'
    )
    assert board.ask(xml(QOS, text)) == [OK]
    assert board.ask(xml(WRITER, with_qos("data_writer", "a"), PUBLISHER)) == [INVALID]
    assert "have bases more than" in board.desk.log()


@given(st.text(alphabet="<>/ abdsqoe_prfilnm=\"'", max_size=200))
def test_any_text_is_profiles_or_an_error(text):
    for function in (parse_types, parse_qos_profiles):
        with pytest.raises(ProfileError):
            function(text)


# --- applications ----------------------------------------------------------------------------


def test_an_application_creates_and_deletes_all_its_entities(board):
    bus = board.desk.middleware.bus
    assert board.ask(xml(APPLICATION, APPLICATION_XML)) == [OK], board.desk.log()
    nodes = [(node.domain, node.full_name) for node in bus.nodes]
    assert nodes == [(3, "/arm/left"), (4, "/right")]
    assert sum(map(len, bus.writers.values())) == 3  # one of them belongs to the service
    assert sum(map(len, bus.readers.values())) == 2
    objects = of(board).objects
    assert [objects[item].kind for item in (0x11, 0x33, 0x45, 0x56, 0x65, 0x78)] == [
        1,
        3,
        5,
        6,
        5,
        8,
    ]
    board.send(read_data(0x56))
    ground = board.desk.middleware.create_node(3, "/", "ground")
    out = ground.create_reader("rt/joints", "T", QoSProfile(), lambda: None)
    board.send(write_data(0x45, b"one"), write_data(0x65, b"two"))
    assert [item[4:] for item in out.take(9)] == [b"one", b"two"]
    ground.create_writer("rt/orders", "T", QoSProfile()).write(b"\0\1\0\0go")
    board.settle()
    assert board.samples() == [b"go"]
    ground.close()
    assert board.ask(delete(APPLICATION)) == [OK]
    assert not of(board).objects and not bus.nodes and not of(board).session.writers
    assert board.ask(delete(0x45)) == [UNKNOWN]


def test_an_application_by_reference(refs_board):
    board = refs_board
    for name in ("arm", "Apps::arm"):
        assert board.ask(by_reference(APPLICATION, name)) == [OK]
        assert len(board.desk.middleware.bus.nodes) == 2
        assert board.ask(delete(APPLICATION)) == [OK]
    assert board.ask(by_reference(APPLICATION, "leg")) == [UNKNOWN]


def test_creating_an_application_that_exists(board):
    first = xml(APPLICATION, APPLICATION_XML)
    board.ask(first)
    assert board.ask(first) == [EXISTS]
    assert board.ask(xml(APPLICATION, APPLICATION_XML, flags=REUSE)) == [MATCHED]
    different_xml = APPLICATION_XML.replace("rt/joints", "rt/other")
    assert board.ask(xml(APPLICATION, different_xml, flags=REUSE)) == [MISMATCH]
    assert board.ask(xml(APPLICATION, different_xml, flags=REPLACE)) == [OK]
    assert len(board.desk.middleware.bus.nodes) == 2
    # With REUSE, an application that lost a part is created anew.
    board.ask(delete(0x45))
    assert board.ask(xml(APPLICATION, different_xml, flags=REUSE | REPLACE)) == [OK]
    assert 0x45 in of(board).objects


def test_an_application_with_a_part_that_cannot_be_created_leaves_nothing(board):
    bus = board.desk.middleware.bus
    board.ask(participant(oid(9, 1), name="mine", domain=9))
    for text, status, why in (
        (APPLICATION_XML.replace('"3"', '"233"'), ids.STATUS_ERR_DDS_ERROR, "domain 233"),
        (APPLICATION_XML.replace("<domainId>4", "<domainId>234"), ids.STATUS_ERR_DDS_ERROR, "234"),
        (APPLICATION_XML.replace("0x0010", "0x0090"), EXISTS, "0x009(1) exists already"),
        (APPLICATION_XML.replace('register_type_ref="T"', ""), INVALID, "needs <name>"),
    ):
        assert board.ask(xml(APPLICATION, text)) == [status]
        assert why in board.desk.log()
        assert list(of(board).objects) == [oid(9, 1)] and len(bus.nodes) == 1
        assert not of(board).session.writers


@pytest.mark.parametrize(
    ("inside", "why"),
    [
        ("", "no <domain_participant>"),
        ("<participant><publisher><data_writer/></publisher></participant>", "without object_id"),
        ("<participant><replier/></participant>", "without object_id"),
        ("<participant object_id='x'/>", "object_id is 'x', not a number"),
        ("<participant object_id='0x10000'/>", "not a number of 16 bits"),
        ("<participant domain_id='99999'/>", "not a number of 16 bits"),
        ("<participant object_id='1'/><participant object_id='0x2'/>", "two of its entities"),
        ("<participant><publisher><data_reader object_id='3'/></publisher></participant>",
         "a <publisher> has no <data_reader>"),
        ("<participant>" + "<topic/>" * 1100 + "</participant>",
         f"over {application.MAX_ITEMS} entities"),
    ],
)  # fmt: skip
def test_invalid_applications_are_refused(board, inside, why):
    text = f"<application>{inside}</application>"
    raw = helpers.whole(xml(APPLICATION, text))
    for start in range(0, len(raw), 400):
        board.send(helpers.fragment(raw[start : start + 400], start + 400 >= len(raw)))
    assert board.statuses() == [INVALID]
    assert why in board.desk.log()
    assert not of(board).objects


def test_the_entities_of_an_application_count_towards_the_limit(board):
    board.desk.agent.limits = Limits(objects=10)
    assert board.ask(xml(APPLICATION, APPLICATION_XML)) == [RESOURCES]
    assert not of(board).objects
    board.desk.agent.limits = Limits(objects=11)
    assert board.ask(xml(APPLICATION, APPLICATION_XML)) == [OK]
    many = "<application>" + "<participant/>" * 33 + "</application>"
    assert board.ask(xml(oid(2, 12), many)) == [RESOURCES]


def test_the_default_domain_of_an_application():
    desk = Desk(domain_of_agent=7)
    board = Board(desk)
    assert board.ask(xml(APPLICATION, "<application><participant/></application>")) == [OK]
    assert [node.domain for node in desk.middleware.bus.nodes] == [7]
    desk.close()


def test_deleting_a_client_deletes_its_application(board):
    board.ask(xml(APPLICATION, APPLICATION_XML), xml(TYPE, TYPES_XML), xml(QOS, QOS_XML))
    board.desk.agent.delete_client(board.key)
    assert not board.desk.middleware.bus.nodes


TAGS = st.sampled_from(
    ["participant", "domain_participant", "topic", "publisher", "subscriber", "data_writer",
     "data_reader", "requester", "replier", "name", "x"]
)  # fmt: skip
ATTRIBUTES = st.dictionaries(
    st.sampled_from(["object_id", "domain_id", "name", "topic_ref", "register_type_ref",
                     "service_name", "request_type", "reply_type"]),
    st.sampled_from(["1", "0x0020", "", "rt/a", "T", "99999", "-1"]),
)  # fmt: skip
ELEMENTS = st.recursive(
    st.tuples(TAGS, ATTRIBUTES, st.just([])),
    lambda inner: st.tuples(TAGS, ATTRIBUTES, st.lists(inner, max_size=4)),
    max_leaves=12,
)


def written(element):
    tag, attributes, inner = element
    attributes_text = "".join(f' {name}="{value}"' for name, value in attributes.items())
    return f"<{tag}{attributes_text}>{''.join(map(written, inner))}</{tag}>"


@settings(max_examples=examples(200), deadline=None)
@given(st.lists(ELEMENTS, max_size=4))
def test_any_application_is_created_whole_or_not_at_all(inside):
    desk = Desk()
    board = Board(desk, mtu=60_000)
    text = f"<application>{''.join(map(written, inside))}</application>"
    (status,) = board.ask(xml(APPLICATION, text))
    objects = of(board).objects
    if status == OK:
        assert len(objects) == 1 + len(objects[APPLICATION].parts)
        board.ask(delete(APPLICATION))
    bus = desk.middleware.bus
    assert not objects and not bus.nodes
    assert not any(bus.writers.values()) and not any(bus.readers.values())
    desk.close()


# --- content filters and data formats ----------------------------------------------------------


def filtered_reader():
    w = Writer(bytearray(256))
    entities.push_binary_endpoint(w, TOPIC, 3, 10, reader=True)
    w.offset -= 1
    w.boolean(True)
    w.string("x > 3")
    return bytes(w.buf[: w.offset])


FILTER_XML = (
    "<dds><data_reader{}><topic><name>rt/chatter</name><dataType>T</dataType></topic>"
    "<content_filter><expression>x &gt; 3</expression></content_filter></data_reader></dds>"
)


@pytest.mark.parametrize("form", [ids.IN_BINARY, ids.AS_XML, ids.BY_REFERENCE])
def test_readers_with_a_content_filter_are_refused(tmp_path, form):
    """The C++ agent creates them and filters nothing."""
    file = tmp_path / "agent.refs"
    file.write_text(FILTER_XML.format(' profile_name="filtered"'))
    desk = Desk(refs=file)
    board = Board(desk)
    board.ask(participant(), topic(), group(SUBSCRIBER))
    content = {
        ids.IN_BINARY: filtered_reader(),
        ids.AS_XML: FILTER_XML.format(""),
        ids.BY_REFERENCE: "filtered",
    }[form]
    assert board.ask(create(READER, form, content, SUBSCRIBER)) == [INVALID]
    assert "content filters are not supported: filter on the client" in desk.log()
    assert READER not in of(board).objects
    desk.close()


FORMATS = [ids.FORMAT_SAMPLE, ids.FORMAT_DATA_SEQ, ids.FORMAT_SAMPLE_SEQ, ids.FORMAT_PACKED_SAMPLES]


@pytest.mark.parametrize("data_format", FORMATS)
@pytest.mark.parametrize("stream", [0, 1, 0x80])
def test_write_data_in_other_formats_is_refused_and_the_other_samples_are_written(
    board, data_format, stream
):
    board.ask(*publisher_entities(), service())
    samples = []
    writer_of(board).write = samples.append
    for object_id in (WRITER, REQUESTER, 0x0996):
        board.send(
            write_data(object_id, b"data", request=0x0708, flags=1 | data_format),
            topic(oid(2, 2), flags=REPLACE),
            stream=stream,
        )
        statuses = board.payloads(ids.STATUS)
        expected = bytes.fromhex("0708") + object_id.to_bytes(2, "big") + bytes((INVALID, 0))
        assert statuses[0] == expected and statuses[1][4] == OK
    assert not samples
    assert f"data format 0x{data_format:02X} is not supported" in board.desk.log()


@pytest.mark.parametrize("data_format", FORMATS)
def test_reading_in_other_formats_is_refused(board, data_format):
    board.ask(*subscriber_entities())
    assert board.ask(read_data(READER, data_format=data_format)) == [INVALID]
    assert "formats other than FORMAT_DATA are not supported" in board.desk.log()
    assert of(board).objects[READER].delivery is None


def test_a_filter_on_reading_is_refused_and_a_running_delivery_goes_on(board):
    board.ask(*subscriber_entities())
    board.send(read_data(READER))
    running = of(board).objects[READER].delivery
    assert board.ask(read_data(READER, content_filter="x > 1")) == [INVALID]
    assert of(board).objects[READER].delivery is running
