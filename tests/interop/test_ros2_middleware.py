"""Services of boards on the auto middleware, with real rclpy nodes in processes of their own.

The agent runs under the interpreter that has rclpy. So do the tests of the middleware itself:
the contract suite for ros2 and auto, and ``rclpy_middleware.py``.
"""

import os
import re
import signal
import subprocess
import threading
import time
from contextlib import contextmanager
from pathlib import Path

import pytest
from conftest import ROOT, leased_domain
from support.client import XrceClient
from support.lines import UdpLine
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


# --- what runs inside the interpreter that has rclpy ---------------------------------


@pytest.mark.parametrize(
    ("tests", "least"),
    [
        (["tests/contract/test_middleware.py", "-k", "ros2 or auto"], 80),
        (["tests/interop/rclpy_middleware.py"], 22),
    ],
    ids=["contract", "rclpy"],
)
def test_the_middlewares_on_rclpy(ros_python, tests, least):
    """``least``: a run that finds no tests, or skips them, must not pass for one that did."""
    command = [ros_python, "-m", "pytest", "-q", "-p", "no:cacheprovider"]
    # rosidl's parser, which rclpy's actions load, imports what Python 3.11 deprecates.
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
    """``uros agent`` as a process. ``said`` is its log, line by line."""

    def __init__(self, python, domain, middleware="auto", how="--stop-at-eof", **variables):
        command = [python, "-m", "uros", "agent", "udp4", "-p", "0", "-m", middleware]
        with default_signals():
            self._process = subprocess.Popen(
                [*map(str, command), "--domain", str(domain), how],
                stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True,
                env=dict(environment(), **variables),
            )  # fmt: skip
        self.said = []
        self._news = threading.Condition()
        self._thread = threading.Thread(target=self._read, daemon=True)
        self._thread.start()
        self._heard = 0
        self._lines = []
        self.port = int(self.line("running...").split()[-1])

    def _read(self):
        for line in self._process.stdout:
            with self._news:
                self.said.append(line)
                self._news.notify_all()

    def line(self, part):
        """The first line with this text that was not given out before."""
        with self._news:
            assert self._news.wait_for(lambda: self._find(part), SECONDS), (part, self.said)
            line = self._find(part)
            self._heard = self.said.index(line, self._heard) + 1
            return line

    def _find(self, part):
        return next((line for line in self.said[self._heard :] if part in line), None)

    def notices(self):
        """The middleware's, all of them so far."""
        return [line for line in self.said if "Middleware" in line and "notice" in line]

    def board(self, key):
        """A client with a session."""
        self._lines.append(UdpLine(self.port))
        client = XrceClient(self._lines[-1], key=key)
        assert client.open() == ids.STATUS_OK
        return client

    def signal(self, number):
        self._process.send_signal(number)

    def close(self):
        self._process.stdin.close()
        try:
            assert self._process.wait(SECONDS) == 0, self.said
        finally:
            self._process.kill()
            self._thread.join()
            self._process.stdout.close()
            for line in self._lines:
                line.close()
        assert "internal error" not in "".join(self.said), self.said


@contextmanager
def running(python, domain, middleware="auto", **options):
    agent = Agent(python, domain, middleware, **options)
    try:
        yield agent
    finally:
        agent.close()


@pytest.fixture(scope="module")
def agent(ros_python, domain):
    with running(ros_python, domain) as one:
        yield one


@pytest.fixture(scope="module")
def peer(ros_python, domain):
    with RosPeer(ros_python, domain, HERE / "service_peer.py") as running:
        yield running


def reply(text, success=True):
    """A Trigger's reply as a board writes it: no encapsulation."""
    raw = text.encode() + b"\0"
    return bytes((success, 0, 0, 0)) + len(raw).to_bytes(4, "little") + raw


def text_of(body):
    """The text of a Trigger's reply that begins there."""
    size = int.from_bytes(body[4:8], "little")
    return body[8 : 8 + size - 1].decode()


class BoardServer:
    """A board that answers a Trigger with its name and a number, in a thread."""

    def __init__(self, client, node, service):
        self.client = client
        self.node = node
        self.thing = client.service(ids.KIND_REPLIER, node, service, *TRIGGER_TYPES)
        client.read(self.thing)
        self.identities = []
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._serve, daemon=True)
        self._thread.start()

    def _serve(self):
        while not self._stop.is_set():
            if self.client.wait_sample(self.thing, 0.05):
                identity = self.client.sample(self.thing)[:24]
                self.identities.append(identity)
                text = reply(f"{self.node} {len(self.identities)}")
                self.client.write(self.thing, identity + text)

    def close(self):
        self._stop.set()
        self._thread.join()
        self.client.close()


def call(peer, service, times=1):
    got = peer.do("call", name=service, type=TRIGGER, cdr="0001000000", times=times, seconds=60)
    assert got["replies"] is not None, "the service is not there"
    return [text_of(bytes.fromhex(it)[4:]) for it in got["replies"]]


def test_a_real_node_calls_a_boards_service_many_times(agent, peer):
    server = BoardServer(agent.board(0x61000001), "arm", "/arm/home")
    met = int(call(peer, "/arm/home")[0].split()[1])
    assert call(peer, "/arm/home", CALLS) == [f"arm {met + i + 1}" for i in range(CALLS)]
    assert len(set(server.identities)) == met + CALLS
    server.close()
    assert peer.do("no_service", name="/arm/home")["unused"]


def test_a_board_calls_a_real_nodes_service_many_times(agent, peer):
    peer.do("serve", name="/real/trigger", type=TRIGGER)
    client = agent.board(0x61000002)
    thing = client.service(ids.KIND_REQUESTER, "caller", "/real/trigger", *TRIGGER_TYPES)
    client.read(thing)
    number = met(client, thing)
    for i in range(CALLS):
        request = client.write(thing, b"\0")
        sample = client.sample(thing)
        assert sample[:4] == request.to_bytes(2, "big") + thing.to_bytes(2, "big")
        assert text_of(sample[4:]) == f"answer {number + i + 1}"
    client.close()


def met(client, thing):
    """Ask until the first answer: what is asked before the two ends know each other is lost, as
    with any client of ROS. How many were answered."""
    for _ in range(100):
        client.write(thing, b"\0")
        if client.wait_sample(thing, 0.2):
            break
    else:
        raise AssertionError("the service never answers")
    answered = text_of(client.sample(thing)[4:])
    while client.wait_sample(thing, 0.3):
        answered = text_of(client.sample(thing)[4:])
    return int(answered.split()[1])


def test_a_service_may_answer_late(agent, peer):
    peer.do("serve", name="/real/slow", type=TRIGGER, late=1.5)
    client = agent.board(0x61000003)
    thing = client.service(ids.KIND_REQUESTER, "patient", "/real/slow", *TRIGGER_TYPES)
    client.read(thing)
    for _ in range(10):
        request = client.write(thing, b"\0")
        if client.wait_sample(thing, 3.0):
            break
    sample = client.sample(thing)
    assert sample[:2] == request.to_bytes(2, "big")
    assert text_of(sample[4:]) == "answer 1"
    client.close()


def test_a_boards_services_are_its_nodes_which_is_listed_once(agent, peer, ros_python, domain):
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
    seen = peer.do("services", namespace="/garden", name="gate", **offered)
    assert seen["found"] == [
        {"/garden/open": [TRIGGER], "/garden/close": [TRIGGER]}, {"/house/ring": [TRIGGER]}
    ], seen  # fmt: skip
    # Not even the hidden node that is behind them at rclpy, and for those neither that come later.
    with RosPeer(ros_python, domain, HERE / "service_peer.py") as later:
        for one in (peer, later):
            there = one.do("services", namespace="/garden", name="gate", **offered)
            assert there["found"] == seen["found"], there
            gone = one.do("gone", namespace="/garden", name="_gate")
            ours = [name for name in gone["full_names"] if name.startswith("/garden/")]
            assert ours == ["/garden/gate"], gone
            there = one.do("services", namespace="/garden", name="gate", **offered)
            assert there["found"] == seen["found"], there
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
    after = peer.do("gone", namespace="/garden", name="_gate")
    assert after["gone"] and not [it for it in after["full_names"] if "/garden" in it], after


def test_two_boards_may_offer_a_service_of_the_same_name(agent, peer):
    first = BoardServer(agent.board(0x61000005), "left", "/arms/wave")
    second = BoardServer(agent.board(0x61000006), "right", "/arms/wave")
    for name in ("left", "right"):
        seen = peer.do(
            "services", namespace="/", name=name, services={"/arms/wave": [TRIGGER]}, clients={}
        )
        assert seen["found"] == [{"/arms/wave": [TRIGGER]}, {}], seen
    # The first reply counts, whichever board it is from; both were asked.
    answers = call(peer, "/arms/wave", 20)
    assert len(answers) == 20 and {it.split()[0] for it in answers} <= {"left", "right"}
    second.close()
    assert call(peer, "/arms/wave", 20)[-1].split()[0] == "left"
    first.close()
    assert peer.do("no_service", name="/arms/wave")["unused"]


def test_what_is_no_reply_is_refused_and_the_next_one_passes(agent, peer):
    client = agent.board(0x61000007)
    thing = client.service(ids.KIND_REPLIER, "bad", "/bad/reply", *TRIGGER_TYPES)
    client.read(thing)
    answers = []

    def asking():
        thread = threading.Thread(target=lambda: answers.extend(call(peer, "/bad/reply")))
        thread.start()
        return thread

    first = asking()
    while first.is_alive():
        if client.wait_sample(thing, 0.05):
            client.write(thing, client.sample(thing)[:24] + reply("met"))
    asked = asking()
    identity = client.sample(thing, SECONDS)[:24]
    client.write(thing, identity + b"\1\0\0\0\xff\xff\xff\x7f")
    client.write(thing, bytes(24) + reply("to nobody"))
    client.write(thing, identity + reply("good"))
    asked.join()
    assert answers == ["met", "good"]
    assert "/bad/reply" in agent.line("does not read as its type")
    client.close()


def test_a_board_that_knows_the_graph_sees_a_service_once(agent, peer):
    offering = agent.board(0x6100000E)
    offering.service(ids.KIND_REPLIER, "told/gate", "/told/open", *TRIGGER_TYPES)
    # The node that is behind it at rclpy stands for nothing.
    offered = {"/told/open": [TRIGGER]}
    seen = peer.do("services", namespace="/told", name="gate", services=offered, clients={})
    assert seen["found"] == [offered, {}], seen
    client = agent.board(0x6100000F)
    flags = ids.QOS_RELIABLE | ids.QOS_KEEP_LAST | ids.QOS_TRANSIENT_LOCAL
    reader = client.reader("asking", ros_graph.TOPIC, ros_graph.TYPE, flags, depth=1)
    client.read(reader)
    deadline = time.monotonic() + SECONDS
    while (told := client.sample(reader, deadline - time.monotonic())).count(b"/told/open\0") != 1:
        pass
    assert b"\0gate\0" in told and b"_gate\0" not in told
    client.close()
    offering.close()


class Beside:
    """A board that sends itself a number a hundred times a second, in a thread."""

    PERIOD = 0.01

    def __init__(self, client):
        self.client = client
        self.heard = []  # (number, when, how long it was on its way)
        self.sent = 0
        self._topic = "rt/beside", "std_msgs::msg::dds_::Int32_"
        self._writer = client.writer("beside", *self._topic)
        self._reader = client.reader("beside", *self._topic, depth=1000)
        client.read(self._reader)
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def _run(self):
        while not self._stop.wait(self.PERIOD):
            started = time.monotonic()
            self.client.write(self._writer, self.sent.to_bytes(4, "little"))
            self.sent += 1
            got = int.from_bytes(self.client.sample(self._reader)[:4], "little")
            now = time.monotonic()
            self.heard.append((got, now, now - started))

    def close(self):
        self._stop.set()
        self._thread.join()
        self.client.close()


def test_boards_beside_are_served_while_the_first_service_comes(ros_python, capsys):
    """How long they wait is printed: it is the machine's."""
    with leased_domain() as number, running(ros_python, number) as agent:
        beside = Beside(agent.board(0x6100000A))
        client = agent.board(0x6100000B)
        started, before = time.monotonic(), len(beside.heard)
        server = client.service(ids.KIND_REPLIER, "late", "/late", *TRIGGER_TYPES)
        caller = client.service(ids.KIND_REQUESTER, "late", "/late", *TRIGGER_TYPES)
        created = time.monotonic() - started
        client.read(server)
        client.read(caller)
        request = client.write(caller, b"\0")  # acknowledged when the requester is there
        there, during = time.monotonic() - started, beside.heard[before:]
        if client.wait_sample(server, SECONDS):
            client.write(server, client.sample(server)[:24] + reply("here"))
        answer = client.sample(caller)
        assert (answer[:2], text_of(answer[4:])) == (request.to_bytes(2, "big"), "here")
        beside.close()
        client.close()
        assert [it[0] for it in beside.heard] == list(range(beside.sent))
        assert during, "nobody else was served meanwhile"
        assert not agent.notices()
        times = [it[1] for it in beside.heard]
        gap = max(b - a for a, b in zip(times, times[1:], strict=False))
        with capsys.disabled():
            print(
                f"\nfirst service: created after {created * 1e3:.0f} ms, there after"
                f" {there * 1e3:.0f} ms; beside: {len(during)} samples meanwhile, longest gap"
                f" {gap * 1e3:.0f} ms, longest way {max(it[2] for it in beside.heard) * 1e3:.0f} ms"
            )


# --- where rclpy cannot help -----------------------------------------------------------


def test_a_type_that_rclpy_does_not_have_is_told_by_name_and_goes_over_dds(agent, peer):
    client = agent.board(0x61000008)
    types = "my_robot::srv::dds_::Jump_Request_", "my_robot::srv::dds_::Jump_Response_"
    server = client.service(ids.KIND_REPLIER, "jumper", "/jump", *types)
    caller = client.service(ids.KIND_REQUESTER, "jumper", "/jump", *types)
    notice = agent.line("my_robot/srv/Jump")
    assert "| notice" in notice and "ros-<distro>-my-robot" in notice
    client.read(server)
    client.read(caller)
    request = client.write(caller, b"\5\0\0\0")
    asked = client.sample(server)
    assert asked[24:28] == b"\5\0\0\0"
    client.write(server, asked[:24] + b"\7\0\0\0")
    sample = client.sample(caller)
    assert (sample[:2], sample[4:8]) == (request.to_bytes(2, "big"), b"\7\0\0\0")
    client.close()
    assert len(agent.notices()) == 1  # once is enough for both ends


def test_an_rclpy_that_does_not_start_is_told_once(ros_python):
    with leased_domain() as domain:
        with running(ros_python, domain, RMW_IMPLEMENTATION="rmw_nowhere_cpp") as agent:
            client = agent.board(0x61000009)
            client.writer("plain", "rt/plain", "std_msgs::msg::dds_::Int32_")
            assert not agent.notices()  # an agent without services needs no rclpy
            server = client.service(ids.KIND_REPLIER, "plain", "/plain", *TRIGGER_TYPES)
            notice = agent.line("| notice")
            assert "rclpy" in notice and "RMW_IMPLEMENTATION" in notice
            client.service(ids.KIND_REPLIER, "plain", "/other", *TRIGGER_TYPES)
            client.delete(server)
            client.close()
            assert len(agent.notices()) == 1


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_an_agent_with_rclpy_inside_ends_by_a_signal_and_leaves_nothing(
    ros_python, domain, peer, number
):
    with running(ros_python, domain, how="-v4") as agent:
        client = agent.board(0x6100000C)
        client.service(ids.KIND_REPLIER, "short", "/short/lived", *TRIGGER_TYPES)
        there = peer.do(
            "services", namespace="/", name="short", services={"/short/lived": [TRIGGER]},
            clients={},
        )  # fmt: skip
        assert there["found"] == [{"/short/lived": [TRIGGER]}, {}], there
        agent.signal(number)
        agent.line("server stopped")
        assert peer.do("no_service", name="/short/lived", seconds=5)["unused"]
        assert peer.do("gone", namespace="/", name="short", seconds=5)["gone"]
        assert peer.do("gone", namespace="/", name="_short", seconds=5)["gone"]


def test_topics_and_services_on_ros2_alone(ros_python):
    with leased_domain() as domain:
        with (
            running(ros_python, domain, "ros2") as agent,
            RosPeer(ros_python, domain, HERE / "service_peer.py") as peer,
        ):
            server = BoardServer(agent.board(0x6100000A), "whole", "/whole/do")
            client = agent.board(0x6100000B)
            writer = client.writer("sensor", "rt/whole/value", "std_msgs::msg::dds_::Int32_")
            met = int(call(peer, "/whole/do")[0].split()[1])
            assert call(peer, "/whole/do", 5) == [f"whole {met + i + 1}" for i in range(5)]
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
            assert {"/whole", "/sensor"} <= set(full) and not any("/_" in it for it in full)
            client.close()
            server.close()
            assert peer.do("gone", namespace="/", name="sensor")["gone"]
