"""XML representations and reference files: those of the C examples, and hostile ones."""

import pytest
from unit.agent.helpers import REFS

from uros.agent.objects import xml_profiles
from uros.agent.objects.xml_profiles import ProfileError, References, parse_xml
from uros.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy

TOPIC = "<dds><topic><name>{}</name><dataType>T</dataType></topic></dds>"


def test_attributes_without_space_between_them_as_the_c_examples_send_them():
    profile = parse_xml(
        "replier",
        '<dds><replier profile_name="my_requester"service_name="service_name"'
        'request_type="request_type"reply_type="reply_type"></replier></dds>',
    )
    assert profile.service_name == "service_name"
    assert (profile.request_type, profile.reply_type) == ("request_type", "reply_type")


def test_service_topics():
    profile = parse_xml(
        "requester",
        '<dds><requester service_name="s" request_type="A" reply_type="B">'
        "<request_topic_name>rq/sRequest</request_topic_name>"
        "<reply_topic_name>rr/sReply</reply_topic_name></requester></dds>",
    )
    assert (profile.request_topic, profile.reply_topic) == ("rq/sRequest", "rr/sReply")


def test_the_root_can_be_the_element_itself():
    assert parse_xml("topic", "<topic><name> a </name></topic>").topic_name == "a"


def test_qos():
    profile = parse_xml(
        "data_writer",
        "<dds><data_writer><topic><kind>NO_KEY</kind><name>n</name><dataType>t</dataType>"
        "<historyQos><kind>KEEP_LAST</kind><depth>20</depth></historyQos></topic>"
        "<qos><durability><kind>TRANSIENT_LOCAL</kind></durability>"
        "<reliability><kind>BEST_EFFORT</kind></reliability>"
        "<deadline><period><sec>1</sec><nanosec>500000000</nanosec></period></deadline>"
        "<lifespan><duration><sec>DURATION_INFINITY</sec></duration></lifespan>"
        "<ownership><kind>EXCLUSIVE</kind></ownership>"
        "<ownershipStrength><value>7</value></ownershipStrength>"
        "<partition><names><name>a</name><name>b</name></names></partition>"
        "</qos></data_writer></dds>",
    )
    qos = QoSProfile()
    profile.apply(qos)
    assert qos == QoSProfile(
        20, ReliabilityPolicy.BEST_EFFORT, DurabilityPolicy.TRANSIENT_LOCAL,
        HistoryPolicy.KEEP_LAST, deadline_ms=1500, ownership_exclusive=True,
        ownership_strength=7, partitions=("a", "b"),
    )  # fmt: skip
    assert qos.ownership_strength == 7


def test_partitions_of_groups():
    xml = "<dds><publisher><qos><partition><names><name>a</name></names></partition></qos></publisher></dds>"  # noqa: E501
    assert parse_xml("publisher", xml).partitions == ("a",)


@pytest.mark.parametrize(
    ("inside", "only"),
    [
        ("<rtps><name>n</name></rtps>", False),
        ("<rtps><useBuiltinTransports>false</useBuiltinTransports><userTransports>"
         "<transport_id>udp_localhost</transport_id></userTransports></rtps>", True),
        ("<rtps><interfaceWhiteList><address>127.0.0.1</address></interfaceWhiteList></rtps>",
         True),
        ("<rtps><interfaceWhiteList><address>127.0.0.1</address><address>10.0.0.1</address>"
         "</interfaceWhiteList></rtps>", False),
    ],
)  # fmt: skip
def test_participants_that_stay_on_the_machine(inside, only):
    profile = parse_xml("participant", f"<dds><participant>{inside}</participant></dds>")
    assert profile.localhost_only is only


DESCRIBED = """<dds><profiles><transport_descriptors><transport_descriptor>
<transport_id>mine</transport_id><type>UDPv4</type><interfaceWhiteList><address>{}</address>
</interfaceWhiteList></transport_descriptor></transport_descriptors>
<participant profile_name="p"><rtps><name>n</name><userTransports>
<transport_id>{}</transport_id></userTransports></rtps></participant></profiles></dds>"""


@pytest.mark.parametrize(
    "address, transport, only",
    [("127.0.0.1", "mine", True), ("10.0.0.1", "mine", False), ("127.0.0.1", "other", False)],
)
def test_a_transport_that_is_described_elsewhere_in_the_document(
    address, transport, only, tmp_path
):
    text = DESCRIBED.format(address, transport)
    assert parse_xml("participant", text).localhost_only is only
    (tmp_path / "refs.xml").write_text(text)
    references = References()
    references.load(tmp_path / "refs.xml")
    assert references.find("participant", "p").localhost_only is only


LAUGHS = (
    '<!DOCTYPE lolz [<!ENTITY lol "lol">'
    + "".join(
        f'<!ENTITY lol{i} "{"&lol" + (str(i - 1) if i else "") + ";"}">' for i in range(1, 10)
    )
    + "]><dds><topic><name>&lol9;</name></topic></dds>"
)


@pytest.mark.parametrize(
    ("xml", "why"),
    [
        ("<dds><topic>", "broken XML"),
        ("<dds></topic></dds>", "broken XML"),
        ("no xml at all", "broken XML"),
        ("<dds>&nope;</dds>", "broken XML"),
        ("<dds a='1' a='2'/>", "broken XML"),
        ("<?xml version='1.0' encoding='utf-16'?><dds", "broken XML"),
        ("<dds></dds><dds></dds>", "broken XML"),
        ("<dds></dds>", "there is no <topic>"),
        (LAUGHS, "document types and entities"),
        ('<!DOCTYPE d SYSTEM "file:///etc/passwd"><dds/>', "document types and entities"),
        ("<dds>" + "<a>" * 100 + "</a>" * 100 + "</dds>", "nested deeper"),
        ("<dds>" + "<a/>" * 15_000 + "</dds>", None),
        (TOPIC.format("x" * 70_000), "over the limit"),
        (TOPIC.format("\x01"), "broken XML"),
        ("<a " + 'b="' * 20_000 + "/>", "broken XML"),
    ],
)
def test_bad_xml(xml, why):
    with pytest.raises(ProfileError) as caught:
        parse_xml("topic", xml)
    assert why is None or why in str(caught.value)


def test_more_elements_than_the_limit_are_refused(tmp_path):
    file = tmp_path / "many.refs"
    file.write_text("<profiles>" + "<a/>" * 30_000 + "</profiles>")
    with pytest.raises(ProfileError, match="more than 20000 elements"):
        References().load(file)
    with pytest.raises(ProfileError, match="characters is over the limit of 4194304"):
        References().load("/dev/zero")


@pytest.mark.parametrize("value", ["99999999999", "4294967296", "2147483648", "-1", "", "1e3", "٣"])
def test_invalid_numbers_are_refused(value):
    xml = (
        "<dds><data_writer><topic><name>n</name><dataType>t</dataType><historyQos>"
        f"<depth>{value or 'x'}</depth></historyQos></topic></data_writer></dds>"
    )
    with pytest.raises(ProfileError, match="not a number"):
        parse_xml("data_writer", xml)


def test_invalid_words_are_refused():
    xml = (
        "<dds><data_reader><topic><name>n</name></topic><qos><reliability><kind>MAYBE</kind>"
        "</reliability></qos></data_reader></dds>"
    )
    with pytest.raises(ProfileError, match="'MAYBE', not one of RELIABLE, BEST_EFFORT"):
        parse_xml("data_reader", xml)


# In the form of the file that comes with the C++ agent.
def test_a_reference_file(tmp_path):
    file = tmp_path / "agent.refs"
    file.write_text(REFS)
    references = References()
    assert references.load(file) == 6
    assert references.find("topic", "shapetype_topic").type_name == "ShapeType"
    assert references.find("replier", "shapetype_replier").service_name == "shapetype_service"
    assert references.find("topic", "shapetype_replier") is None


@pytest.mark.parametrize(
    ("text", "why"),
    [
        (None, "No such file"),
        (b"\xff\xfe", "decode"),
        (b"<profiles>", "broken XML"),
        (b"<profiles/>", "no profiles in it"),
        (
            b"<profiles>" + b" " * xml_profiles.MAX_REFERENCES_FILE + b"</profiles>",
            "over the limit",
        ),
    ],
)
def test_reference_files_that_cannot_be_used(tmp_path, text, why):
    file = tmp_path / "bad.refs"
    if text is not None:
        file.write_bytes(text)
    with pytest.raises(ProfileError, match=why) as caught:
        References().load(file)
    assert str(file) in str(caught.value)
