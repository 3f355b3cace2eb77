"""Services of boards on auto (or rtps) and ros2, with rclpy nodes in processes of their own.

With auto and rtps the agent's Python has no rclpy. With ros2 the agent runs under the interpreter
that has it, and so do the tests of the middleware itself: the contract suite and
``rclpy_middleware.py``.
"""

import os
import re
import signal
import subprocess
import sys
import threading
import time
from contextlib import contextmanager
from pathlib import Path

import pytest
from conftest import ROOT, leased_domain
from support.client import XrceClient
from support.lines import UdpLine
from support.middleware import WITH_SERVICES
from support.peer import RosPeer
from support.signals import default_signals

from uros.agent.objects import ros_graph
from uros.wire import ids

HERE = Path(__file__).parent
TRIGGER = "std_srvs/srv/Trigger"
TRIGGER_TYPES = "std_srvs::srv::dds_::Trigger_Request_", "std_srvs::srv::dds_::Trigger_Response_"
CALLS = 200
SECONDS = 20.0

pytestmark = pytest.mark.timeout(180)


def environment():
    return dict(os.environ, PYTHONPATH=str(ROOT / "src"))


# --- tests that run inside the interpreter that has rclpy ----------------------------


@pytest.mark.parametrize(
    ("tests", "least"),
    [
        pytest.param(["tests/contract/test_middleware.py", "-k", "ros2"], 40, id="contract"),
        pytest.param(["tests/interop/rclpy_middleware.py"], 22, id="rclpy", marks=pytest.mark.slow),
    ],
)
def test_the_middlewares_on_rclpy(ros_python, tests, least):
    """At least ``least`` tests pass and none is skipped: a run that collects none is a failure."""
    command = [ros_python, "-m", "pytest", "-q", "-p", "no:cacheprovider"]
    # rosidl's parser, which rclpy's actions load, imports modules that Python 3.11 deprecates.
    command += ["-W", "ignore:module 'sre_:DeprecationWarning", *tests]
    done = subprocess.run(
        command, cwd=ROOT, env=environment(), text=True, timeout=170,
        stdout=subprocess.PIPE, stderr=subprocess.STDOUT,
    )  # fmt: skip
    assert done.returncode == 0, done.stdout[-6000:]
    passed = re.search(r"(\d+) passed", done.stdout)
    assert passed is not None and int(passed[1]) >= least, done.stdout[-2000:]
    assert "skipped" not in done.stdout, done.stdout[-2000:]


# --- boards and real nodes -----------------------------------------------------------


class Agent:
    """``uros agent`` as a process. ``log`` has the lines of its log."""

    def __init__(
        self, python, domain, middleware=WITH_SERVICES, how="--stop-at-eof", more=(), **variables
    ):
        self.middleware = middleware
        command = [python, "-m", "uros", "agent", "udp4", "-p", "0", "-m", middleware]
        with default_signals():
            self._process = subprocess.Popen(
                [*map(str, command), "--domain", str(domain), how, *more],
                stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True,
                env=dict(environment(), **variables),
            )  # fmt: skip
        self.log = []
        self._news = threading.Condition()
        self._thread = threading.Thread(target=self._read, daemon=True)
        self._thread.start()
        self._position = 0  # in the log, behind the last line that line() returned
        self._lines = []
        self.port = int(self.line("running...").split()[-1])

    def _read(self):
        for line in self._process.stdout:
            with self._news:
                self.log.append(line)
                self._news.notify_all()

    def line(self, part):
        """Wait for the next line of the log with this text, and return it."""
        with self._news:
            assert self._news.wait_for(lambda: self._find(part), SECONDS), (part, self.log)
            line = self._find(part)
            self._position = self.log.index(line, self._position) + 1
            return line

    def _find(self, part):
        return next((line for line in self.log[self._position :] if part in line), None)

    def board(self, key):
        """Return a client with a session."""
        self._lines.append(UdpLine(self.port))
        client = XrceClient(self._lines[-1], key=key)
        assert client.open() == ids.STATUS_OK
        return client

    def signal(self, number):
        self._process.send_signal(number)

    def close(self):
        self._process.stdin.close()
        try:
            assert self._process.wait(SECONDS) == 0, self.log
        finally:
            self._process.kill()
            self._thread.join()
            self._process.stdout.close()
            for line in self._lines:
                line.close()
        assert "internal error" not in "".join(self.log), self.log


@contextmanager
def running(python, domain, middleware=WITH_SERVICES, **options):
    agent = Agent(python, domain, middleware, **options)
    try:
        yield agent
    finally:
        agent.close()


@pytest.fixture(scope="module")
def ros2_agent(ros_python, domain):
    with running(ros_python, domain, "ros2") as agent:
        yield agent


@pytest.fixture(scope="module")
def agent_without_rclpy(domain):
    with running(sys.executable, domain) as agent:
        yield agent


@pytest.fixture(scope="module", params=[WITH_SERVICES, "ros2"])
def agent(request):
    name = "ros2_agent" if request.param == "ros2" else "agent_without_rclpy"
    return request.getfixturevalue(name)


@pytest.fixture(scope="module")
def peer(ros_python, domain):
    with RosPeer(ros_python, domain, HERE / "service_peer.py") as running:
        yield running


def reply(text, success=True):
    """Encode a Trigger's reply as a board writes it: without the CDR encapsulation header."""
    raw = text.encode() + b"\0"
    return bytes((success, 0, 0, 0)) + len(raw).to_bytes(4, "little") + raw


def text_of(body):
    """Return the text of a Trigger's reply without encapsulation header."""
    size = int.from_bytes(body[4:8], "little")
    return body[8 : 8 + size - 1].decode()


class BoardServer:
    """A board that answers a Trigger with its node's name and a number, in a thread."""

    def __init__(self, client, node, service):
        self.client = client
        self.node = node
        self.replier = client.service(ids.KIND_REPLIER, node, service, *TRIGGER_TYPES)
        client.read(self.replier)
        self.identities = []
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._serve, daemon=True)
        self._thread.start()

    def _serve(self):
        while not self._stop.is_set():
            if self.client.wait_sample(self.replier, 0.05):
                identity = self.client.sample(self.replier)[:24]
                self.identities.append(identity)
                text = reply(f"{self.node} {len(self.identities)}")
                self.client.write(self.replier, identity + text)

    def close(self):
        self._stop.set()
        self._thread.join()
        self.client.close()


def call(peer, service, times=1):
    answer = peer.do("call", name=service, type=TRIGGER, cdr="0001000000", times=times, seconds=60)
    assert answer["replies"] is not None, "the service is not available"
    return [text_of(bytes.fromhex(cdr)[4:]) for cdr in answer["replies"]]


def test_a_real_node_calls_a_boards_service_many_times(agent, peer):
    server = BoardServer(agent.board(0x61000001), "arm", "/arm/home")
    first = int(call(peer, "/arm/home")[0].split()[1])
    assert call(peer, "/arm/home", CALLS) == [f"arm {first + i + 1}" for i in range(CALLS)]
    assert len(set(server.identities)) == first + CALLS
    server.close()
    assert peer.do("no_service", name="/arm/home")["unused"]


def test_a_board_calls_a_real_nodes_service_many_times(agent, peer):
    name = f"/real/{agent.middleware}/trigger"
    peer.do("serve", name=name, type=TRIGGER)
    client = agent.board(0x61000002)
    requester = client.service(ids.KIND_REQUESTER, "caller", name, *TRIGGER_TYPES)
    client.read(requester)
    number = call_until_matched(client, requester)
    for i in range(CALLS):
        request = client.write(requester, b"\0")
        sample = client.sample(requester)
        assert sample[:4] == request.to_bytes(2, "big") + requester.to_bytes(2, "big")
        assert text_of(sample[4:]) == f"answer {number + i + 1}"
    client.close()


def call_until_matched(client, requester):
    """Send requests until the first is answered; return how many were answered.

    Requests from before requester and server are matched are lost, as with any ROS client.
    """
    for _ in range(100):
        client.write(requester, b"\0")
        if client.wait_sample(requester, 0.2):
            break
    else:
        raise AssertionError("the service never answers")
    answered = text_of(client.sample(requester)[4:])
    while client.wait_sample(requester, 0.3):
        answered = text_of(client.sample(requester)[4:])
    return int(answered.split()[1])


def test_a_service_may_answer_late(agent, peer):
    name = f"/real/{agent.middleware}/slow"
    peer.do("serve", name=name, type=TRIGGER, late=1.5)
    client = agent.board(0x61000003)
    requester = client.service(ids.KIND_REQUESTER, "patient", name, *TRIGGER_TYPES)
    client.read(requester)
    for _ in range(10):
        request = client.write(requester, b"\0")
        if client.wait_sample(requester, 3.0):
            break
    sample = client.sample(requester)
    assert sample[:2] == request.to_bytes(2, "big")
    assert text_of(sample[4:]) == "answer 1"
    client.close()


def test_services_belong_to_the_boards_node_which_is_listed_once(agent, peer, ros_python, domain):
    """Present and later peers see one node with its topics and services until the board leaves."""
    assert peer.do("gone", namespace="/garden", name="gate")["gone"]
    client = agent.board(0x61000004)
    node = "garden/gate"
    client.writer(node, "rt/garden/state", "std_msgs::msg::dds_::Int32_")
    client.service(ids.KIND_REPLIER, node, "/garden/open", *TRIGGER_TYPES)
    client.service(ids.KIND_REPLIER, node, "/garden/close", *TRIGGER_TYPES)
    client.service(ids.KIND_REQUESTER, node, "/house/ring", *TRIGGER_TYPES)
    offered = {
        "services": {"/garden/open": [TRIGGER], "/garden/close": [TRIGGER]},
        "clients": {"/house/ring": [TRIGGER]},
    }
    listed = peer.do("services", namespace="/garden", name="gate", **offered)
    assert listed["found"] == [
        {"/garden/open": [TRIGGER], "/garden/close": [TRIGGER]}, {"/house/ring": [TRIGGER]}
    ], listed  # fmt: skip
    # No peer lists a second node, nor does one that starts later.
    with RosPeer(ros_python, domain, HERE / "service_peer.py") as later:
        for observer in (peer, later):
            answer = observer.do("services", namespace="/garden", name="gate", **offered)
            assert answer["found"] == listed["found"], answer
            full_names = observer.do("graph")["full_names"]
            nodes = [name for name in full_names if name.startswith("/garden/")]
            assert nodes == ["/garden/gate"], full_names
            answer = observer.do("services", namespace="/garden", name="gate", **offered)
            assert answer["found"] == listed["found"], answer
    topics = peer.do(
        "node", namespace="/garden", name="gate",
        publishers={"/garden/state": "std_msgs/msg/Int32"},
    )["publishers"]  # fmt: skip
    assert topics == {"/garden/state": ["std_msgs/msg/Int32"]}
    client.close()
    gone = peer.do("gone", namespace="/garden", name="gate")
    assert gone["gone"], gone
    for service in ("/garden/open", "/garden/close", "/house/ring"):
        assert peer.do("no_service", name=service)["unused"], service
    full_names = peer.do("graph")["full_names"]
    assert not [name for name in full_names if "/garden" in name], full_names


def test_two_boards_may_offer_a_service_of_the_same_name(agent, peer):
    first = BoardServer(agent.board(0x61000005), "left", "/arms/wave")
    second = BoardServer(agent.board(0x61000006), "right", "/arms/wave")
    for name in ("left", "right"):
        listed = peer.do(
            "services", namespace="/", name=name, services={"/arms/wave": [TRIGGER]}, clients={}
        )
        assert listed["found"] == [{"/arms/wave": [TRIGGER]}, {}], listed
    # Both boards receive the request; the client takes the first reply of the two.
    answers = call(peer, "/arms/wave", 20)
    assert len(answers) == 20 and {answer.split()[0] for answer in answers} <= {"left", "right"}
    second.close()
    assert call(peer, "/arms/wave", 20)[-1].split()[0] == "left"
    first.close()
    assert peer.do("no_service", name="/arms/wave")["unused"]


def test_a_malformed_reply_is_refused_and_the_next_one_passes(ros2_agent, peer):
    """A reply that does not fit its type is logged, one to an unknown requester is dropped."""
    client = ros2_agent.board(0x61000007)
    replier = client.service(ids.KIND_REPLIER, "bad", "/bad/reply", *TRIGGER_TYPES)
    client.read(replier)
    answers = []

    def start_call():
        thread = threading.Thread(target=lambda: answers.extend(call(peer, "/bad/reply")))
        thread.start()
        return thread

    first = start_call()
    while first.is_alive():
        if client.wait_sample(replier, 0.05):
            client.write(replier, client.sample(replier)[:24] + reply("met"))
    second = start_call()
    identity = client.sample(replier, SECONDS)[:24]
    client.write(replier, identity + b"\1\0\0\0\xff\xff\xff\x7f")
    client.write(replier, bytes(24) + reply("to nobody"))
    client.write(replier, identity + reply("good"))
    second.join()
    assert answers == ["met", "good"]
    assert "/bad/reply" in ros2_agent.line("does not read as its type")
    client.close()


def test_a_board_that_reads_the_graph_sees_a_service_once(agent_without_rclpy, peer):
    server = agent_without_rclpy.board(0x6100000E)
    server.service(ids.KIND_REPLIER, "told/gate", "/told/open", *TRIGGER_TYPES)
    offered = {"/told/open": [TRIGGER]}
    listed = peer.do("services", namespace="/told", name="gate", services=offered, clients={})
    assert listed["found"] == [offered, {}], listed
    client = agent_without_rclpy.board(0x6100000F)
    flags = ids.QOS_RELIABLE | ids.QOS_KEEP_LAST | ids.QOS_TRANSIENT_LOCAL
    reader = client.reader("asking", ros_graph.TOPIC, ros_graph.TYPE, flags, depth=1)
    client.read(reader)
    deadline = time.monotonic() + SECONDS
    while (graph := client.sample(reader, deadline - time.monotonic())).count(b"/told/open\0") != 1:
        pass
    assert graph.count(b"gate\0") == 1
    client.close()
    server.close()


# --- the process ----------------------------------------------------------------------


def test_an_rclpy_that_does_not_start_ends_the_agent_with_the_remedy(ros_python, domain):
    command = [ros_python, "-m", "uros", "agent", "udp4", "-p", "0", "-m", "ros2"]
    done = subprocess.run(
        [*map(str, command), "--domain", str(domain)], text=True, capture_output=True,
        env=dict(environment(), RMW_IMPLEMENTATION="rmw_nowhere_cpp"), timeout=SECONDS,
    )  # fmt: skip
    assert done.returncode == 1, done
    assert "rclpy" in done.stderr and "unset RMW_IMPLEMENTATION" in done.stderr, done.stderr


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
@pytest.mark.parametrize("middleware", [WITH_SERVICES, "ros2"])
def test_an_agent_with_services_ended_by_a_signal_leaves_the_graph(
    ros_python, domain, peer, middleware, number
):
    python = ros_python if middleware == "ros2" else sys.executable
    with running(python, domain, middleware, how="-v4") as agent:
        client = agent.board(0x6100000C)
        client.service(ids.KIND_REPLIER, "short", "/short/lived", *TRIGGER_TYPES)
        answer = peer.do(
            "services", namespace="/", name="short", services={"/short/lived": [TRIGGER]},
            clients={},
        )  # fmt: skip
        assert answer["found"] == [{"/short/lived": [TRIGGER]}, {}], answer
        agent.signal(number)
        agent.line("server stopped")
        assert peer.do("no_service", name="/short/lived", seconds=5)["unused"]
        assert peer.do("gone", namespace="/", name="short", seconds=5)["gone"]


def test_topics_and_services_on_ros2_alone(ros_python):
    with leased_domain() as domain:
        with (
            running(ros_python, domain, "ros2") as agent,
            RosPeer(ros_python, domain, HERE / "service_peer.py") as peer,
        ):
            server = BoardServer(agent.board(0x6100000A), "whole", "/whole/do")
            client = agent.board(0x6100000B)
            writer = client.writer("sensor", "rt/whole/value", "std_msgs::msg::dds_::Int32_")
            first = int(call(peer, "/whole/do")[0].split()[1])
            assert call(peer, "/whole/do", 5) == [f"whole {first + i + 1}" for i in range(5)]
            peer.do("subscribe", topic="/whole/value", type="std_msgs/msg/Int32")
            peer.do(
                "node", namespace="/", name="sensor",
                publishers={"/whole/value": "std_msgs/msg/Int32"},
            )  # fmt: skip
            for _ in range(100):
                client.write(writer, b"\x2a\0\0\0")
                if peer.messages["/whole/value"] or client.wait_sample(0, 0.1):
                    break
                peer.do("graph")
            assert peer.message("/whole/value")[:8] == b"\0\1\0\0\x2a\0\0\0"
            full = peer.do("graph")["full_names"]
            assert {"/whole", "/sensor"} <= set(full) and not any("/_" in name for name in full)
            client.close()
            server.close()
            assert peer.do("gone", namespace="/", name="sensor")["gone"]
