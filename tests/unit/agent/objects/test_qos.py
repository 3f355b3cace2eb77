"""QoS and names as clients send them, in every format, and the entities that result."""

import pytest
from unit.agent import helpers
from unit.agent.helpers import (
    INVALID,
    OK,
    PARTICIPANT,
    PUBLISHER,
    READER,
    REPLACE,
    REPLIER,
    STRING,
    SUBSCRIBER,
    TOPIC,
    WRITER,
    Board,
    Desk,
    by_reference,
    create,
    endpoint,
    group,
    of,
    participant,
    publisher_entities,
    topic,
    writer_of,
    xml,
)

from uros.qos import (
    DurabilityPolicy,
    HistoryPolicy,
    LivelinessPolicy,
    ReliabilityPolicy,
)
from uros.wire import entities, ids
from uros.wire.cdr import Writer

# --- names of any length -----------------------------------------------------------------------


@pytest.mark.parametrize("length", [61, 100, 255, 256, 1000])
@pytest.mark.parametrize("form", ["binary", "xml", "reference"])
def test_names_of_any_length(tmp_path, length, form):
    """micro-ROS has room for 60 characters, XRCE clients in C for 512; topics and nodes may be as
    long as ROS allows, types and references as long as fits a message."""
    node, type_name = "n" * min(length, 255), "a::" + "T" * length
    name = "rt/" + "t" * (min(length, 246) - len("_Request"))
    on_topic = f"<name>{name}</name><dataType>{type_name}</dataType>"
    service_types = f'request_type="{type_name}" reply_type="{type_name}"'
    texts = {  # with room for an attribute
        PARTICIPANT: f"<participant{{}}><rtps><name>{node}</name></rtps></participant>",
        TOPIC: f"<topic{{}}>{on_topic}</topic>",
        WRITER: f"<data_writer{{}}><topic>{on_topic}</topic></data_writer>",
        REPLIER: f'<replier{{}} service_name="{name}" {service_types}/>',
    }
    parents = {PARTICIPANT: 0, TOPIC: PARTICIPANT, WRITER: PUBLISHER, REPLIER: PARTICIPANT}
    reference = "r" * length
    file = tmp_path / "agent.refs"
    named = f' profile_name="{reference}"'
    file.write_text("<dds>" + "".join(item.format(named) for item in texts.values()) + "</dds>")
    desk = Desk(refs=file)
    board = Board(desk, mtu=60_000)
    if form == "binary":
        submessages = [
            participant(name=node), topic(name=name, type_name=type_name), group(), endpoint(),
            create(REPLIER, ids.IN_BINARY, helpers.built(
                entities.push_binary_service, name, type_name, type_name, None, None,
            ), PARTICIPANT),
        ]  # fmt: skip
    elif form == "xml":
        submessages = [xml(item, text.format(""), parents[item]) for item, text in texts.items()]
        submessages.insert(2, group())
    else:
        submessages = [by_reference(item, reference, parents[item]) for item in texts]
        submessages.insert(2, group())
    assert board.ask(*submessages) == [OK] * 5, desk.log()
    bus = desk.middleware.bus
    assert bus.nodes[0].full_name == "/" + node
    assert {name, f"{name}_Reply"} == {key[1] for key, item in bus.writers.items() if item}
    assert writer_of(board).type_name == type_name
    desk.close()


# --- QoS as micro-ROS sends it -------------------------------------------------------------------

KEEP_LAST, RELIABLE, LOCAL = ids.QOS_KEEP_LAST, ids.QOS_RELIABLE, ids.QOS_TRANSIENT_LOCAL
PROFILES = {
    # name: (flags, depth) of uxr_buffer_create_*_bin, expected QoS
    "default": (RELIABLE | KEEP_LAST, 10, ("reliable", "volatile", "last", 10)),
    "sensor_data": (KEEP_LAST, 5, ("best effort", "volatile", "last", 5)),
    "services_default": (RELIABLE | KEEP_LAST, 10, ("reliable", "volatile", "last", 10)),
    "parameters": (RELIABLE | KEEP_LAST, 1000, ("reliable", "volatile", "last", 1000)),
    "parameter_events": (RELIABLE | KEEP_LAST, 1000, ("reliable", "volatile", "last", 1000)),
    # SYSTEM_DEFAULT becomes transient local in rmw_microxrcedds, depth 0 is left out.
    "system_default": (RELIABLE | KEEP_LAST | LOCAL, None, ("reliable", "local", "last", 1)),
    "depth 0": (RELIABLE | KEEP_LAST, 0, ("reliable", "volatile", "last", 1)),
    "keep all": (RELIABLE, 10, ("reliable", "volatile", "all", None)),
    "latched": (RELIABLE | KEEP_LAST | LOCAL, 1, ("reliable", "local", "last", 1)),
}


def said_of(qos):
    reliability = "reliable" if qos.reliability == ReliabilityPolicy.RELIABLE else "best effort"
    durability = {
        DurabilityPolicy.VOLATILE: "volatile",
        DurabilityPolicy.TRANSIENT_LOCAL: "local",
    }[qos.durability]
    if qos.history == HistoryPolicy.KEEP_ALL:
        return reliability, durability, "all", None
    return reliability, durability, "last", qos.depth


@pytest.mark.parametrize("name", PROFILES)
def test_the_qos_profiles_of_micro_ros(board, name):
    flags, depth, expected = PROFILES[name]
    board.ask(*publisher_entities()[:3], group(SUBSCRIBER))
    submessages = [
        endpoint(qos=flags, depth=depth),
        endpoint(READER, parent=SUBSCRIBER, qos=flags, depth=depth),
    ]
    assert board.ask(*submessages) == [OK] * 2
    profiles = writer_of(board).qos, of(board).objects[READER].endpoint._reader.qos
    assert said_of(profiles[0]) == expected
    if expected[2] == "all":  # bounded in the reader, as Fast DDS does
        expected = (*expected[:2], "last", 5000)
    assert said_of(profiles[1]) == expected
    for qos in profiles:
        assert (qos.deadline_ms, qos.lifespan_ms, qos.partitions) == (None, None, ())


def test_endpoints_without_qos_have_fast_ddss_defaults(board):
    board.ask(*publisher_entities()[:3], group(SUBSCRIBER))
    for form, content in (
        (ids.IN_BINARY, b"\0\x12\0"),
        (ids.AS_XML, "<{}><topic><name>rt/chatter</name><dataType>T</dataType></topic></{}>"),
    ):
        for object_id, tag, parent in (
            (WRITER, "data_writer", PUBLISHER), (READER, "data_reader", SUBSCRIBER),
        ):  # fmt: skip
            text = content.format(tag, tag) if isinstance(content, str) else content
            assert board.ask(create(object_id, form, text, parent, flags=REPLACE)) == [OK]
        assert said_of(writer_of(board).qos) == ("reliable", "local", "last", 1)
        qos = of(board).objects[READER].endpoint._reader.qos
        assert said_of(qos) == ("best effort", "volatile", "last", 1)


def test_history_depth_is_limited_as_in_fast_dds(board):
    board.ask(*publisher_entities()[:3], group(SUBSCRIBER))
    history = "<historyQos><kind>KEEP_LAST</kind><depth>2147483647</depth></historyQos>"
    inside = f"<topic><name>rt/chatter</name><dataType>T</dataType>{history}</topic>"
    for object_id, tag, parent in (
        (WRITER, "data_writer", PUBLISHER), (READER, "data_reader", SUBSCRIBER),
    ):  # fmt: skip
        assert board.ask(xml(object_id, f"<dds><{tag}>{inside}</{tag}></dds>", parent)) == [OK]
    assert writer_of(board).qos.depth == 5000
    assert of(board).objects[READER].endpoint._reader.qos.depth == 5000


def test_the_xml_of_micro_ros(board):
    """Test the XML of rmw_microxrcedds built without references (build_datawriter_xml)."""
    board.ask(*publisher_entities(type_name=STRING)[:3])
    text = (
        "<dds><data_writer><historyMemoryPolicy>PREALLOCATED_WITH_REALLOC</historyMemoryPolicy>"
        "<qos><reliability><kind>BEST_EFFORT</kind></reliability></qos><topic><kind>NO_KEY</kind>"
        f"<name>rt/chatter</name><dataType>{STRING}</dataType>"
        "<historyQos><kind>KEEP_ALL</kind></historyQos></topic></data_writer></dds>"
    )
    assert board.ask(xml(WRITER, text, PUBLISHER)) == [OK]
    assert said_of(writer_of(board).qos) == ("best effort", "local", "all", None)


@pytest.mark.parametrize("dialect", ["fast", "dds-xml"])
def test_every_qos_element_of_xml(board, dialect):
    inside = {
        "fast": (
            "<qos><reliability><kind>RELIABLE</kind></reliability>"
            "<durability><kind>VOLATILE</kind></durability>"
            "<deadline><period><sec>1</sec><nanosec>500000000</nanosec></period></deadline>"
            "<lifespan><duration><sec>3</sec></duration></lifespan>"
            "<liveliness><kind>MANUAL_BY_TOPIC</kind>"
            "<lease_duration><sec>4</sec></lease_duration></liveliness>"
            "<ownership><kind>EXCLUSIVE</kind></ownership>"
            "<ownershipStrength><value>9</value></ownershipStrength>"
            "<partition><names><name>a</name><name>b</name></names></partition>"
            "<userData><value>68.69.ff</value></userData>"
            "<disablePositiveACKs><enabled>true</enabled></disablePositiveACKs></qos>"
            "<throughputController/>",
            "<historyQos><kind>KEEP_LAST</kind><depth>8</depth></historyQos>"
            "<resourceLimitsQos><max_samples>5</max_samples></resourceLimitsQos>",
        ),
        "dds-xml": (
            "<datawriter_qos><reliability><kind>RELIABLE_RELIABILITY_QOS</kind></reliability>"
            "<durability><kind>VOLATILE_DURABILITY_QOS</kind></durability>"
            "<deadline><period><sec>1</sec><nanosec>500000000</nanosec></period></deadline>"
            "<lifespan><duration><sec>3</sec></duration></lifespan>"
            "<liveliness><kind>MANUAL_BY_TOPIC_LIVELINESS_QOS</kind>"
            "<lease_duration><sec>4</sec></lease_duration></liveliness>"
            "<ownership><kind>EXCLUSIVE_OWNERSHIP_QOS</kind></ownership>"
            "<ownership_strength><value>9</value></ownership_strength>"
            "<partition><name><element>a</element><element>b</element></name></partition>"
            "<user_data><value>aGn/</value></user_data><latency_budget/>"
            "<history><kind>KEEP_LAST_HISTORY_QOS</kind><depth>8</depth></history>"
            "<resource_limits><max_samples>5</max_samples></resource_limits></datawriter_qos>",
            "",
        ),
    }[dialect]
    text = (
        f"<dds><data_writer>{inside[0]}<topic><name>rt/chatter</name><dataType>T</dataType>"
        f"{inside[1]}</topic></data_writer></dds>"
    )
    board.ask(participant(), group())
    assert board.ask(xml(WRITER, text, PUBLISHER)) == [OK], board.desk.log()
    qos = writer_of(board).qos
    assert said_of(qos) == ("reliable", "volatile", "last", 8)
    assert (qos.deadline_ms, qos.lifespan_ms, qos.liveliness_lease_ms) == (1500, 3000, 4000)
    assert qos.liveliness == LivelinessPolicy.MANUAL_BY_TOPIC
    assert (qos.ownership_exclusive, qos.ownership_strength) == (True, 9)
    assert (qos.partitions, qos.user_data) == (("a", "b"), b"hi\xff")


def test_every_qos_field_of_the_binary_format(board):
    board.ask(*publisher_entities()[:3], group(SUBSCRIBER))
    flags = RELIABLE | KEEP_LAST | ids.QOS_OWNERSHIP_EXCLUSIVE | ids.QOS_TRANSIENT
    for object_id, parent in ((WRITER, PUBLISHER), (READER, SUBSCRIBER)):
        w = Writer(bytearray(256))
        reader = object_id == READER
        entities.push_binary_endpoint(w, TOPIC, flags, 6, 1500, 3000, b"hi\xff", reader=reader)
        w.offset -= 2 if reader else 1
        w.boolean(True)
        w.u32(9)
        if reader:
            w.boolean(False)
        content = bytes(w.buf[: w.offset])
        assert board.ask(create(object_id, ids.IN_BINARY, content, parent)) == [OK]
    profiles = writer_of(board).qos, of(board).objects[READER].endpoint._reader.qos
    for qos in profiles:
        assert (qos.depth, qos.deadline_ms, qos.lifespan_ms) == (6, 1500, 3000)
        assert (qos.user_data, qos.ownership_exclusive) == (b"hi\xff", True)
        assert qos.durability == DurabilityPolicy.TRANSIENT
    assert (profiles[0].ownership_strength, profiles[1].separation_ms) == (9, 9)


@pytest.mark.parametrize(
    ("qos", "why"),
    [
        ("<liveliness><kind>MANUAL_BY_PARTICIPANT</kind></liveliness>", "MANUAL_BY_TOPIC"),
        ("<ownership><kind>MINE</kind></ownership>", "SHARED, EXCLUSIVE"),
        ("<userData><value>??</value></userData>", "nor base64"),
        ("<partition><names>" + "<name>p</name>" * 65 + "</names></partition>", "over the limit"),
    ],
)
def test_invalid_qos_is_refused(board, qos, why):
    board.ask(participant(), group())
    named = "<topic><name>a</name><dataType>T</dataType></topic>"
    text = f"<data_writer><qos>{qos}</qos>{named}</data_writer>"
    board.send(xml(WRITER, text, PUBLISHER))
    assert board.statuses() == [INVALID]
    assert why in board.desk.log()


def test_a_reader_that_keeps_all_is_bounded(board, monkeypatch):
    monkeypatch.setattr("uros.agent.objects.endpoints.MAX_UNREAD", 100)
    board.ask(*publisher_entities(), group(SUBSCRIBER))
    board.ask(endpoint(READER, parent=SUBSCRIBER, qos=ids.QOS_RELIABLE, depth=None))
    for number in range(250):
        board.send(helpers.write_data(WRITER, number.to_bytes(4, "little")))
    board.send(helpers.read_data(READER))
    for _ in range(20):
        board.settle()
    numbers = [int.from_bytes(sample, "little") for sample in board.samples()]
    assert numbers == list(range(150, 250))
