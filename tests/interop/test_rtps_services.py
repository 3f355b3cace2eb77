"""What ROS builds on services, between RTPS in Python and a real rclpy node (rmw_fastrtps).

The process of the agent and that of the tests have no rclpy. A node is that of a board on an agent
by UDP, or one of a host that is on the network itself.
"""

import itertools
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest
from interop import test_actions, test_lifecycle, test_parameters, test_ros2_middleware
from support.nodes import Nodes
from support.peer import RosPeer
from support.services_board import board_and_peer

import uros
from uros.host.direct import Direct
from uros.interfaces import load
from uros.interfaces.codec import from_cdr, to_cdr
from uros.middleware import open_middleware
from uros.transport.udp import UdpTransport

BASIC = "test_msgs/srv/BasicTypes"
Basic = load(BASIC)
Int32 = load("std_msgs/msg/Int32")
Parameter = load("rcl_interfaces/msg/Parameter")
Value = load("rcl_interfaces/msg/ParameterValue")
GetParameters = load("rcl_interfaces/srv/GetParameters")
SetParameters = load("rcl_interfaces/srv/SetParameters")
HERE = Path(__file__).parent
IN_TURN = 200
AT_ONCE = 50
BOOL = 1
MEGABYTE = "octets: " * 131_072

pytestmark = pytest.mark.timeout(180)


@pytest.fixture(scope="module", params=["rtps", "auto"])
def middleware(request):
    return request.param


@pytest.fixture(scope="module")
def agent(domain, middleware):
    """An agent in a process of its own, whose Python has no rclpy."""
    with test_ros2_middleware.running(sys.executable, domain, middleware) as running:
        yield running


@pytest.fixture(scope="module")
def peer(ros_python, domain):
    with RosPeer(ros_python, domain, HERE / "service_peer.py") as running:
        yield running


@pytest.fixture(params=["board", "host"])
def nodes(request, agent, middleware, domain):
    """Creates nodes of boards on the agent, or of this process without an agent."""
    yield from _nodes(request.param, agent, middleware, domain)


@pytest.fixture
def host_nodes(agent, middleware, domain):
    """Creates nodes of this process."""
    yield from _nodes("host", agent, middleware, domain)


def _nodes(kind, agent, middleware, domain):
    keys = itertools.count(0x67000001)

    def make(name, **options):
        if kind == "board":
            options.update(key=next(keys))
            return uros.Node(name, UdpTransport("127.0.0.1", agent.port), **options)
        if middleware == "auto":  # the default of a host's node
            return uros.Node(name, domain_id=domain, **options)
        return uros.Node(name, Direct(open_middleware(middleware), domain), **options)

    made = Nodes(make)
    try:
        yield made
    finally:
        for node in made.made:
            node.destroy_node()


def request(first, second, text=""):
    return Basic.Request(int64_value=first, int32_value=second, string_value=text)


def call(nodes, client, *requests, seconds=15.0):
    """Call a service with all requests at once; return the responses in their order."""
    futures = [client.call_async(one) for one in requests]
    nodes.until(lambda: all(future.done() for future in futures), seconds)
    return [future.result() for future in futures]


def call_until_matched(nodes, client, request):
    """Return the first response.

    A request from before client and server have found each other is lost, as with any ROS client.
    """
    for _ in range(50):
        future = client.call_async(request)
        try:
            nodes.until(future.done, 0.3)
            return future.result()
        except (AssertionError, OSError):
            client.remove_pending_request(future)
    raise AssertionError("the service never answers")


class Adder:
    """A service of ours that answers as that of the peer's do_add."""

    def __init__(self, node, name):
        self.added = []
        self.service = node.create_service(Basic, name, self.add)

    def add(self, request, response):
        self.added.append(request.int64_value)
        response.int64_value = request.int64_value + request.int32_value
        response.string_value = request.string_value
        return response


def ask_peer(nodes, peer, verb, **arguments):
    """Run a command in the peer while the nodes are spun; its answer."""
    with ThreadPoolExecutor(1) as pool:
        answer = pool.submit(peer.do, verb, **arguments)
        nodes.until(answer.done, 60)
    return answer.result()


def responses(nodes, peer, name, requests, **arguments):
    """Have the peer call a service with all requests at once; the responses in their order."""
    octets = [to_cdr(one).hex() for one in requests]
    answer = ask_peer(
        nodes, peer, "call_at_once", name=name, type=BASIC, cdr=octets, **arguments
    )["replies"]  # fmt: skip
    assert answer is not None, "the service is not available"
    return [one and from_cdr(Basic.Response, bytes.fromhex(one)) for one in answer]


# --- a real server --------------------------------------------------------------------


@pytest.fixture(scope="module")
def real_adder(peer):
    """A service of a real node."""
    peer.do("add", name="/real/add", type=BASIC, depth=2 * AT_ONCE)
    return "/real/add"


def client_of(nodes, peer, name):
    """A client that a service of do_add has answered."""
    client = nodes("calling").create_client(Basic, name)
    nodes.connect()
    assert call_until_matched(nodes, client, request(2, 3)).int64_value == 5
    peer.do("added", name=name)
    return client


def test_a_real_server_answers_200_calls_in_turn(nodes, peer, real_adder):
    client = client_of(nodes, peer, real_adder)
    for number in range(IN_TURN):
        (response,) = call(nodes, client, request(number - 2**62, number))
        assert response.int64_value == 2 * number - 2**62
    added = peer.do("added", name=real_adder)["added"]
    assert added == [number - 2**62 for number in range(IN_TURN)]


def test_a_real_server_answers_50_calls_at_once(nodes, peer, real_adder):
    client = client_of(nodes, peer, real_adder)
    for _ in range(3):
        requests = [request(2**53 + number, 1, f"call {number}") for number in range(AT_ONCE)]
        got = call(nodes, client, *requests)
        assert [one.string_value for one in got] == [one.string_value for one in requests]
        assert [one.int64_value for one in got] == [one.int64_value + 1 for one in requests]
        added = peer.do("added", name=real_adder)["added"]
        assert sorted(added) == [one.int64_value for one in requests]


def test_a_real_server_answers_a_megabyte(host_nodes, peer, real_adder):
    client = client_of(host_nodes, peer, real_adder)
    (response,) = call(host_nodes, client, request(2**62, -1, MEGABYTE))
    assert response.int64_value == 2**62 - 1 and response.string_value == MEGABYTE


def test_a_board_reads_and_sets_the_parameters_of_a_real_node(nodes, peer):
    node = nodes("asking")
    getter = node.create_client(GetParameters, "/real/peer/get_parameters")
    setter = node.create_client(SetParameters, "/real/peer/set_parameters")
    nodes.connect()
    asked = GetParameters.Request(names=["use_sim_time"])

    def value():
        (found,) = call_until_matched(nodes, getter, asked).values
        return found.type, found.bool_value

    def set_to(wanted):
        parameter = Parameter(name="use_sim_time", value=Value(type=BOOL, bool_value=wanted))
        answer = call_until_matched(nodes, setter, SetParameters.Request(parameters=[parameter]))
        return answer.results[0].successful

    assert value() == (BOOL, False)
    assert set_to(True)
    assert value() == (BOOL, True)
    assert set_to(False)


# --- a real client --------------------------------------------------------------------


@pytest.fixture
def name(request):
    """A service's name that no other test uses."""
    return "/" + "".join(c if c.isalnum() else "_" for c in request.node.name).strip("_")


def adder_of(nodes, peer, name):
    """A service of ours that a real client has called."""
    adder = Adder(nodes("adding"), name)
    nodes.connect()
    asked = ask_peer(
        nodes, peer, "call", name=name, type=BASIC, cdr=to_cdr(request(2, 3)).hex()
    )["replies"]  # fmt: skip
    assert from_cdr(Basic.Response, bytes.fromhex(asked[0])).int64_value == 5
    adder.added.clear()
    return adder


def test_a_real_client_makes_200_calls_in_turn(nodes, peer, name):
    adder = adder_of(nodes, peer, name)
    cdr = to_cdr(request(-(2**62), 7)).hex()
    answer = ask_peer(nodes, peer, "call", name=name, type=BASIC, cdr=cdr, times=IN_TURN)
    sums = [from_cdr(Basic.Response, bytes.fromhex(one)).int64_value for one in answer["replies"]]
    assert sums == [7 - 2**62] * IN_TURN and adder.added == [-(2**62)] * IN_TURN


def test_a_real_client_makes_50_calls_at_once(nodes, peer, name):
    adder = adder_of(nodes, peer, name)
    for _ in range(3):
        requests = [request(2**53 + number, 1, f"call {number}") for number in range(AT_ONCE)]
        # With the default depth of 10, rmw_fastrtps drops replies that come faster than they are
        # taken.
        got = responses(nodes, peer, name, requests, depth=2 * AT_ONCE)
        assert [one and one.string_value for one in got] == [one.string_value for one in requests]
        assert [one.int64_value for one in got] == [one.int64_value + 1 for one in requests]
        assert sorted(adder.added) == [one.int64_value for one in requests]
        adder.added.clear()


def test_a_real_client_asks_with_a_megabyte(host_nodes, peer, name):
    adder_of(host_nodes, peer, name)
    (response,) = responses(host_nodes, peer, name, [request(1, 2, MEGABYTE)])
    assert response.int64_value == 3 and response.string_value == MEGABYTE


# --- the graph ------------------------------------------------------------------------


def test_topics_and_services_are_of_one_node(nodes, peer, name):
    """rclpy finds them under one node, which it lists once until the node leaves."""
    node = nodes("gate", namespace=name)
    node.create_publisher(Int32, "state")
    node.create_subscription(Int32, "wanted", print)
    node.create_service(Basic, "open", lambda request, response: response)
    node.create_client(Basic, "ring")
    nodes.connect()
    answer = ask_peer(
        nodes, peer, "services", namespace=name, name="gate",
        services={f"{name}/open": [BASIC]}, clients={f"{name}/ring": [BASIC]},
    )  # fmt: skip
    assert answer["found"] == [{f"{name}/open": [BASIC]}, {f"{name}/ring": [BASIC]}], answer
    topics = {f"{name}/state": Int32._TYPE}
    answer = ask_peer(nodes, peer, "node", namespace=name, name="gate", publishers=topics)
    assert answer["publishers"] == {topic: [type] for topic, type in topics.items()}
    others = {one for one in answer["full_names"] if not one.startswith("/real/")}
    assert others == {f"{name}/gate"} and answer["names"].count("gate") == 1
    node.destroy_node()
    nodes.made.remove(node)
    gone = peer.do("gone", namespace=name, name="gate")
    assert gone["gone"] and not [one for one in gone["full_names"] if name in one]
    for service in ("open", "ring"):
        assert peer.do("no_service", name=f"{name}/{service}")["unused"], service


# --- programs of boards that are tested elsewhere with other middlewares ------------------


@pytest.fixture(scope="module")
def camera(ros_python, domain, tmp_path_factory):
    """A board with parameters and a life cycle: its node's name and the peer."""
    folder = tmp_path_factory.mktemp("camera")
    with board_and_peer(ros_python, folder, "cpython", domain, "rtps") as board:
        yield board


@pytest.mark.parametrize(
    "test",
    [
        test_parameters.test_every_type_is_read_and_set,
        test_parameters.test_lists_by_prefix_and_depth,
        test_parameters.test_descriptions,
        test_parameters.test_parameters_are_set_atomically,
        test_parameters.test_deleting_parameters,
    ],
    ids=lambda test: test.__name__.removeprefix("test_"),
)
def test_parameters_with_a_real_client(camera, test):
    test(test_parameters.Board(*camera))


@pytest.mark.parametrize(
    "test",
    [
        test_lifecycle.test_a_board_answers_lifecycle_services_as_an_rclpy_node,
        test_lifecycle.test_a_lifecycle_publisher_is_silent_unless_active,
        test_lifecycle.test_each_transition_is_published,
        test_lifecycle.test_a_board_that_was_shut_down_stays_finalized,
    ],
    ids=lambda test: test.__name__.removeprefix("test_"),
)
def test_lifecycle_with_a_real_client(camera, test):
    test(camera)


@pytest.fixture(scope="module")
def action_peer(ros_python, domain):
    with RosPeer(ros_python, domain, HERE / "action_peer.py") as running:
        yield running


@pytest.fixture(scope="module")
def action_board(tmp_path_factory, domain):
    folder = tmp_path_factory.mktemp("actions")
    board = test_actions.ActionBoard("cpython", folder, domain, "rtps")
    with board.running:
        board.start_agent()
        try:
            yield board
        finally:
            board.end_agent()


@pytest.mark.parametrize(
    "test",
    [
        test_actions.test_a_real_client_uses_a_boards_action,
        test_actions.test_a_late_subscriber_gets_the_last_goal_states,
        test_actions.test_goals_are_canceled_by_time_and_all_at_once,
    ],
    ids=lambda test: test.__name__.removeprefix("test_"),
)
def test_a_boards_action_with_a_real_client(action_board, action_peer, test):
    test(action_board, action_peer)


def test_a_real_nodes_action_with_a_boards_client(action_board, action_peer):
    remote = test_actions.remote_of(action_board, action_peer)
    test_actions.test_a_board_uses_a_real_nodes_action(remote)
    action_peer.do("stop")
