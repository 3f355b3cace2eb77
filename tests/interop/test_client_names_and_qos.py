"""Names and QoS of the client's entities, compared with a real rclpy."""

import importlib.util
import json
import os
import subprocess
import time
from pathlib import Path

import pytest
from conftest import ROOT
from support.agent import running_agent
from support.middleware import MIDDLEWARE
from support.peer import ros_distro
from uros.interfaces.std_msgs.msg import Int32

from uros import qos
from uros.client import AGENT_CONNECTED, Node
from uros.client.graph import Graph
from uros.interfaces.codec import from_cdr
from uros.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy
from uros.transport.udp import UdpTransport

pytestmark = pytest.mark.timeout(120)
SCRIPT = Path(__file__).with_name("rclpy_query.py")
FIELDS = ("depth", "reliability", "durability", "history", "deadline_ms", "lifespan_ms")


def start_query(ros_python, domain, **question):
    environment = dict(os.environ, ROS_DOMAIN_ID=str(domain))
    for name in ("CYCLONEDDS_URI", "PYTHONPATH"):
        environment.pop(name, None)
    return subprocess.Popen(
        [str(ros_python), str(SCRIPT), json.dumps(question)],
        stdout=subprocess.PIPE, text=True, env=environment,
    )  # fmt: skip


def query_rclpy(ros_python, domain, **question):
    """Return rclpy's answer to a question of rclpy_query.py."""
    process = start_query(ros_python, domain, **question)
    out, _ = process.communicate(timeout=100)
    assert process.returncode == 0
    return json.loads(out)


@pytest.fixture(scope="module")
def remapping():
    """The module of the portable tests, for its cases."""
    path = ROOT / "tests/unit/client/portable_remap.py"
    spec = importlib.util.spec_from_file_location("portable_remap", path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_expected_remapping_is_that_of_rclpy(ros_python, domain, remapping):
    cases = [case[:4] for case in remapping.CASES]
    answers = query_rclpy(ros_python, domain, query="names", cases=cases)
    assert answers == [list(case[4]) for case in remapping.CASES]


def test_rules_that_uros_refuses_are_refused_by_rclpy(ros_python, domain, remapping):
    refused = query_rclpy(ros_python, domain, query="refused_rules", rules=remapping.BAD)
    assert refused == list(remapping.BAD)


def test_presets_equal_those_of_rclpy(ros_python, domain):
    presets = query_rclpy(ros_python, domain, query="presets")
    names = [name for name in dir(qos) if name.startswith("qos_profile_")]
    if ros_distro(ros_python) == "jazzy":  # its rclpy does not have this one
        names.remove("qos_profile_rosout_default")
    assert set(presets) - set(names) == {"qos_profile_unknown", "qos_profile_best_available"}
    for name in names:
        assert {field: getattr(getattr(qos, name), field) for field in FIELDS} == {
            field: presets[name][field] for field in FIELDS
        }, name


PROFILES = {
    "default": 10,
    "sensor": qos.qos_profile_sensor_data,
    "latched": qos.qos_profile_action_status_default,
    "rosout": qos.qos_profile_rosout_default,
    "system": qos.qos_profile_system_default,
    "all": QoSProfile(history=HistoryPolicy.KEEP_ALL),
    "deadline": QoSProfile(deadline_ms=1500),
    "lifespan": QoSProfile(5, ReliabilityPolicy.BEST_EFFORT, lifespan_ms=250),
    "everything": QoSProfile(
        7, durability=DurabilityPolicy.TRANSIENT_LOCAL, deadline_ms=100, lifespan_ms=200
    ),
}


def test_agent_endpoints_have_the_requested_qos(ros_python, domain):
    with running_agent("udp", MIDDLEWARE, domain) as agent:
        node = Node("qos", UdpTransport("127.0.0.1", agent.transport.port), domain_id=domain)
        for name, profile in PROFILES.items():
            node.create_publisher(Int32, f"/qos/{name}_out", profile)
            node.create_subscription(Int32, f"/qos/{name}_in", print, profile)
        topics = [f"/qos/{name}_{end}" for name in PROFILES for end in ("out", "in")]
        process = start_query(ros_python, domain, query="endpoints", topics=topics)
        while process.poll() is None:
            node.spin_once(0.05)
        answer = process.communicate()[0]
        node.destroy_node()
    profiles = json.loads(answer)
    assert set(profiles) == set(topics)
    for name, requested in PROFILES.items():
        profile = QoSProfile(requested) if isinstance(requested, int) else requested
        for end in ("out", "in"):
            announced = profiles[f"/qos/{name}_{end}"]
            reliability, durability = profile.reliability, profile.durability
            if not reliability:  # system default: DDS's default, which differs by the kind of end
                writer = end == "out"
                reliability = (
                    ReliabilityPolicy.RELIABLE if writer else ReliabilityPolicy.BEST_EFFORT
                )
            assert announced["reliability"] == reliability, (name, end)
            assert announced["durability"] == (durability or DurabilityPolicy.VOLATILE), (name, end)
            assert announced["deadline_ms"] == profile.deadline_ms, (name, end)
            if end == "out":  # DDS readers have no lifespan
                assert announced["lifespan_ms"] == profile.lifespan_ms, name


def test_a_late_subscriber_gets_as_many_samples_as_the_depth(domain, peer):
    """History and depth are not announced by discovery: the number of kept samples shows them."""
    with running_agent("udp", MIDDLEWARE, domain) as agent:
        node = Node("latched", UdpTransport("127.0.0.1", agent.transport.port), domain_id=domain)
        profile = QoSProfile(3, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        publisher = node.create_publisher(Int32, "/latched/three", profile)
        while node.state != AGENT_CONNECTED:
            node.spin_once(0.05)
        for i in range(5):
            assert publisher.publish(Int32(data=i))
        deadline = time.monotonic() + 1
        while time.monotonic() < deadline:
            node.spin_once(0.05)
        peer.do(
            "subscribe", topic="/latched/three", type="std_msgs/msg/Int32",
            durability="transient_local",
        )  # fmt: skip
        heard = [from_cdr(Int32, peer.message("/latched/three")).data for _ in range(3)]
        peer.do("unsubscribe", topic="/latched/three")
        node.destroy_node()
    assert heard == [2, 3, 4]


def test_a_board_sees_the_graph_of_real_nodes(domain, peer):
    peer.do("subscribe", topic="/graph/listened", type="std_msgs/msg/Int32")
    with running_agent("udp", MIDDLEWARE, domain) as agent:
        transport = UdpTransport("127.0.0.1", agent.transport.port, mtu=4096)
        node = Node("looking", transport, "board", domain_id=domain)
        node.create_publisher(Int32, "/graph/listened")
        graph = Graph(node)
        deadline = time.monotonic() + 20
        while graph.count_subscribers("/graph/listened") < 1:
            assert time.monotonic() < deadline, graph.get_topic_names_and_types()
            node.spin_once(0.05)
        assert ("peer", "/real") in graph.get_node_names_and_namespaces()
        assert ("looking", "/board") in graph.get_node_names_and_namespaces()
        assert dict(graph.get_topic_names_and_types())["/graph/listened"] == ["std_msgs/msg/Int32"]
        assert graph.count_publishers("/graph/listened") == 1
        assert graph.get_publisher_names_and_types_by_node("looking", "/board") == [
            ("/graph/listened", ["std_msgs/msg/Int32"])
        ]
        peer.do("unsubscribe", topic="/graph/listened")
        while graph.count_subscribers("/graph/listened"):
            assert time.monotonic() < deadline, graph.get_topic_names_and_types()
            node.spin_once(0.05)
        node.destroy_node()
