"""What our client calls things, and the QoS that an agent gives them, beside a real rclpy."""

import importlib.util
import json
import os
import subprocess
import time
from pathlib import Path

import pytest
from conftest import ROOT
from support.agent import running_agent
from uros.interfaces.std_msgs.msg import Int32

from uros import qos
from uros.client import AGENT_CONNECTED, Node
from uros.client.graph import Graph
from uros.interfaces.codec import from_cdr
from uros.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy
from uros.transport.udp import UdpTransport

pytestmark = pytest.mark.timeout(120)
SCRIPT = Path(__file__).with_name("asked.py")
FIELDS = ("depth", "reliability", "durability", "history", "deadline_ms", "lifespan_ms")


def asking(ros_python, domain, **question):
    environment = dict(os.environ, ROS_DOMAIN_ID=str(domain))
    for name in ("CYCLONEDDS_URI", "PYTHONPATH"):
        environment.pop(name, None)
    return subprocess.Popen(
        [str(ros_python), str(SCRIPT), json.dumps(question)],
        stdout=subprocess.PIPE, text=True, env=environment,
    )  # fmt: skip


def ask(ros_python, domain, **question):
    """rclpy's answer."""
    process = asking(ros_python, domain, **question)
    out, _ = process.communicate(timeout=100)
    assert process.returncode == 0
    return json.loads(out)


@pytest.fixture(scope="module")
def remapping():
    """The cases of the portable tests."""
    path = ROOT / "tests/unit/client/portable_remap.py"
    spec = importlib.util.spec_from_file_location("portable_remap", path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_the_remapping_that_our_tests_ask_for_is_rclpys(ros_python, domain, remapping):
    cases = [it[:4] for it in remapping.CASES]
    answers = ask(ros_python, domain, what="names", cases=cases)
    assert answers == [list(it[4]) for it in remapping.CASES]


def test_rules_that_we_refuse_are_refused_by_rclpy(ros_python, domain, remapping):
    assert ask(ros_python, domain, what="refused", rules=remapping.BAD) == list(remapping.BAD)


def test_presets_are_rclpys(ros_python, domain):
    presets = ask(ros_python, domain, what="presets")
    ours = [it for it in dir(qos) if it.startswith("qos_profile_")]
    assert set(presets) - set(ours) == {"qos_profile_unknown", "qos_profile_best_available"}
    for name in ours:
        assert {it: getattr(getattr(qos, name), it) for it in FIELDS} == {
            it: presets[name][it] for it in FIELDS
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


def test_an_agents_endpoints_have_the_qos_that_was_asked_for(ros_python, domain):
    with running_agent("udp", "dds", domain) as agent:
        node = Node("qos", UdpTransport("127.0.0.1", agent.transport.port), domain_id=domain)
        for name, profile in PROFILES.items():
            node.create_publisher(Int32, f"/qos/{name}_out", profile)
            node.create_subscription(Int32, f"/qos/{name}_in", print, profile)
        topics = [f"/qos/{name}_{way}" for name in PROFILES for way in ("out", "in")]
        process = asking(ros_python, domain, what="endpoints", topics=topics)
        while process.poll() is None:
            node.spin_once(0.05)
        said = process.communicate()[0]
        node.destroy_node()
    found = json.loads(said)
    assert set(found) == set(topics)
    for name, given in PROFILES.items():
        profile = QoSProfile(given) if isinstance(given, int) else given
        for way in ("out", "in"):
            seen = found[f"/qos/{name}_{way}"]
            reliability, durability = profile.reliability, profile.durability
            if not reliability:  # DDS's own default
                writer = way == "out"
                reliability = (
                    ReliabilityPolicy.RELIABLE if writer else ReliabilityPolicy.BEST_EFFORT
                )
            assert seen["reliability"] == reliability, (name, way)
            assert seen["durability"] == (durability or DurabilityPolicy.VOLATILE), (name, way)
            assert seen["deadline_ms"] == profile.deadline_ms, (name, way)
            if way == "out":  # a reader has none in DDS
                assert seen["lifespan_ms"] == profile.lifespan_ms, name


def test_who_comes_late_gets_as_many_as_the_depth_says(domain, peer):
    """History and depth do not show in discovery, but in what is kept."""
    with running_agent("udp", "dds", domain) as agent:
        node = Node("latched", UdpTransport("127.0.0.1", agent.transport.port), domain_id=domain)
        profile = QoSProfile(3, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        publisher = node.create_publisher(Int32, "/latched/three", profile)
        while node.state != AGENT_CONNECTED:
            node.spin_once(0.05)
        for i in range(5):
            assert publisher.publish(Int32(data=i))
        end = time.monotonic() + 1
        while time.monotonic() < end:
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
    with running_agent("udp", "dds", domain) as agent:
        transport = UdpTransport("127.0.0.1", agent.transport.port, mtu=4096)
        node = Node("looking", transport, "board", domain_id=domain)
        node.create_publisher(Int32, "/graph/listened")
        graph = Graph(node)
        end = time.monotonic() + 20
        while graph.count_subscribers("/graph/listened") < 1:
            assert time.monotonic() < end, graph.get_topic_names_and_types()
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
            assert time.monotonic() < end, graph.get_topic_names_and_types()
            node.spin_once(0.05)
        node.destroy_node()
