"""Queries of services in the ROS graph, with a network defined by each test as the source."""

from dataclasses import dataclass, field

from uros.host.graph_queries import Graph
from uros.qos import QoSProfile

TRIGGER = "std_srvs::srv::dds_::Trigger_"


@dataclass
class Endpoint:
    guid: bytes
    participant: bytes
    is_writer: bool
    topic: str
    type_name: str
    qos: QoSProfile = field(default_factory=QoSProfile)


class Net:
    def __init__(self):
        self.participants, self.announced, self.endpoints = {b"a": b"", b"b": b""}, {}, {}

    def add(self, participant, topic, type_name, is_writer):
        guid = bytes([len(self.endpoints)]) * 16
        self.endpoints[guid] = Endpoint(guid, participant, is_writer, topic, type_name)
        return guid

    def serve(self, participant, name):
        self.add(participant, f"rr{name}Reply", TRIGGER + "Response_", True)
        return self.add(participant, f"rq{name}Request", TRIGGER + "Request_", False)

    def ask(self, participant, name):
        self.add(participant, f"rr{name}Reply", TRIGGER + "Response_", False)
        self.add(participant, f"rq{name}Request", TRIGGER + "Request_", True)


def test_services_are_those_served_and_those_asked_for():
    net = Net()
    net.serve(b"a", "/go")
    net.ask(b"b", "/go")
    net.ask(b"b", "/away")
    net.add(b"a", "rt/go", "std_msgs::msg::dds_::String_", True)
    assert Graph(net).services() == {
        "/away": ["std_srvs/srv/Trigger"], "/go": ["std_srvs/srv/Trigger"],
    }  # fmt: skip
    assert Graph(net).topics() == {"/go": ["std_msgs/msg/String"]}


def test_a_server_reads_requests_and_writes_replies():
    net = Net()
    guid = net.serve(b"a", "/go")
    net.ask(b"b", "/go")
    (server,) = Graph(net).servers("/go")
    assert server.gid == guid and server.type_name == "std_srvs/srv/Trigger_Request"
    assert Graph(net).servers("/other") == []
    net.add(b"b", "rq/halfRequest", TRIGGER + "Request_", False)
    assert Graph(net).servers("/half") == []
