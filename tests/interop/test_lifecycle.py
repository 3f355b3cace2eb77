"""A lifecycle node on a board, driven by a real rclpy node and compared with one of rclpy."""

import pytest
from support.services_board import board_and_peer
from support.variants import slow_except

pytestmark = pytest.mark.timeout(180)

INT32 = "std_msgs/msg/Int32"


@pytest.fixture(scope="module", params=slow_except(["cpython", "micropython"], "micropython"))
def board(request, ros_python, domain, tmp_path_factory):
    folder = tmp_path_factory.mktemp("lifecycle")
    with board_and_peer(ros_python, folder, request.param, domain) as both:
        yield both


def both_of(board, service, values=None):
    """Call a service of the board and of rclpy's node, which must answer the same; the answer."""
    name, peer = board
    answers = [
        peer.do("lifecycle", node=node, service=service, values=values, seconds=40)["response"]
        for node in (name, "/lens")
    ]
    assert answers[0] == answers[1], (service, values)
    return answers[0]


def state(board):
    return both_of(board, "get_state")["current_state"]["label"]


def change(board, number, label=""):
    return both_of(board, "change_state", [number, label])["success"]


def cannot_refuse(board):
    """Whether rclpy's node fails instead of refusing a transition, as that of Jazzy does."""
    return board[1].distro == "jazzy"


def test_a_board_answers_lifecycle_services_as_an_rclpy_node(board):
    name, peer = board
    peer.do("camera", name="lens")
    assert state(board) == "unconfigured"
    assert len(both_of(board, "get_available_states")["available_states"]) == 11
    assert len(both_of(board, "get_transition_graph")["available_transitions"]) == 25

    def walk(*steps):
        for number, label, success, now in steps:
            if success or not cannot_refuse(board):
                assert change(board, number, label) == success, (number, label)
            assert state(board) == now
            both_of(board, "get_available_transitions")

    walk(
        (3, "", False, "unconfigured"),
        (1, "", True, "inactive"),
        (1, "", False, "inactive"),
        (0, "activate", True, "active"),
        (0, "none", False, "active"),
        (2, "", False, "active"),
        (4, "", True, "inactive"),
        (2, "", True, "unconfigured"),
    )
    # on_configure fails: rclpy's node by its configured outcome, the board by its parameter.
    peer.do("camera", name="lens", configure="FAILURE")
    broken = [("broken", 1, True)]
    peer.do("parameters", node=name, method="set_parameters", parameters=broken)
    walk((1, "", False, "unconfigured"))
    peer.do("camera", name="lens")
    broken = [("broken", 1, False)]
    peer.do("parameters", node=name, method="set_parameters", parameters=broken)
    walk((0, "configure", True, "inactive"))


def test_a_lifecycle_publisher_is_silent_unless_active(board):
    name, peer = board
    topic = name.rpartition("/")[0] + "/numbers"
    assert state(board) == "inactive"
    peer.do("subscribe", topic=topic, type=INT32)
    assert len(peer.do("topic", topic=topic)["infos"]) == 1
    assert change(board, 3)
    peer.message(topic)
    assert change(board, 4)
    peer.do("hear_steps", node=name)  # time for samples that are already on their way
    peer.messages[topic].clear()
    peer.do("steps", count=1, seconds=1.0)
    assert not peer.messages[topic]
    peer.do("unsubscribe", topic=topic)


def test_each_transition_is_published(board):
    name, peer = board
    assert state(board) == "inactive"
    peer.do("steps", count=1, seconds=0.5)
    # Repeat until the two have discovered each other.
    for _ in range(20):
        assert change(board, 2) and change(board, 1)
        steps = peer.do("steps", count=4, seconds=2.0)["steps"]
        if len(steps) == 4:
            break
    transitions = [
        (step["transition"]["label"], step["start_state"]["label"], step["goal_state"]["label"])
        for step in steps
    ]
    assert transitions == [
        ("cleanup", "inactive", "cleaningup"),
        ("transition_success", "cleaningup", "unconfigured"),
        ("configure", "unconfigured", "configuring"),
        ("transition_success", "configuring", "inactive"),
    ]
    assert all(step["timestamp"] > 1_700_000_000 * 10**9 for step in steps)


def test_a_board_that_was_shut_down_stays_finalized(board):
    assert change(board, 0, "shutdown") and state(board) == "finalized"
    assert both_of(board, "get_available_transitions")["available_transitions"] == []
    assert cannot_refuse(board) or not change(board, 1)
