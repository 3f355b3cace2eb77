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
    one = XrceClient(agent.line(), key, **more)
    assert one.open() == ids.STATUS_OK
    return one


def endpoints(agent, monkeypatch):
    """What the middleware is asked for, as it comes."""
    seen = []
    create = agent.middleware.create_node

    def create_node(domain, namespace, name, localhost_only=False):
        node = create(domain, namespace, name, localhost_only)
        seen.append(("node", domain, namespace, name))
        for kind in ("writer", "reader"):
            make = getattr(node, f"create_{kind}")

            def spy(topic, type_name, qos, *more, make=make, kind=kind):
                seen.append((kind, topic, qos))
                return make(topic, type_name, qos, *more)

            setattr(node, f"create_{kind}", spy)
        return node

    monkeypatch.setattr(agent.middleware, "create_node", create_node)
    return seen


def test_names_domain_and_qos_are_the_owners(agent, monkeypatch):
    agent.agent.rules.add({"namespace": "/hall", "qos": {"odom": {"depth": 1}}})
    agent.agent.rules.add(
        {
            "key": 2, "domain": 9, "remap": {"odom": "position"},
            "qos": {"/odom": {"reliability": "best_effort", "durability": "transient_local"}},
        }
    )  # fmt: skip
    seen = endpoints(agent, monkeypatch)
    one, two = client(agent, 1), client(agent, 2)
    one.writer("a/one", "rt/odom", TYPE)
    two.reader("two", "rt/odom", TYPE)
    assert seen == [
        ("node", 0, "/hall/a", "one"),
        ("writer", "rt/hall/odom", QoSProfile(1)),
        ("node", 9, "/hall", "two"),
        (
            "reader", "rt/position",
            QoSProfile(1, ReliabilityPolicy.BEST_EFFORT, DurabilityPolicy.TRANSIENT_LOCAL),
        ),
    ]  # fmt: skip
    assert "domain_id: 9, node: /hall/two" in agent.said.getvalue()


def test_a_domain_for_one_goes_before_the_one_for_all(monkeypatch):
    with running_agent("udp", "memory", 5) as agent:
        agent.agent.rules.add({"node": "/two", "domain": 9})
        seen = endpoints(agent, monkeypatch)
        client(agent, 1).writer("one", "rt/a", TYPE)
        client(agent, 2).writer("two", "rt/a", TYPE)
        assert [it[1] for it in seen if it[0] == "node"] == [5, 9]


def test_a_remapped_pair_meets_and_the_others_do_not(agent):
    agent.agent.rules.add({"key": 1, "remap": {"a": "b"}})
    one, two, three = (client(agent, key) for key in (1, 2, 3))
    readers = two.reader("two", "rt/a", TYPE), three.reader("three", "rt/b", TYPE)
    two.read(readers[0])
    three.read(readers[1])
    one.write(one.writer("one", "rt/a", TYPE), b"\1\0\0\0\0")
    assert three.sample(readers[1]) == b"\1\0\0\0\0"
    three.write(three.writer("three", "rt/a", TYPE), b"\2\0\0\0ab")
    assert two.sample(readers[0]) == b"\2\0\0\0ab"  # and not what came before


def test_a_service_is_found_under_its_new_name(agent):
    agent.agent.rules.add({"key": 1, "namespace": "/r1"})
    agent.agent.rules.add({"key": 2, "remap": {"go": "/r1/go"}})
    one, two = client(agent, 1), client(agent, 2)
    replier = one.service(ids.KIND_REPLIER, "one", *SERVICE)
    requester = two.service(ids.KIND_REQUESTER, "two", *SERVICE)
    one.read(replier)
    two.read(requester)
    two.write(requester, b"ask!")
    asked = one.sample(replier)
    assert asked[24:] == b"ask!"
    one.write(replier, asked[:24] + b"yes!")
    assert two.sample(requester)[-4:] == b"yes!"


def test_what_is_too_large_is_dropped_and_told(agent):
    agent.agent.rules.add({"max_size": 12})
    one = client(agent, 1)
    writer, reader = one.writer("one", "rt/a", TYPE), one.reader("one", "rt/a", TYPE)
    one.read(reader)
    one.write(writer, bytes(20))
    one.write(writer, bytes(4))
    assert one.sample(reader) == bytes(4)
    assert "message too large" in agent.said.getvalue()


def test_a_request_that_is_too_large_is_dropped_and_told(agent):
    agent.agent.rules.add({"max_size": 12})
    one = client(agent, 1)
    replier = one.service(ids.KIND_REPLIER, "one", *SERVICE)
    requester = one.service(ids.KIND_REQUESTER, "one", *SERVICE)
    one.read(replier)
    one.write(requester, bytes(20))
    one.write(requester, b"ask!")
    assert one.sample(replier)[24:] == b"ask!"
    assert "message too large" in agent.said.getvalue()


def test_a_rate_makes_a_reliable_client_wait_and_loses_nothing(agent):
    agent.agent.rules.add({"max_rate": 200})
    one = client(agent, 1)
    writer, reader = one.writer("one", "rt/a", TYPE), one.reader("one", "rt/a", TYPE)
    one.read(reader)
    for number in range(80):  # 50 at once, the others at 5 ms each
        one.write(writer, bytes([number]) * 4)
    assert [one.sample(reader) for _ in range(80)] == [bytes([it]) * 4 for it in range(80)]
    assert agent.agent.clients[1].session.dropped == 0


def test_a_rate_drops_best_effort_samples_and_counts_them(agent):
    agent.agent.rules.add({"max_rate": 0.001})
    one = client(agent, 1)
    writer = one.writer("one", "rt/a", TYPE, BEST_EFFORT)
    for number in range(10):
        one.write(writer, bytes([number]) * 4, stream=ids.STREAM_BEST_EFFORT)
    assert one.ping() == 1
    assert agent.agent.clients[1].session.dropped == 9


# --- every way to an endpoint, and every prefix -------------------------------------------------

HALVES = ("rq/goRequest", "rr/goReply", "rt/a", "rs/a", "rp/a", "ra/a", "rt/arm/_action/status")
DENIED = ids.STATUS_ERR_DENIED


def _profiles(name):
    """An endpoint's and a service's XML, with room for an attribute."""
    on = f"<topic><name>{name}</name><dataType>T</dataType></topic>"
    service = 'service_name="s" request_type="A" reply_type="B"'
    topics = "".join(f"<{it}>{name}</{it}>" for it in ("request_topic_name", "reply_topic_name"))
    return {
        WRITER: f"<data_writer{{}}>{on}</data_writer>",
        READER: f"<data_reader{{}}>{on}</data_reader>",
        REQUESTER: f"<requester{{}} {service}>{topics}</requester>",
        REPLIER: f"<replier{{}} {service}>{topics}</replier>",
    }


PARENTS = {
    WRITER: PUBLISHER, READER: SUBSCRIBER, REQUESTER: PARTICIPANT, REPLIER: PARTICIPANT,
}  # fmt: skip


def _made(form, name):
    """What makes one endpoint of each kind on a topic of this name."""
    start = [participant(), group(), group(SUBSCRIBER)]
    if form == "binary":
        return [
            *start, topic(name=name, type_name="T"), endpoint(),
            endpoint(READER, parent=SUBSCRIBER),
            *(helpers.create(it, ids.IN_BINARY, helpers.built(
                entities.push_binary_service, "s", "A", "B", name, name,
            ), PARTICIPANT) for it in (REQUESTER, REPLIER)),
        ]  # fmt: skip
    if form == "xml":
        return start + [
            xml(it, text.format(""), PARENTS[it]) for it, text in _profiles(name).items()
        ]
    if form == "reference":
        return start + [by_reference(it, f"p{it}", PARENTS[it]) for it in PARENTS]
    parts = "".join(text.format(f' object_id="0x{it:04X}"') for it, text in _profiles(name).items())
    inside = f'<domain_participant name="n">{parts}</domain_participant>'
    text = f'<application name="x">{inside}</application>'
    return [xml(APPLICATION, f"<dds><application_library>{text}</application_library></dds>")]


def _topics(desk):
    bus = desk.middleware.bus
    return {key[1] for ends in (bus.writers, bus.readers) for key, it in ends.items() if it}


def _desk(tmp_path, name):
    file = tmp_path / "agent.refs"
    texts = [text.format(f' profile_name="p{it}"') for it, text in _profiles(name).items()]
    file.write_text("<profiles>" + "".join(texts) + "</profiles>")
    return Desk(refs=file)


@pytest.mark.parametrize("form", ["binary", "xml", "reference", "application"])
@pytest.mark.parametrize("name", HALVES)
def test_no_endpoint_leaves_its_namespace_however_it_is_made(tmp_path, form, name):
    desk = _desk(tmp_path, name)
    desk.agent.rules.add({"namespace": "/jail"})
    board = Board(desk, mtu=60_000)
    made = _made(form, name)
    assert board.ask(*made) == [OK] * len(made), desk.log()
    assert _topics(desk) == {f"{name[:2]}/jail{name[2:]}"}
    desk.close()


@pytest.mark.parametrize("form", ["binary", "xml", "reference", "application"])
@pytest.mark.parametrize("name", ["rt/../x", "rq/../goRequest", "rt/jail/../x", "Square"])
def test_names_that_lead_out_are_refused_however_they_are_made(tmp_path, form, name):
    desk = _desk(tmp_path, name)
    desk.agent.rules.add({"namespace": "/jail"})
    board = Board(desk, mtu=60_000)
    answers = board.ask(*_made(form, name))
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
def test_names_that_are_none_of_ros_pass_where_no_rule_is_against_it(tmp_path, form):
    desk = _desk(tmp_path, "Square")
    board = Board(desk, mtu=60_000)
    made = _made(form, "Square")
    assert board.ask(*made) == [OK] * len(made), desk.log()
    assert _topics(desk) == {"Square"}
    desk.close()


@pytest.mark.parametrize("name", ["rq/goRequest", "ra/a", "rt/a"])
def test_limits_hold_for_every_prefix(tmp_path, name):
    desk = _desk(tmp_path, name)
    desk.agent.rules.add({"max_size": 8, "qos": {"/go": {"depth": 3}, "/a": {"depth": 3}}})
    board = Board(desk, mtu=60_000)
    board.ask(*_made("binary", name))
    board.send(helpers.write_data(WRITER, bytes(20)))
    assert "are over max_size 8" in desk.log()
    assert helpers.writer_of(board).qos.depth == 3
    desk.close()
