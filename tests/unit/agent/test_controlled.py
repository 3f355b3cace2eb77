"""Rules at work: clients of an agent whose owner has decided something for them."""

import pytest
from support.agent import running_agent
from support.client import BEST_EFFORT, XrceClient

from uros.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from uros.wire import ids

TYPE = "std_msgs::msg::dds_::String_"
SERVICE = ("go", "p::srv::dds_::Go_Request_", "p::srv::dds_::Go_Response_")


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
    agent.agent.control.add({"namespace": "/hall", "qos": {"odom": {"depth": 1}}})
    agent.agent.control.add(
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
        agent.agent.control.add({"node": "/two", "domain": 9})
        seen = endpoints(agent, monkeypatch)
        client(agent, 1).writer("one", "rt/a", TYPE)
        client(agent, 2).writer("two", "rt/a", TYPE)
        assert [it[1] for it in seen if it[0] == "node"] == [5, 9]


def test_a_remapped_pair_meets_and_the_others_do_not(agent):
    agent.agent.control.add({"key": 1, "remap": {"a": "b"}})
    one, two, three = (client(agent, key) for key in (1, 2, 3))
    readers = two.reader("two", "rt/a", TYPE), three.reader("three", "rt/b", TYPE)
    two.read(readers[0])
    three.read(readers[1])
    one.write(one.writer("one", "rt/a", TYPE), b"\1\0\0\0\0")
    assert three.sample(readers[1]) == b"\1\0\0\0\0"
    three.write(three.writer("three", "rt/a", TYPE), b"\2\0\0\0ab")
    assert two.sample(readers[0]) == b"\2\0\0\0ab"  # and not what came before


def test_a_service_is_found_under_its_new_name(agent):
    agent.agent.control.add({"key": 1, "namespace": "/r1"})
    agent.agent.control.add({"key": 2, "remap": {"go": "/r1/go"}})
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
    agent.agent.control.add({"max_size": 12})
    one = client(agent, 1)
    writer, reader = one.writer("one", "rt/a", TYPE), one.reader("one", "rt/a", TYPE)
    one.read(reader)
    one.write(writer, bytes(20))
    one.write(writer, bytes(4))
    assert one.sample(reader) == bytes(4)
    assert "message too large" in agent.said.getvalue()


def test_a_request_that_is_too_large_is_dropped_and_told(agent):
    agent.agent.control.add({"max_size": 12})
    one = client(agent, 1)
    replier = one.service(ids.KIND_REPLIER, "one", *SERVICE)
    requester = one.service(ids.KIND_REQUESTER, "one", *SERVICE)
    one.read(replier)
    one.write(requester, bytes(20))
    one.write(requester, b"ask!")
    assert one.sample(replier)[24:] == b"ask!"
    assert "message too large" in agent.said.getvalue()


def test_a_rate_makes_a_reliable_client_wait_and_loses_nothing(agent):
    agent.agent.control.add({"max_rate": 200})
    one = client(agent, 1)
    writer, reader = one.writer("one", "rt/a", TYPE), one.reader("one", "rt/a", TYPE)
    one.read(reader)
    for number in range(80):  # 50 at once, the others at 5 ms each
        one.write(writer, bytes([number]) * 4)
    assert [one.sample(reader) for _ in range(80)] == [bytes([it]) * 4 for it in range(80)]
    assert agent.agent.clients[1].session.dropped == 0


def test_a_rate_drops_best_effort_samples_and_counts_them(agent):
    agent.agent.control.add({"max_rate": 0.001})
    one = client(agent, 1)
    writer = one.writer("one", "rt/a", TYPE, BEST_EFFORT)
    for number in range(10):
        one.write(writer, bytes([number]) * 4, stream=ids.STREAM_BEST_EFFORT)
    assert one.ping() == 1
    assert agent.agent.clients[1].session.dropped == 9
