"""``--json`` of listings and infos: one document with what the text has."""

import json

import pytest
from unit.host.test_graph_queries import FAST_DDS, Endpoint, Node

from uros.host import network as network_module
from uros.host.graph_queries import Graph
from uros.host.network import Network
from uros.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from uros.tools import cli
from uros.tools.listing import qos_entry

STRING = "std_msgs/msg/String"
TRIGGER = "std_srvs::srv::dds_::Trigger_"
PARTICIPANT = FAST_DDS + b"h" * 14


class Peopled:
    """A graph with the node /lab/talker and a hidden one."""

    def __init__(self):
        self.participants = {PARTICIPANT: b"enclave=/;"}
        self.endpoints = {}
        for is_writer, topic, kind in (
            (True, "rt/chatter", "std_msgs::msg::dds_::String_"),
            (False, "rt/_hidden", "std_msgs::msg::dds_::String_"),
            (False, "rq/goRequest", f"{TRIGGER}Request_"),
            (True, "rr/goReply", f"{TRIGGER}Response_"),
            (True, "rq/_secret/goRequest", f"{TRIGGER}Request_"),
        ):
            guid = PARTICIPANT[:12] + len(self.endpoints).to_bytes(4, "big")
            self.endpoints[guid] = Endpoint(
                guid, PARTICIPANT, is_writer, topic, kind, QoSProfile(7, lifespan_ms=3)
            )
        readers = [guid for guid, one in self.endpoints.items() if not one.is_writer]
        writers = [guid for guid, one in self.endpoints.items() if one.is_writer]
        self.announced = {
            PARTICIPANT: [Node("/lab", "talker", readers, writers), Node("/", "_hidden", [], [])]
        }


@pytest.fixture
def printed(monkeypatch, own_domain_id, capsys):
    """Runs a verb with --json on that graph; returns the document."""
    monkeypatch.setattr(network_module, "Graph", lambda source: Graph(Peopled()))
    monkeypatch.setattr(Network, "settle", lambda network, seconds=0.0: None)

    def run(*arguments, joins=True):
        domain = ["--domain", str(own_domain_id)] if joins else []
        assert cli.main([*arguments, "--json", *domain]) == 0
        out = capsys.readouterr().out
        assert out.count("\n") == 1
        return json.loads(out)

    return run


def test_topics(printed):
    chatter = {"name": "/chatter", "types": [STRING], "publishers": 1, "subscriptions": 0}
    hidden = {"name": "/_hidden", "types": [STRING], "publishers": 0, "subscriptions": 1}
    assert printed("topic", "list") == [chatter]
    assert printed("topic", "list", "--include-hidden-topics") == [hidden, chatter]
    assert printed("topic", "--include-hidden-topics", "list") == [hidden, chatter]
    assert printed("topic", "list", "-c") == 1
    info = printed("topic", "info", "/chatter")
    (publisher,) = info.pop("publishers")
    assert info == {"name": "/chatter", "types": [STRING], "subscriptions": []}
    assert (publisher["node_namespace"], publisher["node_name"]) == ("/lab", "talker")
    assert publisher["type"] == STRING and publisher["qos"]["lifespan"] == 3_000_000


@pytest.mark.parametrize("line", ["list", "info /chatter", "type /chatter", f"find {STRING}"])
def test_the_time_of_the_clock_changes_no_listing(printed, line):
    words = ["topic", *line.split(" ")]
    assert printed(*words, "-s") == printed(*words, "--use-sim-time") == printed(*words)


def test_nodes(printed):
    assert printed("node", "list") == [{"name": "/lab/talker"}]
    assert printed("node", "list", "-a") == [{"name": "/_hidden"}, {"name": "/lab/talker"}]
    assert printed("node", "list", "-c") == 1
    assert printed("node", "info", "/lab/talker") == {
        "name": "/lab/talker",
        "subscribers": [],
        "publishers": [{"name": "/chatter", "types": [STRING]}],
        "service_servers": [{"name": "/go", "types": ["std_srvs/srv/Trigger"]}],
        "service_clients": [],
        "action_servers": [],
        "action_clients": [],
    }


def test_services(printed):
    go = {"name": "/go", "types": ["std_srvs/srv/Trigger"]}
    hidden = {**go, "name": "/_secret/go"}
    assert printed("service", "list") == [go]
    assert printed("service", "list", "--include-hidden-services") == [hidden, go]
    assert printed("service", "--include-hidden-services", "list") == [hidden, go]
    assert printed("service", "find", "std_srvs/Trigger") == [go]
    assert printed("service", "find", "std_srvs/Trigger", "-c") == 1
    assert printed("service", "type", "/go") == ["std_srvs/srv/Trigger"]
    info = printed("service", "info", "/go")
    (server,) = info.pop("servers")
    assert info == {**go, "clients": []}
    assert server["request"]["type"] == "std_srvs/srv/Trigger_Request"
    assert server["response"]["qos"]["depth"] == 0


def test_interfaces_and_boards(printed):
    assert printed("interface", "list", "-s", joins=False)[0].split("/")[1] == "srv"
    assert "std_msgs" in printed("interface", "packages", joins=False)
    assert "std_msgs/msg/Bool" in printed("interface", "package", "std_msgs", joins=False)
    (first, *_) = printed("board", "list", joins=False)
    assert first["name"] == "ra6m5_sensor_node"
    details = printed("board", "list", first["name"], joins=False)
    assert {"name": "sht3x:crc"}.items() <= next(
        fault.items() for fault in details["faults"] if fault["name"] == "sht3x:crc"
    )
    assert printed("board", "list", "--ports", joins=False)[0]["name"] == "ek_ra6m5"


def test_unknown_policies_and_no_limits():
    entry = qos_entry(QoSProfile(1, ReliabilityPolicy.BEST_EFFORT, DurabilityPolicy.VOLATILE))
    assert entry["reliability"] == "BEST_EFFORT" and entry["durability"] == "VOLATILE"
    assert entry["deadline"] is None
    unknown = QoSProfile(1)
    unknown.reliability = 99
    assert qos_entry(unknown)["reliability"] == "UNKNOWN"
