"""CREATE and the representations of entities, byte by byte, both ways. Also runs on MicroPython.

"recorded": cut from the conversations in tests/captures, by the name of the file; octets that
are only padding are zero here, C clients leave anything there.
"by hand": written from the order and sizes of the fields in XRCE 7.7.9 and the C sources.
"""

from support.portable import pair, reader, refused

from uros.wire import entities, ids
from uros.wire.cdr import Writer
from uros.wire.errors import DecodeError, EncodeError, LimitError


def create(octets, request_id, object_id, form, content, parent):
    kind = object_id & 0x0F
    pair(
        octets,
        entities.push_create,
        entities.pull_create,
        (request_id, object_id, kind, form, content, parent),
        (request_id, object_id, form, content, parent),
    )


def text(string):
    """The octets of a string after its length, in hex."""
    return "".join(["%02x" % octet for octet in string.encode()]) + "00"


def test_create_participant_by_xml() -> None:
    xml = "<dds><participant><rtps><name>default_xrce_participant</name></rtps></participant></dds>"
    create(  # recorded: publish_reliable
        "000a 0011 01 02 0000 59000000" + text(xml) + "00 0000", 10, 0x11, ids.AS_XML, xml, 0
    )


def test_create_topic_by_xml() -> None:
    xml = "<dds><topic><name>HelloWorldTopic</name><dataType>HelloWorld</dataType></topic></dds>"
    create(  # recorded: publish_reliable
        "000b 0012 02 02 0000 56000000" + text(xml) + "0011", 11, 0x12, ids.AS_XML, xml, 0x11
    )


def test_create_publisher_and_subscriber_by_empty_xml() -> None:
    create(  # recorded: publish_reliable
        "000c 0013 03 02 0000 01000000 00 0011", 12, 0x13, ids.AS_XML, "", 0x11
    )
    create(  # recorded: subscribe_reliable
        "000c 0014 04 02 0000 01000000 00 0011", 12, 0x14, ids.AS_XML, "", 0x11
    )


def test_create_writer_and_reader_by_xml() -> None:
    for kind, name, parent, request_id in (
        (5, "data_writer", 0x13, 13),  # recorded: publish_reliable
        (6, "data_reader", 0x14, 13),  # recorded: subscribe_reliable
    ):
        topic = "<kind>NO_KEY</kind><name>HelloWorldTopic</name><dataType>HelloWorld</dataType>"
        xml = "<dds><%s><topic>%s</topic></%s></dds>" % (name, topic, name)
        create(
            "000d 001%d 0%d 02 0000 84000000" % (kind, kind) + text(xml) + "00%02x" % parent,
            request_id,
            0x10 | kind,
            ids.AS_XML,
            xml,
            parent,
        )


def test_create_requester_and_replier_by_xml() -> None:
    for kind, name, size in (
        (7, "requester", "8c"),  # recorded: service, client 1
        (8, "replier", "88"),  # recorded: service, client 0
    ):
        xml = (
            '<dds><%s profile_name="my_requester"service_name="service_name"'
            'request_type="request_type"reply_type="reply_type"></%s></dds>'
        ) % (name, name)
        create(
            "000b 001%d 0%d 02 0000 %s000000" % (kind, kind, size) + text(xml) + "0011",
            11,
            0x10 | kind,
            ids.AS_XML,
            xml,
            0x11,
        )


def test_create_by_reference() -> None:
    # by hand
    create("000a 0011 01 01 0000 08000000" + text("default") + "0700", 10, 0x11, 1, "default", 7)
    create("000b 1235 05 01 0000 02000000" + text("w") + "1233", 11, 0x1235, 1, "w", 0x1233)


def test_create_in_binary() -> None:
    # recorded: binary_entities
    create("000a 0011 01 03 0000 02000000 0000 0000", 10, 0x11, 3, b"\0\0", 0)
    create("000c 0013 03 03 0000 02000000 0000 0011", 12, 0x13, 3, b"\0\0", 0x11)
    # by hand: the domain is a number, little endian and aligned; a parent is neither
    create("000a 0011 01 03 0000 03000000 aabbcc 00 0201", 10, 0x11, 3, b"\xaa\xbb\xcc", 0x102)
    create("000c 0013 03 03 0000 03000000 aabbcc 0102", 12, 0x13, 3, b"\xaa\xbb\xcc", 0x102)
    create("000a 0011 01 03 0000 00000000 ffff", 10, 0x11, 3, b"", -1)


def test_create_of_objects_without_a_parent() -> None:
    # by hand: a type, a QoS profile and an application
    create("0001 002a 0a 01 0000 02000000" + text("t"), 1, 0x2A, ids.BY_REFERENCE, "t", 0)
    create("0001 002b 0b 02 0000 02000000" + text("q"), 1, 0x2B, ids.AS_XML, "q", 0)
    create("0001 002c 0c 01 0000 02000000" + text("a"), 1, 0x2C, ids.BY_REFERENCE, "a", 0)


def test_create_big_endian() -> None:
    octets = bytes.fromhex("000a 0011 01 03 0000 00000002 0000 0007")
    assert entities.pull_create(reader(octets, False)) == (10, 0x11, 1, 3, b"\0\0", 7)


def test_create_takes_the_kind_from_its_own_octet() -> None:
    octets = bytes.fromhex("000c 0015 03 03 0000 02000000 0000 0011")
    assert entities.pull_create(reader(octets))[1:3] == (0x13, 3)


def test_an_invalid_create_is_refused() -> None:
    for form in (0, 4, 255):
        octets = bytes((0, 1, 0, 0x11, 1, form, 0, 0, 1, 0, 0, 0, 0, 0, 0, 0))
        assert "format %d" % form in refused(DecodeError, entities.pull_create, reader(octets))
    octets = bytes.fromhex("000a 0011 01 02 0000 01000100")  # 65537 bytes
    refused(LimitError, entities.pull_create, reader(octets))


def test_create_that_does_not_fit() -> None:
    for request_id, object_id, form, content, parent in (
        (65536, 0x11, 2, "", 0),
        (1, 65536, 2, "", 0),
        (1, 0x11, 2, "", 32768),
        (1, 0x12, 2, "", 65536),
        (1, 0x11, 256, "", 0),
        (1, 0x11, 3, "", 0),
        (1, 0x11, 2, b"", 0),
        (1, 0x11, 1, b"", 0),
    ):
        w = Writer(bytearray(64))
        refused(EncodeError, entities.push_create, w, request_id, object_id, form, content, parent)


def participant(octets, name, reference):
    pair(
        octets,
        entities.push_binary_participant,
        entities.pull_binary_participant,
        (name, reference),
    )


def test_binary_participant() -> None:
    participant("0000", None, None)  # recorded: binary_entities
    participant(  # recorded: rclc_image
        "00 01 0000 0f000000" + text("image_pub_node"), "image_pub_node", None
    )
    participant(  # recorded: rclc_temperature_humidity: with a namespace
        "00 01 0000 10000000" + text("/garden/weather"), "/garden/weather", None
    )
    participant(  # by hand
        "01 000000 02000000" + text("d") + "01 00 02000000" + text("n"), "n", "d"
    )


def topic(octets, name, type_name):
    pair(octets, entities.push_binary_topic, entities.pull_binary_topic, (name, type_name))


def test_binary_topic() -> None:
    topic(  # recorded: binary_entities
        "0d000000" + text("ExampleTopic") + "00 01 00 0c000000" + text("ExampleType"),
        "ExampleTopic",
        "ExampleType",
    )
    topic(  # recorded: rclc_int32_publisher
        "16000000"
        + text("rt/std_msgs_msg_Int32")
        + "00 01 1c000000"
        + text("std_msgs::msg::dds_::Int32_"),
        "rt/std_msgs_msg_Int32",
        "std_msgs::msg::dds_::Int32_",
    )
    topic("02000000" + text("t") + "00 00", "t", None)  # by hand


def test_binary_topic_with_a_type_reference() -> None:
    octets = bytes.fromhex(  # by hand
        "02000000" + text("t") + "01 00 02000000" + text("r") + "01 00 02000000" + text("T")
    )
    r = reader(octets)
    assert entities.pull_binary_topic(r) == ("t", "T")
    assert r.remaining() == 0


def group(octets, name, partitions):
    pair(
        octets,
        entities.push_binary_group,
        entities.pull_binary_group,
        (name, partitions or []),
        (name, partitions),
    )


def test_binary_publisher_and_subscriber() -> None:
    group("0000", None, None)  # recorded: binary_entities, both kinds
    # by hand
    group("01 000000 02000000" + text("p") + "00", "p", None)
    group("00 01 01 00 00000000 00", None, [])
    group(
        "00 01 01 00 02000000 02000000" + text("a") + "0000 03000000" + text("bc") + "00",
        None,
        ["a", "bc"],
    )


def test_binary_group_with_data_and_no_partitions() -> None:
    octets = bytes.fromhex("00 01 00 01 03000000 010203")  # by hand
    r = reader(octets)
    assert entities.pull_binary_group(r) == (None, [])
    assert r.remaining() == 0


def test_binary_group_with_too_many_partitions() -> None:
    for count in ("41000000", "ffffffff"):
        octets = bytes.fromhex("00 01 01 00" + count)
        refused(LimitError, entities.pull_binary_group, reader(octets))


def pull_writer(r):
    return entities.pull_binary_endpoint(r, False)


def pull_reader(r):
    return entities.pull_binary_endpoint(r, True)


def push_reader(w, topic_id, flags, depth, deadline, lifespan, user_data):
    entities.push_binary_endpoint(
        w, topic_id, flags, depth, deadline, lifespan, user_data, reader=True
    )


def writer_and_reader(octets, topic_id, flags, depth, deadline, lifespan, user_data):
    values = topic_id, (flags, depth, deadline, lifespan, user_data, None, None)
    arguments = topic_id, flags, depth, deadline, lifespan, user_data
    pair(octets, entities.push_binary_endpoint, pull_writer, values, arguments)
    pair(octets + "00", push_reader, pull_reader, values, arguments)


def test_binary_writer_and_reader() -> None:
    # recorded: binary_entities: reliable, keep last, transient local
    writer_and_reader("0012 01 00 0b00 00 00 00 00 00", 0x12, 11, None, None, None, None)
    # recorded: rclc_image and rclc_int32_subscriber: reliable, keep last 10
    writer_and_reader("0002 01 00 0300 01 00 0a00 00 00 00 00", 2, 3, 10, None, None, None)
    # by hand: every field that push writes
    writer_and_reader(
        "0012 01 00 0000 01 00 0500 01 00 64000000 01 000000 e8030000 01 00000002000000 abcd 00",
        0x12,
        0,
        5,
        100,
        1000,
        b"\xab\xcd",
    )


def test_binary_endpoint_without_qos() -> None:
    assert pull_writer(reader(b"\x00\x12\x00")) == (0x12, None)
    assert pull_reader(reader(b"\x00\x12\x00")) == (0x12, None)


def test_binary_endpoint_with_fields_that_no_client_sends() -> None:
    # by hand, with the agent's 32 bits for the strength and for the separation
    head = "0012 01 00 0100 00 00 00 00 01 00 2a000000"
    r = reader(bytes.fromhex(head))
    assert pull_writer(r) == (0x12, (1, None, None, None, None, 42, None))
    assert r.remaining() == 0
    r = reader(bytes.fromhex(head + "01 000000 04000000" + text("x>3")))
    assert pull_reader(r) == (0x12, (1, None, None, None, None, 42, "x>3"))
    assert r.remaining() == 0


def test_binary_endpoint_that_does_not_fit() -> None:
    for topic_id, flags, depth, deadline, lifespan in (
        (65536, 0, None, None, None),
        (1, 65536, None, None, None),
        (1, 0, 65536, None, None),
        (1, 0, None, 1 << 32, None),
        (1, 0, None, None, -1),
    ):
        w = Writer(bytearray(64))
        refused(
            EncodeError,
            entities.push_binary_endpoint,
            w,
            topic_id,
            flags,
            depth,
            deadline,
            lifespan,
        )  # noqa: E501


def test_binary_requester_and_replier() -> None:
    pair(  # recorded: rclc_trigger, both clients
        "09000000"
        + text("/trigger")
        + "000000 26000000"
        + text("std_srvs::srv::dds_::Trigger_Request_")
        + "0000 27000000"
        + text("std_srvs::srv::dds_::Trigger_Response_")
        + "01 12000000"
        + text("rq/triggerRequest")
        + "01 00 10000000"
        + text("rr/triggerReply"),
        entities.push_binary_service,
        entities.pull_binary_service,
        (
            "/trigger",
            "std_srvs::srv::dds_::Trigger_Request_",
            "std_srvs::srv::dds_::Trigger_Response_",
            "rq/triggerRequest",
            "rr/triggerReply",
        ),
    )
    pair(  # by hand
        "02000000" + text("s") + "0000 02000000" + text("q") + "0000 02000000" + text("r") + "0000",
        entities.push_binary_service,
        entities.pull_binary_service,
        ("s", "q", "r", None, None),
    )
