"""``uros action``, and what ``uros service`` prints of introspection, with a real rclpy node."""

import io
import re
import signal
import sys
import threading
from pathlib import Path

import pytest
from interop.test_host_tools import SECONDS, child
from support.middleware import host_node
from support.peer import RosPeer

from uros.client.action_server import ActionServer
from uros.interfaces import known_hash, load
from uros.tools import cli
from uros.tools.action import send_goal
from uros.tools.action.goal import Goal
from uros.tools.service import call as service_call

pytestmark = pytest.mark.timeout(120)

FIBONACCI = "test_msgs/action/Fibonacci"
SET_BOOL = "std_srvs/srv/SetBool"
ACTION = "/real/fibonacci"
# Orders that action_peer.py treats specially. The last two go on until they are canceled, which the
# first of these refuses.
ABORTED, STUBBORN, ENDLESS = 3, 100013, 100000
ACCEPTED = re.compile(r"Goal accepted with ID: [0-9a-f]{32}\n")


@pytest.fixture(scope="module")
def peer(ros_python, domain):
    with RosPeer(ros_python, domain, Path(__file__).parent / "verbs_peer.py") as running:
        running.do("act", name=ACTION, introspected=True)
        running.do("serve_bool", name="/real/light")
        yield running


@pytest.fixture
def uros(domain, capfd, monkeypatch):
    """Run a command in this process; return standard output, or standard error if it fails."""

    def run(*arguments, status=0, stdin=""):
        monkeypatch.setattr(sys, "stdin", io.TextIOWrapper(io.BytesIO(stdin.encode())))
        capfd.readouterr()
        returned = cli.main([*arguments, "--domain", str(domain)])
        printed = capfd.readouterr()
        assert returned == status, printed
        return printed.out if status == 0 else printed.err

    return run


@pytest.fixture
def started(domain):
    return lambda *arguments: child(sys.executable, *arguments, "--domain", str(domain))


def lines_until(process, wanted):
    """Read lines until one that has the text, and return them."""
    lines = []
    while not lines or wanted not in lines[-1]:
        lines.append(process.stdout.readline())
        assert lines[-1], process.stderr.read()
    return lines


def interrupt(process, status):
    process.send_signal(signal.SIGINT)
    rest = process.stdout.read()
    assert process.wait(SECONDS) == status, process.stderr.read()
    return rest


# --- the graph ------------------------------------------------------------------------------


def test_list_info_type_and_find(uros, peer):
    assert uros("action", "list") == f"{ACTION}\n"
    assert uros("action", "list", "-t") == f"{ACTION} [{FIBONACCI}]\n"
    assert uros("action", "list", "-c") == "1\n"
    head = f"Action: {ACTION}\nAction clients: 0\nAction servers: 1\n"
    assert uros("action", "info", ACTION, "-c") == head
    assert uros("action", "info", ACTION) == f"{head}    /real/peer\n"
    assert uros("action", "info", "real/fibonacci", "-t") == f"{head}    /real/peer [{FIBONACCI}]\n"
    assert uros("action", "type", ACTION) == f"{FIBONACCI}\n"
    assert uros("action", "find", "test_msgs/Fibonacci") == f"{ACTION}\n"
    assert uros("action", "find", FIBONACCI, "-c") == "1\n"


def test_an_unknown_action(uros, peer, domain, monkeypatch):
    said = f"there is no action '/real/fibonaci' in domain {domain}; did you mean '{ACTION}'?\n"
    assert uros("action", "type", "/real/fibonaci", status=1) == f"uros: {said}"
    assert uros("action", "echo", "/real/fibonaci", status=1) == f"uros: {said}"
    wait = send_goal.wait_for_server
    monkeypatch.setattr(
        send_goal, "wait_for_server", lambda net, *more: net.settle() or wait(net, *more)
    )
    goal = ("action", "send_goal", "/real/fibonaci", FIBONACCI, "-t", "0.3")
    assert f"did you mean '{ACTION}'" in uros(*goal, status=1)
    empty = "Action: /real/fibonaci\nAction clients: 0\nAction servers: 0\n"
    assert uros("action", "info", "/real/fibonaci") == empty


# --- send_goal ------------------------------------------------------------------------------


def sequence(*numbers):
    return "sequence:\n" + "".join(f"- {number}\n" for number in numbers)


def test_a_goal_with_feedback(uros, peer):
    """TYPE and the goal's values may be left out, and be on standard input, as ros2 takes them."""
    printed = uros("action", "send_goal", ACTION, FIBONACCI, "{order: 4}", "--feedback")
    assert ACCEPTED.sub("ID\n", printed) == (
        "Waiting for an action server to become available...\n"
        "Sending goal:\n     order: 4\n\n"
        "ID\n\n"
        f"Feedback:\n    {sequence(0, 1, 1)}\n"
        f"Feedback:\n    {sequence(0, 1, 1, 2)}\n"
        f"Feedback:\n    {sequence(0, 1, 1, 2, 3)}\n"
        f"Result:\n    {sequence(0, 1, 1, 2, 3)}\n"
        "Goal finished with status: SUCCEEDED\n"
    )
    printed = uros("action", "send_goal", ACTION, "--stdin", stdin="order: 2")
    assert "Feedback" not in printed and "status: SUCCEEDED" in printed


def test_goals_that_are_rejected_or_aborted(uros, peer):
    printed = uros("action", "send_goal", ACTION, FIBONACCI, "order: -1")
    assert printed.endswith("Sending goal:\n     order: -1\n\nGoal was rejected.\n")
    printed = uros("action", "send_goal", ACTION, FIBONACCI, f"order: {ABORTED}")
    assert printed.endswith(
        f"Result:\n    {sequence(0, 1, 1, 2)}\nGoal finished with status: ABORTED\n"
    )


def test_a_goal_of_another_type(uros, peer):
    error = uros("action", "send_goal", ACTION, "example_interfaces/action/Fibonacci", status=1)
    assert error == f"uros: {ACTION} is {FIBONACCI}, not example_interfaces/action/Fibonacci\n"


def test_ctrl_c_cancels_the_goal(started, peer):
    with started("action", "send_goal", ACTION, FIBONACCI, f"order: {ENDLESS}", "-f") as process:
        lines_until(process, "Feedback")
        rest = interrupt(process, 130)
    assert "Canceling goal...\n" in rest and "Goal canceled.\nResult:\n    sequence:\n" in rest
    assert rest.endswith("Goal finished with status: CANCELED\n")


def test_a_goal_that_its_server_does_not_cancel(started, peer):
    with started("action", "send_goal", ACTION, FIBONACCI, f"order: {STUBBORN}") as process:
        lines_until(process, "Goal accepted")
        assert interrupt(process, 1).endswith("Canceling goal...\n")
        assert process.stderr.read() == (
            "uros: the goal is not canceled: the server refuses, and the goal goes on\n"
        )


@pytest.fixture
def patient(monkeypatch):
    """Make ``--timeout`` count only after discovery, which may be slow."""
    find, wait, match = service_call.find_servers, send_goal.wait_for_server, Goal.match
    monkeypatch.setattr(service_call, "find_servers", lambda net, name, _: find(net, name, None))
    monkeypatch.setattr(send_goal, "wait_for_server", lambda net, name, _: wait(net, name, None))
    monkeypatch.setattr(Goal, "match", lambda goal, _: match(goal, None))


def test_timeouts(uros, patient, peer, monkeypatch):
    """A goal that is late goes on; ``-t 0`` leaves once it is accepted."""
    assert "Goal accepted" in uros("action", "send_goal", ACTION, FIBONACCI, "order: 2", "-t", "0")
    accepted = Goal.is_accepted
    monkeypatch.setattr(Goal, "is_accepted", lambda goal, _: accepted(goal, None))
    late = ("action", "send_goal", ACTION, FIBONACCI, f"order: {STUBBORN}", "-t", "0.2")
    assert uros(*late, status=1) == (
        f"uros: within 0.2 s {ACTION} has not ended the goal, which goes on\n"
    )


def test_a_server_that_leaves_ends_the_wait(started, peer):
    peer.do("act", name="/real/gone")
    with started("action", "send_goal", "/real/gone", FIBONACCI, f"order: {ENDLESS}") as process:
        lines_until(process, "Goal accepted")
        peer.do("act_no_more")
        process.stdout.read()
        assert process.wait(SECONDS) == 1
        assert process.stderr.read() == (
            "uros: the server of /real/gone has left the network before the end of the goal\n"
        )


def test_a_server_that_does_not_answer_and_a_second_ctrl_c(uros, started, patient, domain):
    """First nothing is answered, then the goal is accepted, and its cancellation not answered."""
    node = host_node("deaf", domain)
    ActionServer(node, load(FIBONACCI), "/deaf", None)
    error = uros("action", "send_goal", "/deaf", FIBONACCI, "-t", "0.2", status=1)
    assert error == "uros: within 0.2 s /deaf did not answer; is its node busy, or not spinning?\n"
    accepted = threading.Event()

    def spin():
        while not accepted.is_set():
            node.spin_once(0.05)

    thread = threading.Thread(target=spin)
    with started("action", "send_goal", "/deaf", FIBONACCI) as process:
        thread.start()
        try:
            lines_until(process, "Goal accepted")
        finally:
            accepted.set()
            thread.join()
        process.send_signal(signal.SIGINT)
        lines_until(process, "Canceling goal...")
        interrupt(process, 130)
        assert "left before the end of the goal, which may go on" in process.stderr.read()
    node.destroy_node()


# --- introspection --------------------------------------------------------------------------


def events(process, count):
    """Read so many documents."""
    return ["".join(lines_until(process, "---\n")) for _ in range(count)]


EVENT = re.compile(
    r"info:\n  event_type: (\w+)\n  stamp:\n    sec: \d{10}\n    nanosec: \d+\n"
    r"  client_gid:\n(?:  - \d+\n){16}  sequence_number: (\d+)\n(.*)---\n",
    re.DOTALL,
)


def repeated(peer, command, wanted):
    """Repeat a peer's command until ``wanted()`` returns: messages come once all is matched."""
    ended = threading.Event()

    def repeat():
        while not ended.is_set():
            peer.do(**command)

    thread = threading.Thread(target=repeat)
    thread.start()
    try:
        return wanted()
    finally:
        ended.set()
        thread.join()


FLIP = {"verb": "flip", "name": "/real/light"}


def test_service_echo(started, peer):
    """The type may be left out; an event has the request, or the response."""
    with started("service", "echo", "/real/light") as process:
        first, second = repeated(peer, FLIP, lambda: events(process, 2))
        name, number, request = EVENT.fullmatch(first).groups()
        assert (name, request) == ("REQUEST_RECEIVED", "request:\n- data: true\nresponse: []\n")
        name, same, response = EVENT.fullmatch(second).groups()
        assert (name, same) == ("RESPONSE_SENT", number)
        assert response == "request: []\nresponse:\n- success: true\n  message: 'on'\n"
        interrupt(process, 0)
        assert process.stderr.read() == ""


def test_service_echo_with_other_forms(started, peer):
    wanted = ("--csv", "--no-str", "--no-arr")
    with started("service", "echo", "/real/light", SET_BOOL, *wanted) as process:
        line = repeated(peer, FLIP, process.stdout.readline)
        kind = line.partition(",")[0]  # 1: a request was received, 2: a response was sent
        requests, responses = {"1": (1, 0), "2": (0, 1)}[kind]
        assert re.fullmatch(
            r"[12],\d{10},\d+,<array type: uint8\[16\]>,\d+,"
            rf"<sequence type: std_srvs/srv/SetBool_Request\[1\], length: {requests}>,"
            rf"<sequence type: std_srvs/srv/SetBool_Response\[1\], length: {responses}>\n",
            line,
        )
    with started("service", "echo", "/real/peer/get_parameters") as process:
        assert "is the introspection of the client or of the server enabled?" in (
            process.stderr.readline()
        )
        assert interrupt(process, 0) == ""


def test_the_hash_of_an_event_is_that_of_ros2(peer):
    types = {"/real/light/_service_event": f"{SET_BOOL}_Event"}
    if peer.do("act", name="/real/hashed", introspected=True)["introspected"]:
        hidden = "/real/hashed/_action"
        types[f"{hidden}/get_result/_service_event"] = f"{FIBONACCI}_GetResult_Event"
        types[f"{hidden}/cancel_goal/_service_event"] = "action_msgs/srv/CancelGoal_Event"
    for topic, type_name in types.items():
        (info,) = peer.do("topic", topic=topic)["infos"]
        assert (info["type"], info["hash"]) == (type_name, known_hash(type_name))


def test_action_echo(started, peer):
    """Each message names its interface; the services' are those of introspection."""
    if not peer.do("act", name="/real/echoed", introspected=True)["introspected"]:
        pytest.skip("not on this platform: rclpy of Jazzy has no introspection of actions")
    goals = {"verb": "send", "name": "/real/echoed", "goals": {"goal": [2, 0]}}

    def all_interfaces():
        text = ""
        while any(f"interface: {name}\n" not in text for name in ("GOAL_SERVICE", "FEEDBACK_TOPIC",
                                                                  "RESULT_SERVICE")):  # fmt: skip
            text += "".join(lines_until(process, "---\n"))
        return text

    with started("action", "echo", "/real/echoed", "--flow-style") as process:
        text = repeated(peer, goals, all_interfaces)
        assert "interface: STATUS_TOPIC\n" in text
        assert re.search(
            r"request: \[\{goal_id: \{uuid: \[.*\]\}, goal: \{order: [24]\}\}\]\n", text
        )
        assert "feedback:\n  sequence: [0, 1, 1]\n---\n" in text
        interrupt(process, 0)
    only = ("--interfaces", "feedback_topic|CANCEL_SERVICE")
    with started("action", "echo", "/real/echoed", FIBONACCI, *only) as process:
        line = repeated(peer, goals, process.stdout.readline)
        assert line == "interface: FEEDBACK_TOPIC\n"
        interrupt(process, 0)


def test_service_info(uros, peer):
    head = f"Type: {SET_BOOL}\nClients count: 1\n"
    assert uros("service", "info", "/real/light") == f"{head}Services count: 1\n"
    printed = uros("service", "info", "real/light", "-v")
    assert printed.startswith(f"{head}\nNode name: peer\nNode namespace: /real\n")
    client, server = (block for block in printed.split("\n\n") if block.startswith("Node name"))
    hash_ = known_hash(SET_BOOL)
    assert (
        f"Service type: {SET_BOOL}\nService type hash: {hash_}\nEndpoint type: CLIENT\n" in client
    )
    assert "Endpoint type: SERVER\nEndpoint count: 2\nGIDs:\n - Request Reader : 01.0f." in server
    assert " - Response Writer :\n      Reliability: RELIABLE\n" in server
    error = uros("service", "info", "/real/ligth", status=1)
    assert "there is no service '/real/ligth'" in error and "'/real/light'" in error


def test_service_call_with_qos(uros, patient, peer):
    options = ("--qos-depth", "3", "--qos-reliability", "reliable", "--qos-profile", "parameters")
    call = ("service", "call", "/real/light", SET_BOOL, "data: 1")
    assert "success=True" in uros(*call, *options)
    error = uros(*call, "--qos-reliability", "best_effort", "--timeout", "0.5", status=1)
    assert "did not match within 0.5 s: its QoS may not fit" in error
