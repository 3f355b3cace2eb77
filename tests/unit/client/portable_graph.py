"""The graph that an agent sends. Also runs on MicroPython.

GRAPH is encoded by hand from the definitions of micro_ros_msgs: nodes of namespace, name and
entities of kind, name and types. tests/interop compares with a real ROS 2.
"""

from support.board import KEY, FakeAgent, FakeClock, Number

from uros.client import AGENT_CONNECTED, WAITING_AGENT, Node
from uros.client.graph import Graph
from uros.wire import ids
from uros.wire.cdr import Reader
from uros.wire.entities import pull_binary_endpoint, pull_binary_topic, pull_create

GRAPH = (
    b"\2\0\0\0"
    b"\2\0\0\0/\0\0\0"
    b"\7\0\0\0talker\0\0"
    b"\2\0\0\0"
    b"\0\0\0\0" b"\5\0\0\0/abc\0\0\0\0" b"\1\0\0\0" b"\x15\0\0\0std_msgs/msg/Float32\0"
    b"\2\0\0" b"\4\0\0\0/go\0" b"\1\0\0\0" b"\x15\0\0\0std_srvs/srv/Trigger\0\0\0\0"
    b"\4\0\0\0/ns\0"
    b"\7\0\0\0listen\0\0"
    b"\3\0\0\0"
    b"\1\0\0\0" b"\5\0\0\0/abc\0\0\0\0" b"\2\0\0\0" b"\4\0\0\0x/B\0" b"\4\0\0\0x/A\0"
    b"\1\0\0\0" b"\3\0\0\0/z\0\0" b"\0\0\0\0"
    b"\3\0\0\0" b"\4\0\0\0/go\0" b"\1\0\0\0" b"\x15\0\0\0std_srvs/srv/Trigger\0"
)  # fmt: skip

FLOAT = "std_msgs/msg/Float32"
TRIGGER = "std_srvs/srv/Trigger"


class Bench:
    def __init__(self):
        self.clock = FakeClock()
        self.agent = FakeAgent(self.clock)
        self.node = Node("node", self.agent, key=KEY, clock=self.clock)
        self.calls = []
        self.graph = Graph(self.node, lambda: self.calls.append(self.graph.get_node_names()))
        self.until(AGENT_CONNECTED)

    def until(self, state):
        for _ in range(1000):
            if self.node.state == state:
                return
            self.node.spin_once(0.01)
        raise AssertionError(self.node.state)

    def tell(self, graph):
        self.agent.sample(0x06, graph)
        for _ in range(5):
            self.node.spin_once(0.01)


def test_the_graph_topic_is_requested_as_micro_ros_does() -> None:
    bench = Bench()
    contents = {}
    for _, payload in bench.agent.creations:
        _, object_id, _, _, content, _ = pull_create(Reader(payload, 0, len(payload), True))
        contents[object_id] = Reader(content, 0, len(content), True)
    assert pull_binary_topic(contents[0x02]) == (
        "ros_to_microros_graph", "micro_ros_msgs::msg::dds_::Graph_",
    )  # fmt: skip
    qos = pull_binary_endpoint(contents[0x06], True)[1]
    assert qos[:2] == (ids.QOS_RELIABLE | ids.QOS_KEEP_LAST | ids.QOS_TRANSIENT_LOCAL, 1)
    assert bench.agent.requests[-1] == (ids.READ_DATA, 0x06)


def test_a_graph_is_empty_before_the_first_message() -> None:
    bench = Bench()
    graph = bench.graph
    assert not graph.known and graph.get_node_names() == []
    assert graph.get_topic_names_and_types() == [] and graph.count_publishers("abc") == 0


def test_queries_of_the_graph() -> None:
    bench = Bench()
    graph = bench.graph
    bench.tell(GRAPH)
    assert graph.known and bench.calls == [["talker", "listen"]]
    assert graph.get_node_names_and_namespaces() == [("talker", "/"), ("listen", "/ns")]
    assert graph.get_topic_names_and_types() == [
        ("/abc", [FLOAT, "x/A", "x/B"]), ("/z", []),
    ]  # fmt: skip
    assert graph.get_service_names_and_types() == [("/go", [TRIGGER])]
    for ask, topics in (
        (graph.get_publisher_names_and_types_by_node, [("/abc", [FLOAT])]),
        (graph.get_service_names_and_types_by_node, [("/go", [TRIGGER])]),
        (graph.get_subscriber_names_and_types_by_node, []),
        (graph.get_client_names_and_types_by_node, []),
    ):
        assert ask("talker", "/") == topics
        assert ask("talker", "/ns") == []
    assert graph.get_subscriber_names_and_types_by_node("listen", "/ns") == [
        ("/abc", ["x/A", "x/B"]), ("/z", []),
    ]  # fmt: skip
    assert graph.get_client_names_and_types_by_node("listen", "/ns") == [("/go", [TRIGGER])]
    counts = [
        graph.count_publishers("abc"), graph.count_subscribers("/abc"),
        graph.count_publishers("z"), graph.count_subscribers("z"),
        graph.count_services("go"), graph.count_clients("go"), graph.count_services("abc"),
    ]  # fmt: skip
    assert counts == [1, 1, 0, 1, 1, 1, 0]


def test_only_the_last_of_several_graphs_calls_back() -> None:
    bench = Bench()
    bench.agent.sample(0x06, GRAPH)
    bench.node.connection.pump(0)
    bench.tell(b"\0\0\0\0")
    assert bench.calls[-1] == [] and bench.graph.known and not bench.graph.overfull()


def test_malformed_graphs_are_counted_and_ignored() -> None:
    bench = Bench()
    bench.tell(GRAPH)
    del bench.calls[:]
    for end in range(len(GRAPH)):
        bench.agent.sample(0x06, GRAPH[:end])
        bench.node.spin_once(0)
    bench.tell(b"\xff\xff\xff\xff")
    assert bench.calls == [] and bench.graph.malformed == len(GRAPH) + 1
    assert bench.graph.get_node_names() == ["talker", "listen"]


def test_a_graph_ends_with_its_session() -> None:
    bench = Bench()
    bench.tell(GRAPH)
    bench.agent.silent = True
    bench.until(WAITING_AGENT)
    assert not bench.graph.known and bench.graph.get_node_names() == []
    bench.agent.silent = False
    bench.agent.forget()
    bench.until(AGENT_CONNECTED)
    bench.tell(GRAPH)
    assert bench.graph.count_publishers("abc") == 1
    bench.graph.destroy()
    bench.tell(GRAPH)
    assert bench.node.executor.handles == [] and bench.graph.get_node_names() != []


def test_a_graph_does_not_affect_other_entities() -> None:
    bench = Bench()
    heard = []
    subscription = bench.node.create_subscription(
        Number, "abc", lambda message: heard.append(message.value)
    )
    assert subscription.number == 1
    bench.tell(GRAPH)
    bench.agent.sample(0x16, b"\7\0\0\0")
    bench.tell(GRAPH)
    assert heard == [7] and len(bench.calls) == 2
