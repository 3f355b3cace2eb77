"""Queries of the ROS graph, with a network defined by each test as the source."""

from dataclasses import dataclass, field

import pytest

from uros.host.graph_queries import Graph
from uros.qos import HistoryPolicy, QoSProfile

HASH = "RIHS01_" + "0123456789abcdef" * 4
FAST_DDS, CYCLONE, UROS = b"\x01\x0f", b"\x01\x10", b"\x01\x75"
STRING = "std_msgs::msg::dds_::String_"


@dataclass
class Endpoint:
    guid: bytes
    participant: bytes
    is_writer: bool
    topic: str
    type_name: str
    qos: QoSProfile = field(default_factory=QoSProfile)


@dataclass(eq=False)
class Node:
    namespace: str
    name: str
    readers: list
    writers: list


class Net:
    """A source of participants, nodes and endpoints that the tests add."""

    def __init__(self):
        self.participants, self.endpoints, self.announced = {}, {}, {}

    def participant(self, vendor=FAST_DDS, nodes=None):
        guid = vendor + bytes([len(self.participants)]) * 10 + b"\0\0\x01\xc1"
        self.participants[guid] = b"enclave=/;"
        if nodes is not None:
            self.announced[guid] = nodes
        return guid

    def endpoint(self, participant, topic, type_name, is_writer, **qos):
        guid = participant[:12] + len(self.endpoints).to_bytes(4, "big")
        self.endpoints[guid] = Endpoint(
            guid, participant, is_writer, topic, type_name, QoSProfile(**qos)
        )
        return guid


@pytest.fixture
def net():
    return Net()


@pytest.fixture
def graph(net):
    return Graph(net)


def test_an_empty_network(graph):
    assert graph.topics() == {}
    assert graph.nodes() == []
    assert graph.node("/x") is None
    assert graph.publishers("/x") == graph.subscriptions("/x") == []


def test_topics_are_those_of_ros_with_all_their_types(net, graph):
    participant = net.participant()
    for topic, type_name, is_writer in [
        ("rt/b", STRING, True),
        ("rt/b", "std_msgs::msg::dds_::Int32_", False),
        ("rt/a", STRING, False),
        ("rq/goRequest", "std_srvs::srv::dds_::Empty_Request_", True),
        ("DCPSParticipant", "x", False),
    ]:
        net.endpoint(participant, topic, type_name, is_writer)
    assert graph.topics() == {
        "/a": ["std_msgs/msg/String"],
        "/b": ["std_msgs/msg/Int32", "std_msgs/msg/String"],
    }
    assert list(graph.topics()) == ["/a", "/b"]


@pytest.mark.parametrize("vendor", [CYCLONE, UROS], ids=["cyclone", "uros"])
def test_an_endpoint_knows_its_node_hash_and_history(net, graph, vendor):
    node = Node("/lab", "arm", [], [])
    participant = net.participant(vendor, [node])
    gid = net.endpoint(
        participant, "rt/x", STRING, True, depth=7, user_data=b"typehash=" + HASH.encode() + b";"
    )
    node.writers.append(gid)
    (info,) = graph.publishers("/x")
    assert (info.node_namespace, info.node_name) == ("/lab", "arm")
    assert info.type_name == "std_msgs/msg/String" and info.type_hash == HASH
    assert info.gid == gid and info.is_publisher
    assert (info.qos.history, info.qos.depth) == (HistoryPolicy.KEEP_LAST, 7)
    assert graph.subscriptions("/x") == []


def test_unknown_names_are_spelled_as_ros2_spells_them(net, graph):
    net.endpoint(net.participant(FAST_DDS, []), "rt/x", STRING, False)
    net.endpoint(net.participant(), "rt/x", STRING, False, user_data=b"typehash=broken;")
    bare, ros = graph.subscriptions("/x")
    assert bare.node_name == bare.node_namespace == "_CREATED_BY_BARE_DDS_APP_"
    assert (ros.node_namespace, ros.node_name) == (
        "_NODE_NAMESPACE_UNKNOWN_",
        "_NODE_NAME_UNKNOWN_",
    )
    assert bare.type_hash == "INVALID"
    assert bare.qos.history == HistoryPolicy.SYSTEM_DEFAULT  # Fast DDS does not tell it


def test_nodes_come_and_go_with_their_participant(net, graph):
    net.participant(nodes=[Node("/", "b", [], []), Node("/lab", "a", [], [])])
    departed = net.participant(nodes=[Node("/", "ghost", [], [])])
    del net.participants[departed]
    net.participant(nodes=[Node("/", "b", [], [])])
    assert graph.nodes() == ["/b", "/b", "/lab/a"]


def test_endpoints_of_a_node(net, graph):
    node = Node("/", "arm", [], [])
    participant = net.participant(nodes=[node])
    for topic, type_name, is_writer in [
        ("rt/out", STRING, True),
        ("rt/in", STRING, False),
        ("rq/serveRequest", "std_srvs::srv::dds_::Empty_Request_", False),
        ("rr/serveReply", "std_srvs::srv::dds_::Empty_Response_", True),
        ("rq/askRequest", "std_srvs::srv::dds_::Trigger_Request_", True),
        ("rr/askReply", "std_srvs::srv::dds_::Trigger_Response_", False),
        ("rt/fib/_action/feedback", "ex::action::dds_::Fibonacci_FeedbackMessage_", True),
        ("rt/nav/_action/feedback", "ex::action::dds_::Go_FeedbackMessage_", False),
    ]:
        endpoints = node.writers if is_writer else node.readers
        endpoints.append(net.endpoint(participant, topic, type_name, is_writer))
    assert graph.actions() == {"/fib": ["ex/action/Fibonacci"], "/nav": ["ex/action/Go"]}
    assert graph.action_nodes("/fib", False) == [("/arm", ["ex/action/Fibonacci"])]
    assert graph.action_nodes("/nav", True) == [("/arm", ["ex/action/Go"])]
    assert graph.action_nodes("/fib", True) == graph.action_nodes("/none", False) == []
    for service, of_clients in (("/serve", False), ("/ask", True)):
        ((request, reply),) = graph.service_endpoints(service, of_clients)
        assert request.is_publisher == of_clients and reply.is_publisher != of_clients
        assert graph.service_endpoints(service, not of_clients) == []
    node.readers.append(b"not discovered yet")
    info = graph.node("/arm")
    assert info.name == "/arm"
    assert info.publishers == {
        "/fib/_action/feedback": ["ex/action/Fibonacci_FeedbackMessage"],
        "/out": ["std_msgs/msg/String"],
    }
    assert info.subscribers["/in"] == ["std_msgs/msg/String"]
    assert info.service_servers == {"/serve": ["std_srvs/srv/Empty"]}
    assert info.service_clients == {"/ask": ["std_srvs/srv/Trigger"]}
    assert info.action_servers == {"/fib": ["ex/action/Fibonacci"]}
    assert info.action_clients == {"/nav": ["ex/action/Go"]}
