"""The ROS graph both ways: a real rclpy node for boards, and boards for it until they go."""

import signal
import subprocess
import sys
import time

import pytest
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from support.agent import RunningAgent, running_agent, serving
from support.client import XrceClient
from support.lines import UdpLine

from uros.agent.objects.ros_graph import TOPIC, TYPE
from uros.agent.policy.liveliness import Liveliness
from uros.interfaces import load as load_type
from uros.interfaces.codec import to_cdr
from uros.middleware.dds.paced_discovery import PacedDiscovery
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
    return [it for it in agent.middleware.context.schedule._jobs if isinstance(it, PacedDiscovery)]


# --- what boards are told --------------------------------------------------------------------


@pytest.fixture(scope="module")
def reads():
    """rosbags' reading of a graph: ``{(namespace, name): {(kind, name): [types]}}``."""
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
                (it.entity_type, it.name): list(it.types) for it in node.entities
            }
            for node in message.nodes
        }

    return read


def asking(agent, key, **more):
    """A board that wants to know the graph, as micro-ROS with RMW_UXRCE_GRAPH."""
    client = opened(agent, key, **more)
    flags = ids.QOS_RELIABLE | ids.QOS_KEEP_LAST | ids.QOS_TRANSIENT_LOCAL
    reader = client.reader("microros_graph", TOPIC, TYPE, flags, depth=1)
    client.read(reader)
    return client, reader


def told(client, reader, reads, ready, seconds=20):
    """The first graph that is ``ready``; later ones only follow from what happens after it."""
    deadline = time.monotonic() + seconds
    while True:
        graph = reads(client.sample(reader, deadline - time.monotonic()))
        if ready(graph):
            return graph


def test_a_board_is_told_what_a_ros_node_has_and_what_it_gets(agent, peer, reads):
    client, reader = asking(agent, 0x52000001)
    publishers = [(PUBLISHER, "/rosout"), (PUBLISHER, "/parameter_events")]
    known = "/real", "peer"
    graph = told(client, reader, reads, lambda it: set(publishers) <= it.get(known, {}).keys())
    assert graph[known][SERVER, "/real/peer/get_parameters"] == ["rcl_interfaces/srv/GetParameters"]
    assert graph["/", "microros_graph"] == {}
    peer.do("subscribe", topic="/graph/seen", type=INT32)
    ready = SUBSCRIBER, "/graph/seen"
    graph = told(client, reader, reads, lambda it: ready in it[known])
    assert graph[known][ready] == [INT32]
    peer.do("unsubscribe", topic="/graph/seen")
    told(client, reader, reads, lambda it: ready not in it[known])
    client.close()


def test_boards_are_told_of_each_other_until_they_leave(agent, reads):
    other = opened(agent, 0x52000002)
    other.writer("garden/weather", "rt/garden/t", DDS_INT32)
    other.service(
        ids.KIND_REPLIER, "garden/weather", "/garden/go",
        "std_srvs::srv::dds_::Trigger_Request_", "std_srvs::srv::dds_::Trigger_Response_",
    )  # fmt: skip
    client, reader = asking(agent, 0x52000003)
    second, second_reader = asking(agent, 0x52000004)
    known = "/garden", "weather"
    expected = {
        (PUBLISHER, "/garden/t"): [INT32],
        (SERVER, "/garden/go"): ["std_srvs/srv/Trigger"],
    }
    told(client, reader, reads, lambda it: it.get(known) == expected)
    told(second, second_reader, reads, lambda it: it.get(known) == expected)
    other.close()
    told(client, reader, reads, lambda it: known not in it)
    told(second, second_reader, reads, lambda it: known not in it)
    assert watched_graphs(agent)
    client.close()
    second.close()
    # The DELETE is answered when everything is closed.
    assert not watched_graphs(agent)
    assert "graph stopped" in agent.said.getvalue()


def test_a_graph_of_many_nodes_is_no_more_than_a_board_can_take(agent, peer, reads):
    """Sixty boards, and one that asks with the MTU of micro-ROS; another has room for all."""
    boards = [opened(agent, 0x52001000 + number) for number in range(60)]
    names = {("/crowd", f"board{number:02}") for number in range(60)}
    for number, board in enumerate(boards):
        board.writer(f"crowd/board{number:02}", f"rt/crowd/topic{number:02}", DDS_INT32)
    client, reader = asking(agent, 0x52000005)
    graph = told(client, reader, reads, lambda it: len(it) > 30, 30)
    assert not any(graph.values())  # names only, and not all of them
    large, large_reader = asking(agent, 0x52000006, mtu=8192)
    graph = told(
        large, large_reader, reads,
        lambda it: all(it.get(name) for name in names) and ("/real", "peer") in it, 30,
    )  # fmt: skip
    assert graph["/crowd", "board07"] == {(PUBLISHER, "/crowd/topic07"): [INT32]}
    for board in (*boards, client, large):
        board.close()
    assert "graph is cut" in agent.said.getvalue()
    for _, name in names:
        assert peer.do("gone", namespace="/crowd", name=name)["gone"]


# --- what ROS sees go -------------------------------------------------------------------------

SOON = 5


def board(agent, key, node="board"):
    """A client with a node, a writer and a reader; the client and their ids."""
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


def test_a_writer_and_a_reader_that_the_board_deletes_go_and_its_node_stays(agent, peer):
    client, writer, reader = board(agent, 0x52000011)
    client.writer("board", "rt/board/kept", DDS_INT32)
    assert_there(peer)
    assert client.delete(writer) == ids.STATUS_OK
    assert peer.do("unused", topic="/board/out", seconds=SOON)["unused"]
    assert peer.do("topic", topic="/board/in", of="subscriptions")["infos"]
    assert client.delete(reader) == ids.STATUS_OK
    assert peer.do("unused", topic="/board/in", seconds=SOON)["unused"]
    seen = peer.do("node", namespace="/", name="board", publishers={"/board/kept": INT32})
    assert "/board/out" not in seen["publishers"]
    client.close()
    assert_gone(peer)


def test_a_node_that_the_board_deletes_goes_and_its_other_node_stays(agent, peer):
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


def test_nothing_is_left_of_a_board_whose_tcp_connection_is_closed(domain, peer):
    with running_agent("tcp", "dds", domain) as agent:
        board(agent, 0x52000013)
        assert_there(peer)
        agent.lines[0].close()
        assert_gone(peer)


def test_nothing_is_left_of_a_board_that_is_switched_off_when_its_time_is_over(domain, peer):
    """By UDP nothing tells the agent but silence."""
    running = RunningAgent("udp", "dds", domain, 4)
    running.agent.liveliness = Liveliness(running.agent, dead_time=3)
    with serving(running) as agent:
        board(agent, 0x52000016)
        assert_there(peer)
        agent.lines[0].close()
        assert_gone(peer, seconds=3 * SOON)


def test_nothing_is_left_of_a_board_that_comes_again_as_another(agent, peer):
    """The same address, another client key: the board was flashed anew."""
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


# A participant that says no farewell is dropped when its lease is over: Cyclone's is ten seconds.
LEASE = 10


def test_a_killed_agent_is_gone_after_its_lease(domain, peer):
    agent = subprocess.Popen(
        [sys.executable, "-m", "uros", "agent", "udp4", "-p", "0", "--domain", str(domain)],
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
        assert time.monotonic() - killed > 1  # without a farewell
        line.close()
    finally:
        agent.kill()
        agent.communicate()


# --- types that uros does not know --------------------------------------------------------------


def test_an_own_type_has_no_hash_and_disturbs_nobody(agent, peer):
    client = opened(agent, 0x52000017)
    client.writer("maker", "rt/made", "my_robot_msgs::msg::dds_::WheelTicks_")
    client.reader("maker", "rt/wanted", "my_robot_msgs::msg::dds_::WheelTicks_")
    for topic, of in (("/made", "publishers"), ("/wanted", "subscriptions")):
        (info,) = peer.do("topic", topic=topic, of=of)["infos"]
        assert (info["type"], info["hash"]) == ("my_robot_msgs/msg/WheelTicks", "INVALID")
    seen = peer.do("node", namespace="/", name="maker",
                   publishers={"/made": "my_robot_msgs/msg/WheelTicks"})  # fmt: skip
    assert seen["publishers"]["/made"] == ["my_robot_msgs/msg/WheelTicks"]
    # Everything else goes on: rclpy and the board talk by known types.
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
