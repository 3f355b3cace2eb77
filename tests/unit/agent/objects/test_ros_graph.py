"""The ROS graph for boards: its message, what is cut where room is short, and who receives it."""

from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from unit.agent.helpers import (
    PARTICIPANT,
    READER,
    RELIABLE_10,
    SUBSCRIBER,
    TOPIC,
    Board,
    Desk,
    create,
    delete,
    endpoint,
    group,
    participant,
    read_data,
    topic,
)

from uros.agent.objects import ros_graph
from uros.agent.objects.ros_graph import (
    PUBLISHER,
    SERVICE_CLIENT,
    SERVICE_SERVER,
    Entity,
    GraphNode,
)
from uros.middleware.base import MiddlewareError
from uros.wire import ids

SUBSCRIPTION = ros_graph.SUBSCRIBER

# --- the message ----------------------------------------------------------------------

# Written by hand from Graph.msg, Node.msg and Entity.msg of micro_ros_msgs and from CDR, not by an
# agent or ROS.
HAND = bytes.fromhex(
    "02000000"  # two nodes
    "02000000" "2f00" "0000"  # "/", padding
    "02000000" "6100" "0000"  # "a", padding
    "00000000"  # no entities
    "08000000" "2f67617264656e00"  # "/garden"
    "08000000" "7765617468657200"  # "weather"
    "02000000"  # two entities
    "00" "000000"  # PUBLISHER, padding
    "0a000000" "2f67617264656e2f7400" "0000"  # "/garden/t", padding
    "01000000"  # one type
    "1c000000" "73656e736f725f6d7367732f6d73672f54656d706572617475726500"
    "02" "000000"  # SERVICE_SERVER, padding
    "04000000" "2f676f00"  # "/go"
    "01000000"
    "15000000" "7374645f737276732f7372762f5472696767657200"  # "std_srvs/srv/Trigger"
)  # fmt: skip

TEMPERATURE = Entity(PUBLISHER, "/garden/t", ("sensor_msgs/msg/Temperature",))
GO = Entity(SERVICE_SERVER, "/go", ("std_srvs/srv/Trigger",))
NODES = [GraphNode("/", "a", ()), GraphNode("/garden", "weather", (TEMPERATURE, GO))]


def test_the_message_is_the_hand_written_bytes():
    assert ros_graph.encode(NODES) == HAND
    assert ros_graph.encode([]) == bytes(4)


# From micro_ros_msgs 1.0; the constants are what graph.py calls PUBLISHER and so on.
DEFINITIONS = {
    "Entity": "byte PUBLISHER=0\nbyte SUBSCRIBER=1\nbyte SERVICE_SERVER=2\nbyte SERVICE_CLIENT=3\n"
    "byte entity_type\nstring<=256 name\nstring<=256[] types\n",
    "Node": "string<=256 node_namespace\nstring<=256 node_name\nEntity[] entities\n",
    "Graph": "Node[] nodes\n",
}


@pytest.fixture(scope="module")
def oracle():
    store = get_typestore(Stores.EMPTY)
    definitions = {}
    for name, text in DEFINITIONS.items():
        definitions |= get_types_from_msg(text, f"micro_ros_msgs/msg/{name}")
    store.register(definitions)
    return store


NAMES = st.text(st.characters(codec="utf-8", exclude_characters="\0"), max_size=20)
ENTITIES = st.builds(Entity, st.integers(0, 3), NAMES, st.lists(NAMES, max_size=3).map(tuple))
GRAPHS = st.lists(
    st.builds(GraphNode, NAMES, NAMES, st.lists(ENTITIES, max_size=4).map(tuple)), max_size=5
)


@given(GRAPHS)
def test_rosbags_reads_and_writes_the_same(oracle, nodes):
    message = ros_graph.encode(nodes)
    read = oracle.deserialize_cdr(b"\0\1\0\0" + message, "micro_ros_msgs/msg/Graph")
    assert [
        GraphNode(
            node.node_namespace,
            node.node_name,
            tuple(
                Entity(entity.entity_type, entity.name, tuple(entity.types))
                for entity in node.entities
            ),
        )
        for node in read.nodes
    ] == nodes
    written = bytes(oracle.serialize_cdr(read, "micro_ros_msgs/msg/Graph"))
    # rosbags pads the end of a sample; the padding is no part of the message.
    assert written[4:].rstrip(b"\0") == message.rstrip(b"\0")
    assert len(written) - 4 - len(message) in (0, 1, 2, 3)


def test_the_constants_are_those_of_the_definition(oracle):
    entity = oracle.types["micro_ros_msgs/msg/Entity"]
    assert (PUBLISHER, SUBSCRIPTION, SERVICE_SERVER, SERVICE_CLIENT) == (
        entity.PUBLISHER, entity.SUBSCRIBER, entity.SERVICE_SERVER, entity.SERVICE_CLIENT,
    )  # fmt: skip
    assert np.int8(SERVICE_CLIENT) == 3


# --- from what is discovered --------------------------------------------------------------


class Network:
    """Holds the nodes that a middleware would have discovered."""

    def __init__(self):
        self.participants, self.endpoints, self.announced = {}, {}, {}
        self.on_change = None
        self.open = 0

    def node(self, namespace, name, *ends, alive=True):
        """Add a node in a participant of its own; each of ``ends``: "w" or "r", topic, type."""
        guid = bytes([len(self.announced) + 1]) * 16
        if alive:
            self.participants[guid] = b"enclave=/;"
        node = SimpleNamespace(namespace=namespace, name=name, readers=[], writers=[])
        for kind, *about in ends:
            gid = len(self.endpoints).to_bytes(16, "big")
            (node.writers if kind == "w" else node.readers).append(gid)
            self.endpoints[gid] = SimpleNamespace(topic=about[0], type_name=about[1])
        self.announced[guid] = [node]
        return guid

    # as the middleware's graph()

    def watch(self, domain, on_change):
        self.domain, self.on_change = domain, on_change
        self.open += 1
        return self

    def close(self):
        self.open -= 1


STRING = "std_msgs::msg::dds_::String_"
SET = "std_srvs::srv::dds_::SetBool_"


def test_topics_and_services_by_their_ros_names():
    network = Network()
    network.node(
        "/ns", "n",
        ("w", "rt/out", STRING), ("w", "rt/out", "pkg::msg::dds_::Other_"), ("w", "rt/out", STRING),
        ("r", "rt/in", STRING),
        ("r", "rq/ns/serveRequest", SET + "Request_"), ("w", "rr/ns/serveReply", SET + "Response_"),
        ("w", "rq/callRequest", SET + "Request_"), ("r", "rr/callReply", SET + "Response_"),
        ("w", "ros_discovery_info", "x"), ("r", "plain", "y"),
    )  # fmt: skip
    (node,) = ros_graph.ros_nodes(network)
    assert (node.namespace, node.name) == ("/ns", "n")
    assert node.entities == (
        Entity(PUBLISHER, "/out", ("pkg/msg/Other", "std_msgs/msg/String")),
        Entity(SUBSCRIPTION, "/in", ("std_msgs/msg/String",)),
        Entity(SERVICE_SERVER, "/ns/serve", ("std_srvs/srv/SetBool",)),
        Entity(SERVICE_CLIENT, "/call", ("std_srvs/srv/SetBool",)),
    )


def test_the_graph_lists_only_existing_entities_in_order():
    network = Network()
    network.node("/", "z", ("w", "rt/out", STRING))
    network.node("/", "a")
    network.node("/", "dead", alive=False)
    network.endpoints.clear()
    assert ros_graph.ros_nodes(network) == [GraphNode("/", "a", ()), GraphNode("/", "z", ())]


def test_endpoints_of_another_participant_belong_to_the_node_that_lists_them():
    """With auto a board's services are endpoints of a participant that has no node."""
    network = Network()
    serve = ("r", "rq/serveRequest", SET + "Request_"), ("w", "rr/serveReply", SET + "Response_")
    board = network.announced[network.node("/ns", "gate", ("w", "rt/out", STRING))][0]
    services = network.node("/ns", "services", *serve)
    (listed,) = network.announced[services]
    board.readers, board.writers = listed.readers, board.writers + listed.writers
    network.announced[services] = []
    (node,) = ros_graph.ros_nodes(network)
    assert [end.name for end in node.entities] == ["/out", "/serve"]


def test_names_that_a_c_client_cannot_read_are_left_out():
    """C clients read names and types into 256 octets; a longer one spoils the whole graph."""
    network = Network()
    longest = "/" + "x" * 254
    network.node("/", "fits", ("w", "rt" + longest, STRING), ("w", "rt" + longest + "x", STRING),
                 ("r", "rt/y", "x" * 256))  # fmt: skip
    network.node("/", "n" * 256)
    assert ros_graph.ros_nodes(network) == [
        GraphNode("/", "fits", (Entity(PUBLISHER, longest, ("std_msgs/msg/String",)),))
    ]


# --- where room is short --------------------------------------------------------------------

FULL = [
    GraphNode(
        "/", name,
        (
            Entity(PUBLISHER, "/parameter_events", ("rcl_interfaces/msg/ParameterEvent",)),
            Entity(PUBLISHER, "/rosout", ("rcl_interfaces/msg/Log",)),
            Entity(PUBLISHER, "/scan", ("sensor_msgs/msg/LaserScan",)),
            Entity(SERVICE_SERVER, f"/{name}/get", ("rcl_interfaces/srv/GetParameters",)),
            Entity(SERVICE_SERVER, "/reset", ("std_srvs/srv/Empty",)),
        ),
    )
    for name in ("one", "two", "three")
]  # fmt: skip


def what_is_in(message, oracle):
    read = oracle.deserialize_cdr(b"\0\1\0\0" + message, "micro_ros_msgs/msg/Graph")
    return [(node.node_name, [entity.name for entity in node.entities]) for node in read.nodes]


def test_the_least_important_entities_are_cut_first(oracle):
    versions = []
    for room in range(len(ros_graph.encode(FULL)), 3, -1):
        message, left_out = ros_graph.cut(FULL, room)
        assert len(message) <= room
        if not versions or versions[-1][0] != left_out:
            versions.append((left_out, what_is_in(message, oracle)))
    assert versions[0][0] == ""
    names = ["one", "two", "three"]
    names_left = [
        ["/parameter_events", "/rosout", "/scan", "/reset"],
        ["/scan", "/reset"],
        ["/scan"],
        [],
    ]
    assert [item[1] for item in versions[1:5]] == [
        [(name, some) for name in names] for some in names_left
    ]
    assert [[name for name, _ in item[1]] for item in versions[5:]] == [["one", "two"], ["one"], []]
    assert versions[5][0] == "all topics and services and 1 of 3 nodes"


@given(GRAPHS, st.integers(4, 2000))
def test_a_message_never_exceeds_its_room(nodes, room):
    message, left_out = ros_graph.cut(nodes, room)
    assert len(message) <= room
    assert bool(left_out) == (len(ros_graph.encode(nodes)) > room)


@pytest.mark.parametrize("mtu", [64, 128, 512, 1500, 65507])
@pytest.mark.parametrize("session_id", [0x81, 0x01], ids=["keyless", "key"])
def test_the_room_is_four_messages(mtu, session_id):
    desk = Desk()
    board = Board(desk, mtu=mtu, session_id=session_id)
    session = desk.agent.clients[board.key].session
    payload = bytes(4 + ros_graph.room_for(mtu))
    session.send(ids.DATA, 1, ids.STREAM_RELIABLE, payload, desk.clock)
    sent = desk.agent.clients[board.key].session.outgoing
    assert len(sent) == ros_graph.MESSAGES and max(map(len, sent)) <= mtu
    desk.close()


# --- boards that ask ------------------------------------------------------------------------


@pytest.fixture
def network():
    return Network()


@pytest.fixture
def desk(network):
    desk = Desk()
    desk.middleware.graph = network.watch
    yield desk
    assert network.open == 0 or desk.agent.clients
    desk.close()
    assert network.open == 0
    assert "internal error" not in desk.log()


def asking(domain=0, **more):
    """Return what a micro-ROS board with RMW_UXRCE_GRAPH creates, in binary."""
    return [
        participant(name="microros_graph", domain=domain),
        topic(name=ros_graph.TOPIC, type_name=ros_graph.TYPE),
        group(SUBSCRIBER),
        endpoint(READER, parent=SUBSCRIBER, qos=RELIABLE_10 | ids.QOS_TRANSIENT_LOCAL, **more),
    ]


def ask(board, *submessages):
    assert set(board.ask(*(submessages or asking()))) == {ids.STATUS_OK}
    board.send(read_data(READER))
    return board


def test_a_board_that_reads_the_graph_receives_it_and_its_changes(desk, network):
    board = ask(Board(desk), *asking(domain=7))
    assert network.domain == 7 and network.open == 1
    assert board.samples() == []  # nothing is discovered yet
    network.node("/garden", "weather", ("w", "rt/garden/t", STRING))
    network.on_change()
    board.settle()
    first = [GraphNode("/garden", "weather", (Entity(0, "/garden/t", ("std_msgs/msg/String",)),))]
    assert board.samples() == [ros_graph.encode(first)]
    network.on_change()  # a change that does not concern boards
    board.settle()
    assert board.samples() == []
    leaving_node = network.node("/", "other")
    network.on_change()
    board.settle()
    assert board.samples() == [ros_graph.encode([GraphNode("/", "other", ()), *first])]
    del network.participants[leaving_node]
    network.on_change()
    board.settle()
    assert board.samples() == [ros_graph.encode(first)]
    assert "graph started" in desk.log() and "domain_id: 7" in desk.log()


def test_as_micro_ros_asks_in_xml(desk, network):
    """Participant in binary, the others in XML, the subscriber's empty: rmw_graph.c."""
    network.node("/", "n")
    about = f"<name>{ros_graph.TOPIC}</name><dataType>{ros_graph.TYPE}</dataType>"
    reader = (
        "<dds><data_reader>"
        "<historyMemoryPolicy>PREALLOCATED_WITH_REALLOC</historyMemoryPolicy>"
        "<qos><reliability><kind>RELIABLE</kind></reliability></qos>"
        f"<topic><kind>NO_KEY</kind>{about}"
        "<historyQos><kind>KEEP_ALL</kind></historyQos></topic>"
        "</data_reader></dds>"
    )
    board = ask(
        Board(desk),
        participant(name="microros_graph"),
        create(SUBSCRIBER, ids.AS_XML, "", PARTICIPANT),
        create(TOPIC, ids.AS_XML, f"<dds><topic>{about}</topic></dds>", PARTICIPANT),
        create(READER, ids.AS_XML, reader, SUBSCRIBER),
    )
    assert board.samples() == [ros_graph.encode([GraphNode("/", "n", ())])]


def test_a_board_that_was_reset_receives_the_graph_again(desk, network):
    network.node("/", "n")
    board = ask(Board(desk))
    assert len(board.samples()) == 1
    reset = Board(desk)  # the same key: its objects stay at the agent
    flags = ids.FLAG_REUSE | ids.FLAG_REPLACE
    assert reset.ask(*asking(flags=flags)[3:]) == [ids.STATUS_OK_MATCHED]
    reset.send(read_data(READER))
    assert len(reset.samples()) == 1
    reset.settle()
    assert reset.samples() == []


def test_a_domain_is_watched_once_while_any_board_reads_its_graph(desk, network):
    network.node("/", "n")
    boards = [ask(Board(desk, peer, key=peer)) for peer in (1, 2, 3)]
    assert network.open == 1
    assert [len(board.samples()) for board in boards] == [1, 1, 1]
    boards[0].send(delete(READER))
    boards[1].send(delete(PARTICIPANT))
    assert network.open == 1
    network.node("/", "late")
    network.on_change()
    boards[2].settle()
    assert [len(board.samples()) for board in boards] == [0, 0, 1]
    desk.agent.delete_client(3)
    assert network.open == 0
    assert desk.log().count("graph stopped") == 1
    ask(Board(desk, 4, key=4))
    assert network.open == 1


def test_the_graph_is_cut_to_what_the_client_can_take(desk, network, oracle):
    for number in range(20):
        network.node("/", f"node{number:02}", ("w", f"rt/topic{number}", STRING),
                     ("r", f"rq/node{number}/get_parametersRequest",
                      "rcl_interfaces::srv::dds_::GetParameters_Request_"))  # fmt: skip
    small = ask(Board(desk, 1, key=1, mtu=512))
    tiny = ask(Board(desk, 2, key=2, mtu=96))
    large = ask(Board(desk, 3, key=3, mtu=4096))
    (whole,), (cut,), (few,) = large.samples(), small.samples(), tiny.samples()
    assert whole == ros_graph.encode(ros_graph.ros_nodes(network))
    assert what_is_in(cut, oracle) == [(f"node{n:02}", [f"/topic{n}"]) for n in range(20)]
    assert 0 < len(what_is_in(few, oracle)) < 20
    assert len(cut) <= ros_graph.room_for(512) and len(few) <= ros_graph.room_for(96)
    lines = [line for line in desk.log().splitlines() if "graph is cut" in line]
    assert len(lines) == 2 and "client_key: 0x00000001" in lines[0]
    assert "left out" in lines[0] and "the services of parameters" in lines[0]
    network.participants.clear()
    network.on_change()
    small.settle()
    assert small.samples() == [bytes(4)]
    assert "graph is whole" in desk.log()


def test_cached_graphs_are_bounded_however_many_mtus_there_are(desk, network):
    network.node("/", "node", ("w", "rt/topic", STRING))
    ask(Board(desk, 1, key=1))
    for mtu in range(100, 200):
        ask(Board(desk, 2, key=2, session_id=0x81 + mtu % 2, mtu=mtu))
    assert len(desk.agent.graphs._domains[0]._messages) <= ros_graph._MAX_CACHED


def test_other_topics_and_types_have_ordinary_readers(desk, network):
    board = Board(desk)
    assert set(
        board.ask(
            participant(),
            topic(name=ros_graph.TOPIC, type_name=STRING),
            group(SUBSCRIBER),
            endpoint(READER, parent=SUBSCRIBER),
        )
    ) == {ids.STATUS_OK}
    assert network.open == 0
    assert (0, ros_graph.TOPIC) in desk.middleware.bus.readers


def test_a_middleware_without_a_graph_is_logged_and_the_reader_waits():
    desk = Desk()
    board = ask(Board(desk))
    assert board.samples() == []
    assert "no graph" in desk.log() and "middleware: memory" in desk.log()
    assert (0, ros_graph.TOPIC) in desk.middleware.bus.readers
    desk.close()


def test_a_domain_that_cannot_be_watched_refuses_the_reader(desk):
    def refuse(domain, on_change):
        raise MiddlewareError("no more readers")

    desk.middleware.graph = refuse
    board = Board(desk)
    assert board.ask(*asking())[-1] == ids.STATUS_ERR_DDS_ERROR
    assert "no more readers" in desk.log()
