"""Types of topics, services and actions: the verbs ``type`` and ``find`` of all three."""

import json

import pytest
from support.graph_network import GraphNetwork
from unit.host.test_graph_queries import STRING, Net, Node

from uros.tools import cli
from uros.tools.errors import ToolError
from uros.tools.graph_types import only_type

TYPES = {
    "topic": ("/chatter", "std_msgs/msg/String"),
    "service": ("/go", "std_srvs/srv/Trigger"),
    "action": ("/fib", "test_msgs/action/Fibonacci"),
}


@pytest.fixture
def printed(monkeypatch, capsys):
    """Runs a command in a domain that has one of each, and a topic of two types."""
    net = Net()
    ends = []
    participant = net.participant(nodes=[Node("/", "all", ends, ends)])
    for topic, type_name in (
        ("rt/chatter", STRING),
        ("rt/mixed", STRING),
        ("rt/mixed", "std_msgs::msg::dds_::Int32_"),
        ("rq/goRequest", "std_srvs::srv::dds_::Trigger_Request_"),
        ("rt/fib/_action/feedback", "test_msgs::action::dds_::Fibonacci_FeedbackMessage_"),
    ):
        ends.append(net.endpoint(participant, topic, type_name, True))
    GraphNetwork(net).join(monkeypatch)

    def run(*words, status=0):
        assert cli.main([*words]) == status
        captured = capsys.readouterr()
        return captured.err if status else captured.out

    return run


@pytest.mark.parametrize("kind", TYPES)
def test_the_type_of_a_name(printed, kind):
    name, type_name = TYPES[kind]
    assert printed(kind, "type", name) == printed(kind, "type", name[1:]) == f"{type_name}\n"
    assert json.loads(printed(kind, "type", name, "--json")) == [type_name]
    said = printed(kind, "type", f"{name}o", status=1)
    assert said == f"uros: there is no {kind} '{name}o' in domain 0; did you mean '{name}'?\n"


def test_the_types_of_a_topic(printed):
    both = ["std_msgs/msg/Int32", "std_msgs/msg/String"]
    assert printed("topic", "type", "/mixed").split() == both
    assert json.loads(printed("topic", "type", "/mixed", "--json")) == both


@pytest.mark.parametrize("kind", TYPES)
def test_the_names_of_a_type(printed, kind):
    name, type_name = TYPES[kind]
    names = [name, "/mixed"] if kind == "topic" else [name]
    package, _, short = type_name.split("/")
    assert printed(kind, "find", type_name).split() == names
    assert printed(kind, "find", f"{package}/{short}").split() == names
    assert printed(kind, "find", type_name, "-c") == f"{len(names)}\n"
    found = json.loads(printed(kind, "find", type_name, "--json"))
    assert [entry["name"] for entry in found] == names
    assert all(type_name in entry["types"] for entry in found)


@pytest.mark.parametrize("kind", TYPES)
def test_a_type_that_nothing_has(printed, capsys, kind):
    for wanted, said in (("Strin", "no definition of the type Strin is known"),
                         (f"{TYPES[kind][1]}x", f"did you mean '{TYPES[kind][1]}'?")):  # fmt: skip
        assert cli.main([kind, "find", wanted]) == 0
        captured = capsys.readouterr()
        assert captured.out == "" and said.rstrip("?") in captured.err


def test_of_several_types_one_must_be_given():
    assert only_type("topic echo", "/x", ["a/msg/A"]) == "a/msg/A"
    with pytest.raises(ToolError, match="/x has several types: a/msg/A, a/msg/B; give one: uros"):
        only_type("topic echo", "/x", ["a/msg/A", "a/msg/B"])
