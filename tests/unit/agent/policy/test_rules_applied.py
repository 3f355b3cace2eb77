"""Rules applied to the clients of an agent."""

import pytest
from support.agent import running_agent
from support.client import BEST_EFFORT, XrceClient
from unit.agent import helpers
from unit.agent.helpers import (
    APPLICATION,
    OK,
    PARTICIPANT,
    PUBLISHER,
    READER,
    REPLIER,
    REQUESTER,
    SUBSCRIBER,
    UNKNOWN,
    WRITER,
    Board,
    Desk,
    by_reference,
    endpoint,
    group,
    participant,
    topic,
    xml,
)

from uros.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from uros.wire import entities, ids

TYPE = "std_msgs::msg::dds_::String_"
SERVICE = ("/go", "p::srv::dds_::Go_Request_", "p::srv::dds_::Go_Response_")


@pytest.fixture
def agent():
    with running_agent("udp", "memory", None) as running:
        yield running


def client(agent, key, **more):
    xrce_client = XrceClient(agent.line(), key, **more)
    assert xrce_client.open() == ids.STATUS_OK
    return xrce_client


def endpoints(agent, monkeypatch):
    """Return a list that records what the middleware is asked to create."""
    calls = []
    create = agent.middleware.create_node

    def create_node(domain, namespace, name, localhost_only=False):
        node = create(domain, namespace, name, localhost_only)
        calls.append(("node", domain, namespace, name))
        for kind in ("writer", "reader"):
            make = getattr(node, f"create_{kind}")

            def spy(topic, type_name, qos, *more, make=make, kind=kind):
                calls.append((kind, topic, qos))
                return make(topic, type_name, qos, *more)

            setattr(node, f"create_{kind}", spy)
        return node

    monkeypatch.setattr(agent.middleware, "create_node", create_node)
    return calls


def test_rules_set_names_domain_and_qos(agent, monkeypatch):
    agent.agent.rules.add({"namespace": "/hall", "qos": {"odom": {"depth": 1}}})
    agent.agent.rules.add(
        {
            "key": 2, "domain": 9, "remap": {"odom": "position"},
            "qos": {"/odom": {"reliability": "best_effort", "durability": "transient_local"}},
        }
    )  # fmt: skip
    calls = endpoints(agent, monkeypatch)
    first, second = client(agent, 1), client(agent, 2)
    first.writer("a/one", "rt/odom", TYPE)
    second.reader("two", "rt/odom", TYPE)
    assert calls == [
        ("node", 0, "/hall/a", "one"),
        ("writer", "rt/hall/odom", QoSProfile(1)),
        ("node", 9, "/hall", "two"),
        (
            "reader", "rt/position",
            QoSProfile(1, ReliabilityPolicy.BEST_EFFORT, DurabilityPolicy.TRANSIENT_LOCAL),
        ),
    ]  # fmt: skip
    assert "domain_id: 9, node: /hall/two" in agent.said.getvalue()


def test_a_domain_of_a_rule_has_precedence_over_the_global_domain(monkeypatch):
    with running_agent("udp", "memory", 5) as agent:
        agent.agent.rules.add({"node": "/two", "domain": 9})
        calls = endpoints(agent, monkeypatch)
        client(agent, 1).writer("one", "rt/a", TYPE)
        client(agent, 2).writer("two", "rt/a", TYPE)
        assert [call[1] for call in calls if call[0] == "node"] == [5, 9]


def test_a_remapped_topic_matches_its_peer_and_no_other_topic(agent):
    agent.agent.rules.add({"key": 1, "remap": {"a": "b"}})
    first, second, third = (client(agent, key) for key in (1, 2, 3))
    readers = second.reader("two", "rt/a", TYPE), third.reader("three", "rt/b", TYPE)
    second.read(readers[0])
    third.read(readers[1])
    first.write(first.writer("one", "rt/a", TYPE), b"\1\0\0\0\0")
    assert third.sample(readers[1]) == b"\1\0\0\0\0"
    third.write(third.writer("three", "rt/a", TYPE), b"\2\0\0\0ab")
    assert second.sample(readers[0]) == b"\2\0\0\0ab"  # and no earlier sample


def test_a_renamed_service_is_called_by_its_new_name(agent):
    agent.agent.rules.add({"key": 1, "namespace": "/r1"})
    agent.agent.rules.add({"key": 2, "remap": {"go": "/r1/go"}})
    first, second = client(agent, 1), client(agent, 2)
    replier = first.service(ids.KIND_REPLIER, "one", *SERVICE)
    requester = second.service(ids.KIND_REQUESTER, "two", *SERVICE)
    first.read(replier)
    second.read(requester)
    second.write(requester, b"ask!")
    request = first.sample(replier)
    assert request[24:] == b"ask!"
    first.write(replier, request[:24] + b"yes!")
    assert second.sample(requester)[-4:] == b"yes!"


def test_a_sample_over_max_size_is_dropped_and_logged(agent):
    agent.agent.rules.add({"max_size": 12})
    publisher = client(agent, 1)
    writer, reader = publisher.writer("one", "rt/a", TYPE), publisher.reader("one", "rt/a", TYPE)
    publisher.read(reader)
    publisher.write(writer, bytes(20))
    publisher.write(writer, bytes(4))
    assert publisher.sample(reader) == bytes(4)
    assert "message too large" in agent.said.getvalue()


def test_a_request_over_max_size_is_dropped_and_logged(agent):
    agent.agent.rules.add({"max_size": 12})
    requester_client = client(agent, 1)
    replier = requester_client.service(ids.KIND_REPLIER, "one", *SERVICE)
    requester = requester_client.service(ids.KIND_REQUESTER, "one", *SERVICE)
    requester_client.read(replier)
    requester_client.write(requester, bytes(20))
    requester_client.write(requester, b"ask!")
    assert requester_client.sample(replier)[24:] == b"ask!"
    assert "message too large" in agent.said.getvalue()


def test_a_rate_limit_delays_a_reliable_client_without_loss(agent):
    agent.agent.rules.add({"max_rate": 200})
    board = client(agent, 1)
    writer, reader = board.writer("one", "rt/a", TYPE), board.reader("one", "rt/a", TYPE)
    board.read(reader)
    for number in range(80):  # 50 at once, the others every 5 ms
        board.write(writer, bytes([number]) * 4)
    assert [board.sample(reader) for _ in range(80)] == [bytes([value]) * 4 for value in range(80)]
    assert agent.agent.clients[1].session.dropped == 0


def test_a_rate_drops_best_effort_samples_and_counts_them(agent):
    agent.agent.rules.add({"max_rate": 0.001})
    board = client(agent, 1)
    writer = board.writer("one", "rt/a", TYPE, BEST_EFFORT)
    for number in range(10):
        board.write(writer, bytes([number]) * 4, stream=ids.STREAM_BEST_EFFORT)
    assert board.ping() == 1
    assert agent.agent.clients[1].session.dropped == 9


# --- every way to an endpoint, and every prefix -------------------------------------------------

HALVES = ("rq/goRequest", "rr/goReply", "rt/a", "rs/a", "rp/a", "ra/a", "rt/arm/_action/status")
DENIED = ids.STATUS_ERR_DENIED


def _profiles(name):
    """Return the XML of each kind of endpoint, with a place for an attribute."""
    on = f"<topic><name>{name}</name><dataType>T</dataType></topic>"
    service = 'service_name="s" request_type="A" reply_type="B"'
    topics = "".join(f"<{tag}>{name}</{tag}>" for tag in ("request_topic_name", "reply_topic_name"))
    return {
        WRITER: f"<data_writer{{}}>{on}</data_writer>",
        READER: f"<data_reader{{}}>{on}</data_reader>",
        REQUESTER: f"<requester{{}} {service}>{topics}</requester>",
        REPLIER: f"<replier{{}} {service}>{topics}</replier>",
    }


PARENTS = {
    WRITER: PUBLISHER, READER: SUBSCRIBER, REQUESTER: PARTICIPANT, REPLIER: PARTICIPANT,
}  # fmt: skip


def _creations(form, name):
    """Return the submessages that create one endpoint of each kind on a topic of this name."""
    start = [participant(), group(), group(SUBSCRIBER)]
    if form == "binary":
        return [
            *start, topic(name=name, type_name="T"), endpoint(),
            endpoint(READER, parent=SUBSCRIBER),
            *(helpers.create(kind, ids.IN_BINARY, helpers.built(
                entities.push_binary_service, "s", "A", "B", name, name,
            ), PARTICIPANT) for kind in (REQUESTER, REPLIER)),
        ]  # fmt: skip
    if form == "xml":
        return start + [
            xml(kind, text.format(""), PARENTS[kind]) for kind, text in _profiles(name).items()
        ]
    if form == "reference":
        return start + [by_reference(kind, f"p{kind}", PARENTS[kind]) for kind in PARENTS]
    parts = "".join(
        text.format(f' object_id="0x{kind:04X}"') for kind, text in _profiles(name).items()
    )
    inside = f'<domain_participant name="n">{parts}</domain_participant>'
    text = f'<application name="x">{inside}</application>'
    return [xml(APPLICATION, f"<dds><application_library>{text}</application_library></dds>")]


def _topics(desk):
    bus = desk.middleware.bus
    return {
        key[1]
        for ends in (bus.writers, bus.readers)
        for key, endpoints in ends.items()
        if endpoints
    }


def _desk(tmp_path, name):
    file = tmp_path / "agent.refs"
    texts = [text.format(f' profile_name="p{kind}"') for kind, text in _profiles(name).items()]
    file.write_text("<profiles>" + "".join(texts) + "</profiles>")
    return Desk(refs=file)


@pytest.mark.parametrize("form", ["binary", "xml", "reference", "application"])
@pytest.mark.parametrize("name", HALVES)
def test_no_representation_creates_an_endpoint_outside_its_namespace(tmp_path, form, name):
    desk = _desk(tmp_path, name)
    desk.agent.rules.add({"namespace": "/jail"})
    board = Board(desk, mtu=60_000)
    submessages = _creations(form, name)
    assert board.ask(*submessages) == [OK] * len(submessages), desk.log()
    assert _topics(desk) == {f"{name[:2]}/jail{name[2:]}"}
    desk.close()


@pytest.mark.parametrize("form", ["binary", "xml", "reference", "application"])
@pytest.mark.parametrize("name", ["rt/../x", "rq/../goRequest", "rt/jail/../x", "Square"])
def test_names_that_lead_out_of_the_namespace_are_refused_in_every_representation(
    tmp_path, form, name
):
    desk = _desk(tmp_path, name)
    desk.agent.rules.add({"namespace": "/jail"})
    board = Board(desk, mtu=60_000)
    answers = board.ask(*_creations(form, name))
    if form == "binary":  # the endpoints' topic does not exist
        assert answers == [OK] * 3 + [DENIED] + [UNKNOWN] * 2 + [DENIED] * 2
    elif form == "application":
        assert answers == [DENIED]
    else:
        assert answers == [OK] * 3 + [DENIED] * 4
    assert not _topics(desk)
    assert "refused by the rules of ROS" in desk.log() or "is no name of ROS" in desk.log()
    desk.close()


@pytest.mark.parametrize("form", ["binary", "xml", "reference", "application"])
def test_names_that_are_not_of_ros_are_allowed_without_rules(tmp_path, form):
    desk = _desk(tmp_path, "Square")
    board = Board(desk, mtu=60_000)
    submessages = _creations(form, "Square")
    assert board.ask(*submessages) == [OK] * len(submessages), desk.log()
    assert _topics(desk) == {"Square"}
    desk.close()


@pytest.mark.parametrize("name", ["rq/goRequest", "ra/a", "rt/a"])
def test_limits_apply_to_every_prefix(tmp_path, name):
    desk = _desk(tmp_path, name)
    desk.agent.rules.add({"max_size": 8, "qos": {"/go": {"depth": 3}, "/a": {"depth": 3}}})
    board = Board(desk, mtu=60_000)
    board.ask(*_creations("binary", name))
    board.send(helpers.write_data(WRITER, bytes(20)))
    assert "are over max_size 8" in desk.log()
    assert helpers.writer_of(board).qos.depth == 3
    desk.close()
