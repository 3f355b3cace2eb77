"""Hidden names are left out of every listing and of completion, unless an option includes them.

As in ros2: a topic or service is hidden if a part of its name begins with _, a node if its name
does, whatever its namespace; an action never is.
"""

import pytest
from support.graph_network import GraphNetwork
from unit.host.test_graph_queries import STRING, Net, Node

from uros.tools import cli
from uros.tools.completion.words import complete

TYPE = "std_msgs/msg/String"
TRIGGER = "std_srvs/srv/Trigger"
FIBONACCI = "test_msgs/action/Fibonacci"
NODES = ["/_robot/arm", "/lab/talker"]
HIDDEN_NODE = "/lab/_shadow"
TOPICS = ["/chatter"]
HIDDEN_TOPICS = ["/_deep/x", "/fib/_action/feedback", "/x/_y"]
SERVICES = ["/go"]
HIDDEN_SERVICES = ["/_robot/arm/list_parameters", "/lab/_shadow/list_parameters", "/x/_go"]
LISTING = "rcl_interfaces::srv::dds_::ListParameters_"


@pytest.fixture
def network(monkeypatch):
    """A domain with both kinds of each name."""
    net = Net()
    nodes = []
    participant = net.participant(nodes=nodes)

    def writer(topic, type_name):
        return net.endpoint(participant, topic, type_name, True)

    def server(name, type_name):
        return [
            net.endpoint(participant, f"rq{name}Request", f"{type_name}Request_", False),
            writer(f"rr{name}Reply", f"{type_name}Response_"),
        ]

    ends = [writer(f"rt{name}", STRING) for name in (*TOPICS, "/_deep/x", "/x/_y")]
    action = "test_msgs::action::dds_::Fibonacci_FeedbackMessage_"
    ends.append(writer("rt/fib/_action/feedback", action))
    for name in ("/go", "/x/_go"):
        ends += server(name, "std_srvs::srv::dds_::Trigger_")
    nodes.append(Node("/lab", "talker", ends, ends))
    for namespace, name in (("/lab", "_shadow"), ("/_robot", "arm")):
        ends = server(f"{namespace}/{name}/list_parameters", LISTING)
        nodes.append(Node(namespace, name, ends, ends))
    return GraphNetwork(net).join(monkeypatch)


@pytest.fixture
def printed(network, capsys):
    """Runs a command that ends well; returns the lines that it prints."""

    def run(line):
        assert cli.main(line.split(" ")) == 0
        return capsys.readouterr().out.splitlines()

    return run


@pytest.mark.parametrize(
    "line, option, shown, hidden",
    [
        ("topic list", "--include-hidden-topics", TOPICS, HIDDEN_TOPICS),
        (f"topic find {TYPE}", "--include-hidden-topics", TOPICS, ["/_deep/x", "/x/_y"]),
        ("service list", "--include-hidden-services", SERVICES, HIDDEN_SERVICES),
        (f"service find {TRIGGER}", "--include-hidden-services", SERVICES, ["/x/_go"]),
        ("node list", "--all", NODES, [HIDDEN_NODE]),
    ],
)
def test_listings(printed, line, option, shown, hidden):
    assert printed(line) == shown
    assert printed(f"{line} {option}") == sorted(shown + hidden)
    assert printed(f"{line} -c") == [str(len(shown))]


@pytest.mark.parametrize("verb", ["hz", "bw"])
def test_all_topics_are_measured_without_the_hidden_ones(printed, verb):
    ending = [f"Subscribed to [{topic}]" for topic in TOPICS]
    assert printed(f"topic {verb} -a")[1:] == ending
    ending = [f"Subscribed to [{topic}]" for topic in sorted(TOPICS + HIDDEN_TOPICS)]
    assert printed(f"topic {verb} -a --include-hidden-topics")[1:] == ending


def test_actions_are_never_hidden(printed):
    assert printed("action list") == printed(f"action find {FIBONACCI}") == ["/fib"]


def test_a_node_is_hidden_by_its_own_name_alone(printed, capsys):
    """Its namespace may be hidden, as for `node list`."""
    assert printed("node info /_robot/arm")[0] == "/_robot/arm"
    assert cli.main(["node", "info", HIDDEN_NODE]) == 1
    assert "is hidden: --include-hidden prints it" in capsys.readouterr().err
    assert printed(f"node info --include-hidden {HIDDEN_NODE}")[0] == HIDDEN_NODE


def test_of_a_node_hidden_names_are_left_out(printed):
    lines = printed("node info /lab/talker")
    assert f"    /chatter: {TYPE}" in lines and "    /fib: test_msgs/action/Fibonacci" in lines
    assert not [line for line in lines if "/_" in line]
    lines = printed("node info --include-hidden /lab/talker")
    assert {f"    /x/_y: {TYPE}", f"    /x/_go: {TRIGGER}"} <= set(lines)


def test_parameters_are_asked_of_the_nodes_that_are_listed(network, monkeypatch):
    from uros.tools.param import node

    asked = []
    monkeypatch.setattr(node, "list_all", lambda net, nodes, *_: asked.append(nodes) or {})
    assert cli.main(["param", "list"]) == cli.main(["param", "list", "--include-hidden-nodes"]) == 0
    assert asked == [["/_robot/arm"], ["/_robot/arm", HIDDEN_NODE]]


@pytest.mark.parametrize(
    "line, names",
    [
        ("topic echo ", TOPICS),
        ("topic hz /chatter ", TOPICS),
        ("topic bw --include-hidden-topics ", sorted(TOPICS + HIDDEN_TOPICS)),
        ("topic --include-hidden-topics echo ", sorted(TOPICS + HIDDEN_TOPICS)),
        ("topic echo /_", ["/_deep/x"]),
        ("topic echo _", ["_deep/x"]),
        ("topic echo /x/_", ["/x/_y"]),
        ("bag record --topics ", TOPICS),
        ("service type ", SERVICES),
        ("service --include-hidden-services call ", sorted(SERVICES + HIDDEN_SERVICES)),
        ("node info ", NODES),
        ("node info --include-hidden ", [NODES[0], HIDDEN_NODE, NODES[1]]),
        ("node info /lab/_", [HIDDEN_NODE]),
        ("param get ", NODES),
        ("param get --include-hidden-nodes ", [NODES[0], HIDDEN_NODE, NODES[1]]),
        ("action info ", ["/fib"]),
    ],
)
def test_completion(network, line, names):
    assert [word for word, _ in complete(line.split(" "))] == names
