"""Network.settle: the graph is complete after the changes of a second participant."""

from contextlib import contextmanager

import pytest

from uros.host.direct import Direct
from uros.host.network import Network, complete_at
from uros.middleware import open_middleware
from uros.middleware.base import Service
from uros.middleware.dds import cyclone
from uros.middleware.discovery_info import codec
from uros.middleware.graph import (
    undiscovered_endpoints,
    with_missed_discovery_info,
    without_discovery_info,
)
from uros.qos import QoSProfile


@pytest.fixture
def network(own_domain_id):
    with Network(own_domain_id) as network:
        yield network


@pytest.fixture
def other(network):
    """A participant as a ROS process creates it, before it announces its nodes."""
    entity = cyclone.create_participant(network.domain, b"enclave=/;")
    yield entity
    cyclone.delete(entity)


TRIGGER = "std_srvs::srv::dds_::Trigger_"


@contextmanager
def auto_server(domain, service):
    """A server on the middleware auto, which runs in a thread."""
    connection = Direct(open_middleware("auto"), domain)  # takes its turns in the background
    node = connection.middleware.create_node(domain, "/", "server")
    replier = node.create_replier(service, QoSProfile(), lambda: None)
    yield
    replier.close()
    node.close()
    connection.close()


def info_writer(entity):
    topic = cyclone.create_topic(entity, codec.TOPIC, codec.TYPE)
    return cyclone.create_writer(cyclone.create_group("publisher", entity), topic, codec.qos(), b"")


def announce(entity, writer, writers):
    node = codec.NodeEntities("/", "other", [], writers)
    cyclone.write(writer, codec.encode(cyclone.guid(entity), [node], 16))


def test_a_ros_participant_without_discovery_info_is_waited_for(network, other):
    network.settle(0.3)
    assert without_discovery_info(network._discovery) == {cyclone.guid(other)}
    writer = info_writer(other)
    assert network.spin(lambda: with_missed_discovery_info(network._discovery), 10)
    announce(other, writer, [])
    network.settle()
    assert not without_discovery_info(network._discovery)
    assert "/other" in network.graph.nodes()


def test_the_participant_that_auto_has_for_services_is_not_waited_for(network):
    """It announces no nodes: the one of Cyclone lists its endpoints."""
    names = "rq/goRequest", f"{TRIGGER}Request_", "rr/goReply", f"{TRIGGER}Response_"
    with auto_server(network.domain, Service(*names)):
        assert network.spin(lambda: len(network._discovery.participants) >= 3, 20)
        assert network.spin(lambda: "/server" in network.graph.nodes(), 20)
        assert not without_discovery_info(network._discovery)


def test_a_new_reader_gets_earlier_discovery_info(network, other):
    announce(other, info_writer(other), [])
    assert network.spin(lambda: "/other" in network.graph.nodes(), 10)
    network._discovery._info_reader.intake.forget(cyclone.guid(other))
    network._discovery.reread_discovery_info()
    assert network.spin(lambda: "/other" in network.graph.nodes(), 10)


def test_endpoints_that_are_announced_are_waited_for(network, other):
    topic = cyclone.create_topic(other, "rt/x", "std_msgs::msg::dds_::String_")
    group = cyclone.create_group("publisher", other)
    gid = cyclone.guid(cyclone.create_writer(group, topic, QoSProfile(), b""))
    ghost = gid[:12] + b"\xff\xff\xff\x03"
    writer = info_writer(other)
    announce(other, writer, [gid, ghost])
    network.settle(1.0)
    assert undiscovered_endpoints(network._discovery) == {ghost}
    announce(other, writer, [gid])
    network.settle()
    assert not undiscovered_endpoints(network._discovery)
    assert network.graph.node("/other").publishers == {"/x": ["std_msgs/msg/String"]}


def test_the_nodes_of_a_participant_leave_with_it(network, other):
    announce(other, info_writer(other), [])
    assert network.spin(lambda: "/other" in network.graph.nodes(), 10)
    cyclone.delete(other)
    assert network.spin(lambda: network.alone, 10)
    assert "/other" not in network.graph.nodes()


@pytest.mark.parametrize(
    "changed_at, alone, silent, at",
    [
        (0.0, True, False, 0.6),  # our announcements were repeated, and nobody answered
        (0.5, True, False, 0.7),
        (0.05, False, False, 0.3),  # others may be slow to answer
        (0.4, False, False, 0.6),
        (0.4, False, True, 1.65),  # Fast DDS repeats the announcement of its endpoints
    ],
)
def test_when_a_listing_ends(changed_at, alone, silent, at):
    """0.2 s after the last change, and not before 0.3 s."""
    assert complete_at(10.0, 10.0 + changed_at, alone, silent) == pytest.approx(10.0 + at)
