"""What nodes of the domain say of their parameters, transitions and topics."""

from types import SimpleNamespace

import pytest
from support.spinning import spinning

from uros.host.lifecycle import LifecycleNode
from uros.interfaces import load
from uros.tools.completion import details
from uros.tools.completion.words import complete

POSE = "geometry_msgs/msg/PoseWithCovarianceStamped"


def words(line):
    return [word for word, _ in complete(line.split(" "))]


def test_a_node_is_asked(own_domain_id, monkeypatch, capsys):
    """It is waited for no longer than a user waits, and nothing is printed."""
    node = LifecycleNode("completed", domain_id=own_domain_id)
    node.declare_parameter("speed", 1.0)
    node.create_publisher(load(POSE), "/lab/pose", 1)
    here = f"--domain {own_domain_id}"
    with spinning(node):
        assert "speed" in words(f"param get {here} completed ")
        assert words(f"lifecycle set {here} /completed ") == ["configure", "shutdown"]
        assert words(f"topic echo {here} lab/pose --field h") == ["header"]
        assert words(f"plot {here} /lab/pose/po") == ["/lab/pose/pose/"]
        monkeypatch.setattr(details, "_ANSWER", 0.0)
        assert words(f"param get {here} /completed ") == []
        monkeypatch.setattr(details, "DISCOVERY", 0.0)
        assert words(f"param get {here} /nobody ") == []
    assert capsys.readouterr() == ("", "")


@pytest.mark.parametrize(
    "line, found",
    [
        ("get /x ", ["gain.left", "gain.right", "speed"]),
        ("delete /x gain.l", ["gain.left"]),
        ("describe /x speed gain.left ", ["gain.right"]),
        ("set /x speed 2.0 gain", ["gain.left", "gain.right"]),
        ("set /x speed ", []),
    ],
)
def test_parameters(monkeypatch, line, found):
    names = ["speed", "gain.right", "gain.left"]
    response = SimpleNamespace(result=SimpleNamespace(names=names))
    monkeypatch.setattr(details, "_ask", lambda typed, service, kind: response)
    assert words(f"param {line}") == found


@pytest.mark.parametrize(
    "line, found",
    [
        ("topic echo /lab/pose --field ", ["header", "pose"]),
        ("topic echo lab/pose --field pose.pose.", ["pose.pose.position", "pose.pose.orientation"]),
        ("topic echo /lab/pose --field=header.st", ["--field=header.stamp"]),
        ("topic echo /lab/pose --field pose.pose.position.x.", []),
        ("topic echo /lab/pose --field pose.covariance[0].", []),
        ("topic echo /lab/pose --field nothing.", []),
        ("topic echo /y --field ", []),
        ("topic echo /y sensor_msgs/msg/JointState --field n", ["name"]),
        ("topic echo /y geometry_msgs/msg/PoseArray --field poses[0].p", ["poses[0].position"]),
        ("topic echo /y geometry_msgs/msg/PoseArray --field poses.p", []),
        ("plot ", ["/lab/pose/", "/lab/"]),
        ("plot /la", ["/lab/pose/", "/lab/"]),
        ("plot /lab/pose/po", ["/lab/pose/pose/"]),
        ("plot lab/pose/pose/pose/position/", [f"lab/pose/pose/pose/position/{n}" for n in "xyz"]),
        ("plot /lab/pose/pose/cov", ["/lab/pose/pose/covariance[0]"]),
        ("plot /lab/data", ["/lab/data"]),
        ("plot /_", ["/_hidden/"]),
    ],
)
def test_fields(monkeypatch, line, found):
    types = {"/lab/pose": [POSE], "/lab": ["std_msgs/msg/Int32"]}
    types["/_hidden"] = types["/lab"]
    monkeypatch.setattr(details, "_types", lambda typed: types)
    assert words(line) == found
