"""When a graph counts as settled, with news that come from a second participant here."""

import pytest

from uros.host.network import Network
from uros.middleware.dds import announce, cyclone
from uros.qos import QoSProfile


@pytest.fixture
def network(own_domain_id):
    with Network(own_domain_id) as joined:
        yield joined


@pytest.fixture
def other(network):
    """A participant as a ROS process makes it, before it has told anything."""
    entity = cyclone.create_participant(network.domain, b"enclave=/;")
    yield entity
    cyclone.delete(entity)


def announcer(entity):
    topic = cyclone.create_topic(entity, announce.TOPIC, announce.TYPE)
    return cyclone.create_writer(
        cyclone.create_group("publisher", entity), topic, announce.qos(), b""
    )


def tell(entity, writer, writers):
    node = announce.NodeEntities("/", "other", [], writers)
    cyclone.write(writer, announce.encode(cyclone.guid(entity), [node], 16))


def test_a_silent_ros_participant_is_waited_for(network, other):
    network.settle(0.3)
    assert network._discovery.silent() == {cyclone.guid(other)}
    writer = announcer(other)
    assert network.spin(network._discovery.unheard, 10)
    tell(other, writer, [])
    network.settle()
    assert not network._discovery.silent()
    assert "/other" in network.graph.nodes()


def test_asking_again_brings_what_was_told_before(network, other):
    tell(other, announcer(other), [])
    assert network.spin(lambda: "/other" in network.graph.nodes(), 10)
    network._discovery.announcements.forget(cyclone.guid(other))
    network._discovery.ask_again()
    assert network.spin(lambda: "/other" in network.graph.nodes(), 10)


def test_endpoints_that_are_announced_are_waited_for(network, other):
    topic = cyclone.create_topic(other, "rt/x", "std_msgs::msg::dds_::String_")
    group = cyclone.create_group("publisher", other)
    gid = cyclone.guid(cyclone.create_writer(group, topic, QoSProfile(), b""))
    ghost = gid[:12] + b"\xff\xff\xff\x03"
    writer = announcer(other)
    tell(other, writer, [gid, ghost])
    network.settle(1.0)
    assert network._discovery.missing() == {ghost}
    tell(other, writer, [gid])
    network.settle()
    assert not network._discovery.missing()
    assert network.graph.node("/other").publishers == {"/x": ["std_msgs/msg/String"]}


def test_a_participant_that_leaves_takes_all_along(network, other):
    tell(other, announcer(other), [])
    assert network.spin(lambda: "/other" in network.graph.nodes(), 10)
    cyclone.delete(other)
    assert network.spin(lambda: network.alone, 10)
    assert "/other" not in network.graph.nodes()
