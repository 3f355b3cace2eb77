"""The ROS graph in both directions: boards see a real rclpy node, and it sees boards."""

import signal
import subprocess
import sys
import time

import pytest
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from support.agent import RunningAgent, running_agent, serving
from support.client import XrceClient
from support.lines import UdpLine
from support.middleware import MIDDLEWARE, WITH_SERVICES

from uros.agent.objects.ros_graph import TOPIC, TYPE
from uros.agent.policy.liveliness import Liveliness
from uros.interfaces import load as load_type
from uros.interfaces.codec import to_cdr
from uros.middleware.paced_call import PacedCall
from uros.wire import ids

INT32 = "std_msgs/msg/Int32"
DDS_INT32 = "std_msgs::msg::dds_::Int32_"
PUBLISHER, SUBSCRIBER, SERVER, CALLER = range(4)

pytestmark = pytest.mark.timeout(120)


def opened(agent, key, **more):
    client = XrceClient(agent.line(), key=key, **more)
    client.open()
    return client


def watched_graphs(agent):
    if MIDDLEWARE == "rtps":
        return list(agent.middleware._graphs)
    jobs = agent.middleware.context.schedule._jobs
    return [job for job in jobs if isinstance(job, PacedCall)]


# --- the graph that boards read --------------------------------------------------------------


@pytest.fixture(scope="module")
def reads():
    """Reads a graph by rosbags, as ``{(namespace, name): {(kind, name): [types]}}``."""
    store = get_typestore(Stores.EMPTY)
    store.register(
        get_types_from_msg(
            "byte entity_type\nstring<=256 name\nstring<=256[] types\n", "micro_ros_msgs/msg/Entity"
        )
        | get_types_from_msg(
            "string<=256 node_namespace\nstring<=256 node_name\nEntity[] entities\n",
            "micro_ros_msgs/msg/Node",
        )
        | get_types_from_msg("Node[] nodes\n", "micro_ros_msgs/msg/Graph")
    )

    def read(sample):
        message = store.deserialize_cdr(b"\0\1\0\0" + sample, "micro_ros_msgs/msg/Graph")
        return {
            (node.node_namespace, node.node_name): {
                (entity.entity_type, entity.name): list(entity.types) for entity in node.entities
            }
            for node in message.nodes
        }

    return read


def graph_reader(agent, key, **more):
    """A client with a reader of the graph, as that of micro-ROS with RMW_UXRCE_GRAPH."""
    client = opened(agent, key, **more)
    flags = ids.QOS_RELIABLE | ids.QOS_KEEP_LAST | ids.QOS_TRANSIENT_LOCAL
    reader = client.reader("microros_graph", TOPIC, TYPE, flags, depth=1)
    client.read(reader)
    return client, reader


def graph_when(client, reader, reads, ready, seconds=20):
    """Receive graphs until one is ``ready``, and return it. Each change sends another graph."""
    deadline = time.monotonic() + seconds
    while True:
        graph = reads(client.sample(reader, deadline - time.monotonic()))
        if ready(graph):
            return graph


def test_a_board_reads_the_endpoints_of_a_ros_node_and_their_changes(agent, peer, reads):
    client, reader = graph_reader(agent, 0x52000001)
    publishers = [(PUBLISHER, "/rosout"), (PUBLISHER, "/parameter_events")]
    node = "/real", "peer"
    graph = graph_when(
        client, reader, reads, lambda graph: set(publishers) <= graph.get(node, {}).keys()
    )
    assert graph[node][SERVER, "/real/peer/get_parameters"] == ["rcl_interfaces/srv/GetParameters"]
    assert graph["/", "microros_graph"] == {}
    peer.do("subscribe", topic="/graph/seen", type=INT32)
    subscription = SUBSCRIBER, "/graph/seen"
    graph = graph_when(client, reader, reads, lambda graph: subscription in graph[node])
    assert graph[node][subscription] == [INT32]
    peer.do("unsubscribe", topic="/graph/seen")
    graph_when(client, reader, reads, lambda graph: subscription not in graph[node])
    client.close()


def test_boards_see_each_other_in_the_graph_until_they_leave(agent, reads):
    """Two clients read the graph of a third; when all have left, the agent stops watching it."""
    weather = opened(agent, 0x52000002)
    weather.writer("garden/weather", "rt/garden/t", DDS_INT32)
    weather.service(
        ids.KIND_REPLIER, "garden/weather", "/garden/go",
        "std_srvs::srv::dds_::Trigger_Request_", "std_srvs::srv::dds_::Trigger_Response_",
    )  # fmt: skip
    client, reader = graph_reader(agent, 0x52000003)
    second, second_reader = graph_reader(agent, 0x52000004)
    node = "/garden", "weather"
    expected = {
        (PUBLISHER, "/garden/t"): [INT32],
        (SERVER, "/garden/go"): ["std_srvs/srv/Trigger"],
    }
    graph_when(client, reader, reads, lambda graph: graph.get(node) == expected)
    graph_when(second, second_reader, reads, lambda graph: graph.get(node) == expected)
    weather.close()
    graph_when(client, reader, reads, lambda graph: node not in graph)
    graph_when(second, second_reader, reads, lambda graph: node not in graph)
    assert watched_graphs(agent)
    client.close()
    second.close()
    # The agent answers the DELETE after it has closed everything.
    assert not watched_graphs(agent)
    assert "graph stopped" in agent.said.getvalue()


def test_a_graph_of_many_nodes_is_cut_to_what_a_board_can_take(agent, peer, reads):
    """Of sixty boards, a client with micro-ROS's MTU gets some names; an MTU of 8192 holds all."""
    boards = [opened(agent, 0x52001000 + number) for number in range(60)]
    names = {("/crowd", f"board{number:02}") for number in range(60)}
    for number, board in enumerate(boards):
        board.writer(f"crowd/board{number:02}", f"rt/crowd/topic{number:02}", DDS_INT32)
    client, reader = graph_reader(agent, 0x52000005)
    graph = graph_when(client, reader, reads, lambda graph: len(graph) > 30, 30)
    assert not any(graph.values())  # names without endpoints, and not all of the nodes
    large, large_reader = graph_reader(agent, 0x52000006, mtu=8192)
    graph = graph_when(
        large, large_reader, reads,
        lambda graph: all(graph.get(name) for name in names) and ("/real", "peer") in graph, 30,
    )  # fmt: skip
    assert graph["/crowd", "board07"] == {(PUBLISHER, "/crowd/topic07"): [INT32]}
    for board in (*boards, client, large):
        board.close()
    assert "graph is cut" in agent.said.getvalue()
    for _, name in names:
        assert peer.do("gone", namespace="/crowd", name=name)["gone"]


# --- how nodes of boards leave the ROS graph --------------------------------------------------

SOON = 5  # seconds


def board(agent, key, node="board"):
    """Return a client with a node, a writer and a reader, and the ids of the last two."""
    client = opened(agent, key)
    writer = client.writer(node, f"rt/{node}/out", DDS_INT32)
    reader = client.reader(node, f"rt/{node}/in", DDS_INT32)
    return client, writer, reader


def assert_there(peer, node="board"):
    out = {f"/{node}/out": INT32}
    assert peer.do("node", namespace="/", name=node, publishers=out)["publishers"]
    assert peer.do("topic", topic=f"/{node}/in", of="subscriptions")["infos"]


def assert_gone(peer, node="board", seconds=SOON):
    assert peer.do("gone", namespace="/", name=node, seconds=seconds)["gone"]
    for topic in (f"/{node}/out", f"/{node}/in"):
        assert peer.do("unused", topic=topic, seconds=seconds)["unused"], topic


def test_deleted_writers_and_readers_leave_the_graph_and_the_node_stays(agent, peer):
    client, writer, reader = board(agent, 0x52000011)
    client.writer("board", "rt/board/kept", DDS_INT32)
    assert_there(peer)
    assert client.delete(writer) == ids.STATUS_OK
    assert peer.do("unused", topic="/board/out", seconds=SOON)["unused"]
    assert peer.do("topic", topic="/board/in", of="subscriptions")["infos"]
    assert client.delete(reader) == ids.STATUS_OK
    assert peer.do("unused", topic="/board/in", seconds=SOON)["unused"]
    answer = peer.do("node", namespace="/", name="board", publishers={"/board/kept": INT32})
    assert "/board/out" not in answer["publishers"]
    client.close()
    assert_gone(peer)


def test_a_deleted_node_leaves_the_graph_and_the_other_node_stays(agent, peer):
    client, _, _ = board(agent, 0x52000012)
    client.writer("staying", "rt/staying/out", DDS_INT32)
    client.reader("staying", "rt/staying/in", DDS_INT32)
    assert_there(peer)
    assert_there(peer, "staying")
    assert client.delete(client.participant("board")) == ids.STATUS_OK
    assert_gone(peer)
    assert_there(peer, "staying")
    client.close()
    assert_gone(peer, "staying")


def test_a_board_whose_tcp_connection_closes_leaves_the_graph(domain, peer):
    with running_agent("tcp", MIDDLEWARE, domain) as agent:
        board(agent, 0x52000013)
        assert_there(peer)
        agent.lines[0].close()
        assert_gone(peer)


def test_a_silent_udp_board_leaves_the_graph_after_its_dead_time(domain, peer):
    """Over UDP the agent notices by its silence alone that a board is switched off."""
    running = RunningAgent("udp", MIDDLEWARE, domain, 4)
    running.agent.liveliness = Liveliness(running.agent, dead_time=3)
    with serving(running) as agent:
        board(agent, 0x52000016)
        assert_there(peer)
        agent.lines[0].close()
        assert_gone(peer, seconds=3 * SOON)


def test_a_board_that_returns_with_another_key_replaces_the_old_one(agent, peer):
    """A client with the same address and another key, as after a board was flashed again."""
    line = agent.line()
    old = XrceClient(line, key=0x52000014)
    old.open()
    old.writer("board", "rt/board/out", DDS_INT32)
    old.reader("board", "rt/board/in", DDS_INT32)
    assert_there(peer)
    new = XrceClient(line, key=0x52000015)
    new.open()
    new.writer("renewed", "rt/renewed/out", DDS_INT32)
    assert_gone(peer)
    assert peer.do("node", namespace="/", name="renewed", publishers={"/renewed/out": INT32})
    new.close()


# Seconds after which a participant is removed that did not announce its end.
LEASE = {"dds": 10, "rtps": 20}[MIDDLEWARE]


def test_a_killed_agent_is_gone_after_its_lease(domain, peer):
    agent = subprocess.Popen(
        [sys.executable, "-m", "uros", "agent", "udp4", "-p", "0", "-m", WITH_SERVICES,
         "--domain", str(domain)],
        stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True,
    )  # fmt: skip
    try:
        port = next(int(line.split()[-1]) for line in agent.stdout if "port: " in line)
        line = UdpLine(port)
        client = XrceClient(line, key=0x52000016)
        client.open()
        client.writer("board", "rt/board/out", DDS_INT32)
        client.reader("board", "rt/board/in", DDS_INT32)
        assert_there(peer)
        agent.send_signal(signal.SIGKILL)
        killed = time.monotonic()
        assert_gone(peer, seconds=LEASE + 5)
        assert time.monotonic() - killed > 1  # it did not announce its end
        line.close()
    finally:
        agent.kill()
        agent.communicate()


# --- types that uros does not know --------------------------------------------------------------


def test_an_unknown_type_has_no_hash_and_other_types_still_work(agent, peer):
    client = opened(agent, 0x52000017)
    client.writer("maker", "rt/made", "my_robot_msgs::msg::dds_::WheelTicks_")
    client.reader("maker", "rt/wanted", "my_robot_msgs::msg::dds_::WheelTicks_")
    for topic, of in (("/made", "publishers"), ("/wanted", "subscriptions")):
        (info,) = peer.do("topic", topic=topic, of=of)["infos"]
        assert (info["type"], info["hash"]) == ("my_robot_msgs/msg/WheelTicks", "INVALID")
    answer = peer.do("node", namespace="/", name="maker",
                     publishers={"/made": "my_robot_msgs/msg/WheelTicks"})  # fmt: skip
    assert answer["publishers"]["/made"] == ["my_robot_msgs/msg/WheelTicks"]
    # Other topics still work: the board receives an Int32 from rclpy.
    reader = client.reader("maker", "rt/to_maker", DDS_INT32)
    client.read(reader)
    message = load_type(INT32)()
    message.data = 7
    cdr = [to_cdr(message).hex()]
    for _ in range(50):
        assert peer.do("publish", topic="/to_maker", type=INT32, cdr=cdr)["subscribers"]
        if client.wait_sample(reader, 0.1):
            break
    assert client.sample(reader) == (7).to_bytes(4, "little")
    client.close()
    assert peer.do("gone", namespace="/", name="maker", seconds=SOON)["gone"]
