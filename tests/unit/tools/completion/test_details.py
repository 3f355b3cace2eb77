"""What nodes of the domain say of their parameters, transitions and topics."""

from types import SimpleNamespace

import pytest
from support.spinning import spinning

from uros.host.lifecycle import LifecycleNode
from uros.interfaces import load
from uros.tools.completion import details
from uros.tools.completion.shells import NO_FILES
from uros.tools.completion.words import complete
from uros.tools.values.fill import Filled

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


SETBOOL = "std_srvs/srv/SetBool"
ZEROS = "{x: 0.0, y: 0.0, z: 0.0}"


@pytest.mark.parametrize(
    "line, found",
    [
        ("topic pub /lab/cmd_vel ", ["geometry_msgs/msg/Twist"]),
        ("topic echo lab/cmd_vel geo", ["geometry_msgs/msg/Twist"]),
        ("topic pub /lab/cmd_vel std_msgs/msg/Strin", ["std_msgs/msg/String"]),
        ("topic pub /nobody std_msgs/msg/Strin", ["std_msgs/msg/String"]),
        ("service call /light ", [SETBOOL]),
        ("action send_goal /fib ", ["test_msgs/action/Fibonacci"]),
    ],
)
def test_the_type_is_that_of_the_name_before(monkeypatch, line, found):
    types = {
        "/lab/cmd_vel": ["geometry_msgs/msg/Twist"],
        "/light": [SETBOOL],
        "/fib": ["test_msgs/action/Fibonacci"],
    }
    monkeypatch.setattr(details, "_types", lambda typed: types)
    assert words(line) == found


def test_types_of_the_graph(own_domain_id):
    node = LifecycleNode("typed", domain_id=own_domain_id)
    node.create_publisher(load(POSE), "/lab/pose", 1)
    node.create_service(load(SETBOOL), "/lab/light", lambda request, response: response)
    here = f"--domain {own_domain_id}"
    with spinning(node):
        assert words(f"topic pub {here} /lab/pose ") == [POSE]
        assert words(f"service call {here} /lab/light ") == [SETBOOL]


@pytest.mark.parametrize(
    "line, values",
    [
        ("topic pub /x geometry_msgs/msg/Twist ", f"{{linear: {ZEROS}, angular: {ZEROS}}}"),
        ("topic pub /x std_msgs/msg/String {da", "{data: ''}"),
        ("topic pub /x std_msgs/msg/Byte ", "{data: 0}"),
        ("service call /x std_srvs/srv/SetBool ", "{data: false}"),
        ("service call /x std_srvs/Trigger ", "{}"),
        ("action send_goal /x test_msgs/action/Fibonacci ", "{order: 0}"),
    ],
)
def test_values_are_the_prototype_of_the_type(line, values):
    """The verbs take it as it is."""
    assert complete(line.split(" ")) == [(values, ""), NO_FILES]
    kind = load(line.split(" ")[3].replace("srvs/Trigger", "srvs/srv/Trigger"))
    part = {"topic": kind, "service": "Request", "action": "Goal"}[line.split(" ")[0]]
    Filled(getattr(kind, part) if isinstance(part, str) else kind, values)


@pytest.mark.parametrize("kind", ["no_msgs/msg/Missing", "std_srvs/srv/Trigger"])
def test_no_values_are_known_for_a_wrong_type(kind):
    assert complete(["topic", "pub", "/x", kind, ""]) == [NO_FILES]
