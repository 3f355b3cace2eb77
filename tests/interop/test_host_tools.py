"""``uros topic pub``, ``uros service`` and ``uros run``, as processes, with real rclpy nodes and
with boards on an agent.

Commands that need rclpy run under the interpreter that has rclpy.
"""

import itertools
import json
import math
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
from conftest import ROOT
from support.agent import running_agent
from support.middleware import MIDDLEWARE, host_node
from support.peer import RosPeer
from support.spinning import spinning
from support.variants import slow_except

from uros.bag.reader import BagReader
from uros.interfaces import load
from uros.interfaces.codec import from_cdr, to_cdr
from uros.tools.run.trigger_service import TriggerService
from uros.tools.values.plain import constructed
from uros.transport.udp import UdpTransport

pytestmark = pytest.mark.timeout(120)

TRIGGER = "std_srvs/srv/Trigger"
STRING = "std_msgs/msg/String"
SECONDS = 40
EMPTY = "0001000000"  # a Trigger's request
LOG = re.compile(r"\[INFO\] \[(\d{10})\.(\d{9})\] \[(\w+)\]: (.*)\n")

# The process that started the tests may have set SIGINT to be ignored, which children inherit.
UROS = (
    "import signal, sys; signal.signal(signal.SIGINT, signal.default_int_handler);"
    " from uros.tools.cli import main; sys.exit(main())"
)


def environment(**variables):
    return dict(os.environ, PYTHONPATH=str(ROOT / "src"), **variables)


@pytest.fixture(scope="module")
def peer(ros_python, domain):
    with RosPeer(ros_python, domain, Path(__file__).parent / "service_peer.py") as running:
        yield running


@pytest.fixture
def uros(domain):
    """Run a command to its end; return standard output, or standard error if it fails."""

    def run(*arguments, python=sys.executable, status=0, stdin=""):
        done = subprocess.run(
            [str(python), "-c", UROS, *arguments, "--domain", str(domain)],
            capture_output=True, text=True, input=stdin, timeout=SECONDS, env=environment(),
        )  # fmt: skip
        assert done.returncode == status, done.stdout + done.stderr
        return done.stdout if status == 0 else done.stderr

    return run


@contextmanager
def child(python, *arguments):
    """Run a command in a process, which is killed at the end of the block."""
    process = subprocess.Popen(
        [str(python), "-c", UROS, *arguments], stdout=subprocess.PIPE, stderr=subprocess.PIPE,
        text=True, env=environment(),
    )  # fmt: skip
    timer = threading.Timer(SECONDS, process.kill)  # so that no read blocks forever
    timer.start()
    try:
        yield process
    finally:
        timer.cancel()
        process.kill()
        process.wait()
        process.stdout.close()
        process.stderr.close()


@contextmanager
def going(python, *arguments):
    """Run a command that ends with status 0 when it is interrupted at the end of the block."""
    with child(python, *arguments) as process:
        yield process
        process.send_signal(signal.SIGINT)
        process.stdout.read()
        assert process.wait(SECONDS) == 0, process.stderr.read()


@pytest.fixture
def started(domain):
    def start(*arguments, python=sys.executable):
        return going(python, *arguments, "--domain", str(domain))

    return start


@contextmanager
def trigger_board(port, domain):
    """A board on the agent at this port that serves ``srv_trigger_py``."""
    node = TriggerService(transport=UdpTransport("127.0.0.1", port), domain_id=domain)
    with spinning(node):
        yield


@contextmanager
def rclpy_service(peer, name):
    peer.do("serve", name=name, type=TRIGGER)
    end = threading.Event()

    def spin():  # the peer serves requests while it waits for a node that does not exist
        while not end.is_set():
            peer.do("node", namespace="/none", name="none", publishers={}, seconds=0.3)

    thread = threading.Thread(target=spin)
    thread.start()
    try:
        yield
    finally:
        end.set()
        thread.join()


# --- topic pub --------------------------------------------------------------------------


VALUES = [
    (STRING, "data: Hello World", {"data": "Hello World"}),
    (STRING, "{data: 'it''s: \"ü\"'}", {"data": 'it\'s: "ü"'}),
    ("std_msgs/msg/Bool", "{data: 1}", {"data": True}),
    ("std_msgs/msg/Int32", "data: -7", {"data": -7}),
    ("std_msgs/msg/UInt16", "data: 0x10", {"data": 16}),
    ("std_msgs/msg/Float32MultiArray", "{data: [0.5, 1, -2.]}", {"data": [0.5, 1.0, -2.0]}),
]


@pytest.mark.parametrize("type_name, text, fields", VALUES)
def test_rclpy_hears_what_is_published_once(uros, peer, type_name, text, fields):
    topic = f"/once/{type_name.rpartition('/')[2].lower()}{len(text)}"
    peer.do("subscribe", topic=topic, type=type_name)
    message = load(type_name)(**fields)
    printed = uros("topic", "pub", "--once", topic, type_name, text)
    assert printed.endswith(f"publisher: beginning loop\npublishing #1: {constructed(message)}\n\n")
    assert from_cdr(type(message), peer.message(topic)) == message
    peer.do("unsubscribe", topic=topic)


def test_a_nested_message_with_the_time(uros, peer):
    kind = load("geometry_msgs/msg/TwistStamped")
    peer.do("subscribe", topic="/stamped", type=kind._TYPE)
    text = "header: auto\ntwist:\n  linear: {x: 0.2}\n  angular:\n    z: 1e-1\n"
    # No type is given: the command takes it from the subscription.
    uros("topic", "pub", "-t", "2", "-r", "20", "/stamped", "--stdin", stdin=text)
    first, second = (from_cdr(kind, peer.message("/stamped")) for _ in range(2))
    assert (first.twist.linear.x, first.twist.angular.z) == (0.2, 0.1)
    now = peer.do("graph") and first.header.stamp
    assert now.sec > 1_700_000_000
    later = second.header.stamp
    assert (now.sec, now.nanosec) < (later.sec, later.nanosec)  # each message has its own
    peer.do("unsubscribe", topic="/stamped")


def test_topic_pub_publishes_a_number_of_times_and_prints_some(uros, peer):
    """``-t 6 -p 3`` publishes six messages and prints every third."""
    peer.do("subscribe", topic="/counted", type=STRING)
    printed = uros("topic", "pub", "-t", "6", "-r", "50", "-p", "3", "/counted", STRING, "data: x")
    lines = printed.split("publisher: beginning loop\n")[1].split("\n\n")
    text = "std_msgs.msg.String(data='x')"
    assert lines == [f"publishing #3: {text}", f"publishing #6: {text}", ""]
    assert len([peer.message("/counted") for _ in range(6)]) == 6
    peer.do("unsubscribe", topic="/counted")


def test_topic_pub_runs_until_it_is_interrupted(started, peer):
    peer.do("subscribe", topic="/endless", type=STRING)
    with started("topic", "pub", "-r", "20", "/endless", STRING, "data: on") as process:
        assert process.stdout.readline() == "publisher: beginning loop\n"
        assert process.stdout.readline() == "publishing #1: std_msgs.msg.String(data='on')\n"
        for _ in range(5):
            assert from_cdr(load(STRING), peer.message("/endless")).data == "on"
    peer.do("unsubscribe", topic="/endless")


def test_topic_pub_stays_for_keep_alive_after_the_last_message(domain):
    once = ("topic", "pub", "-1", "-w", "0", "--keep-alive", "1.5", "/kept", STRING)
    with child(sys.executable, *once, "--domain", str(domain)) as process:
        while not process.stdout.readline().startswith("publishing #1"):
            pass
        started = time.monotonic()
        assert process.wait(SECONDS) == 0
        assert time.monotonic() - started > 1.2


def test_topic_pub_without_a_subscription_times_out(uros):
    error = uros(
        "topic", "pub", "--once", "--max-wait-time-secs", "0.3", "/nobody", STRING, "data: x",
        status=1,
    )  # fmt: skip
    assert "timed out waiting for subscribers: 1 expected, 0 there" in error
    assert "publishing #1" in uros("topic", "pub", "--once", "-w", "0", "/nobody", STRING)


def test_topic_pub_names_a_subscription_that_does_not_match(uros, peer):
    """The error names the node and its QoS, or its type."""
    peer.do("subscribe", topic="/strict", type=STRING, durability="transient_local")
    error = uros("topic", "pub", "--once", "--max-wait-time-secs", "4", "/strict", STRING, status=1)
    assert "/real/peer requests transient_local on /strict, and this offers volatile" in error
    uros("topic", "pub", "--once", "/strict", STRING, "--qos-durability", "transient_local")
    peer.message("/strict")
    peer.do("unsubscribe", topic="/strict")
    peer.do("subscribe", topic="/numbers", type="std_msgs/msg/Int32")
    error = uros(
        "topic", "pub", "--once", "--max-wait-time-secs", "4", "/numbers", STRING, status=1
    )
    assert "/real/peer subscribes to /numbers with the type std_msgs/msg/Int32" in error
    peer.do("unsubscribe", topic="/numbers")


def test_a_board_receives_what_topic_pub_publishes(uros, domain):
    received = threading.Event()
    heard = []
    with running_agent("udp", MIDDLEWARE, domain) as agent:
        import uros as package

        transport = UdpTransport("127.0.0.1", agent.transport.port)
        node = package.Node("board", transport, domain_id=domain)
        node.create_subscription(
            load("std_msgs/msg/Bool"), "/led",
            lambda message: (heard.append(message), received.set()),
        )  # fmt: skip
        with spinning(node):
            uros("topic", "pub", "--once", "/led", "std_msgs/msg/Bool", "{data: 1}")
            assert received.wait(SECONDS)
    assert [message.data for message in heard] == [True]


# --- services -----------------------------------------------------------------------------


def answer(text):
    """Parse the output of `service call`: (success, message)."""
    match = re.fullmatch(
        r"requester: making request: std_srvs\.srv\.Trigger_Request\(\)\n\n"
        r"response:\nstd_srvs\.srv\.Trigger_Response\(success=(\w+), message='(.*)'\)\n\n",
        text,
    )
    assert match, text
    return match.groups()


@pytest.mark.parametrize("middleware", slow_except(["dds", "auto", "rtps"], "auto"))
def test_service_call_to_a_board(uros, domain, middleware):
    with running_agent("udp", middleware, domain) as agent:
        with trigger_board(agent.transport.port, domain):
            called = [answer(uros("service", "call", "/srv_trigger_py", TRIGGER)) for _ in "12"]
            assert called == [("True", "Response[0]"), ("False", "Response[1]")]
            assert answer(uros("service", "call", "srv_trigger_py"))[1] == "Response[2]"


@pytest.mark.parametrize("middleware", ["auto", "rtps"])
def test_service_call_by_rclpy_to_a_board(uros, ros_python, peer, domain, middleware):
    with running_agent("udp", middleware, domain) as agent:
        with trigger_board(agent.transport.port, domain):
            arguments = ("service", "call", "/srv_trigger_py", TRIGGER, "-m", "ros2")
            assert answer(uros(*arguments, python=ros_python)) == ("True", "Response[0]")
            called = peer.do("call", name="/srv_trigger_py", type=TRIGGER, cdr=EMPTY)
            reply = from_cdr(load(TRIGGER).Response, bytes.fromhex(called["replies"][0]))
            assert reply.message.startswith("Response[")


@pytest.mark.parametrize("middleware", ["auto", "rtps", "ros2"])
def test_service_call_to_an_rclpy_service(uros, ros_python, peer, middleware):
    python = ros_python if middleware == "ros2" else sys.executable
    name = f"/real/go_{middleware}"
    with rclpy_service(peer, name):
        called = uros("service", "call", name, TRIGGER, "-m", middleware, python=python)
        assert answer(called) == ("True", "answer 1")


def test_service_call_with_values_and_with_a_rate(uros, domain):
    """The request has the given values; ``-r`` repeats it until Ctrl-C ends it with status 130."""
    kind = load("std_srvs/srv/SetBool")
    requests = []

    def switch(request, response):
        requests.append(request.data)
        response.success, response.message = request.data, "on" if request.data else "off"
        return response

    node = host_node("switches", domain)
    node.create_service(kind, "/light", switch)
    with spinning(node):
        printed = uros("service", "call", "/light", "std_srvs/SetBool", "{data: 1}")
        assert printed == (
            "requester: making request: std_srvs.srv.SetBool_Request(data=True)\n\n"
            "response:\nstd_srvs.srv.SetBool_Response(success=True, message='on')\n\n"
        )
        calls = ("service", "call", "/light", "std_srvs/SetBool", "{data: 0}", "-r", "20")
        with child(sys.executable, *calls, "--domain", str(domain)) as process:
            for _ in range(3 * 5):
                process.stdout.readline()
            process.send_signal(signal.SIGINT)
            process.stdout.read()
            assert process.wait(SECONDS) == 130
        error = uros("service", "call", "/light", TRIGGER, status=1)
        assert error == "uros: /light is std_srvs/srv/SetBool, not std_srvs/srv/Trigger\n"
    assert requests[0] is True and requests[1:4] == [False] * 3


def test_service_call_to_a_missing_service_times_out(uros, domain):
    error = uros("service", "call", "/nowhere", TRIGGER, "--timeout", "0.3", status=1)
    assert "waiting for service /nowhere to become available" in error
    assert "there was no service /nowhere within 0.3 s" in error


def test_service_call_waits_for_a_service(domain):
    late = ("service", "call", "/late", TRIGGER, "--domain", str(domain))
    with child(sys.executable, *late) as process:
        assert "waiting for service /late" in process.stderr.readline()
        node = host_node("late", domain)
        node.create_service(load(TRIGGER), "/late", lambda request, response: response)
        with spinning(node):
            out = process.stdout.read()
    assert answer(out) == ("False", "")


def test_service_call_to_a_server_that_does_not_answer_or_leaves(uros, domain):
    def refuse(request, response):
        raise RuntimeError("deaf")  # it is printed, and nothing is answered

    node = host_node("deaf", domain)
    node.create_service(load(TRIGGER), "/deaf", refuse)
    deaf = ("service", "call", "/deaf", TRIGGER, "--domain", str(domain))
    with child(sys.executable, *deaf) as process:
        with spinning(node):
            error = uros("service", "call", "/deaf", TRIGGER, "--timeout", "3", status=1)
            assert "/deaf did not answer within 3 s" in error
            assert process.stdout.readline().startswith("requester: making request")
        assert process.stderr.read() == ("uros: /deaf ended before it answered; call it again\n")
        assert process.wait(SECONDS) == 1


def test_service_list_type_and_find(uros, peer):
    with rclpy_service(peer, "/real/listed"):
        listed = uros("service", "list", "-t").splitlines()
        assert f"/real/listed [{TRIGGER}]" in listed
        assert "/real/peer/get_parameters [rcl_interfaces/srv/GetParameters]" in listed
        assert uros("service", "type", "/real/listed") == f"{TRIGGER}\n"
        names = uros("service", "find", "std_srvs/Trigger").splitlines()
        assert "/real/listed" in names and "/real/peer/get_parameters" not in names
        assert int(uros("service", "find", TRIGGER, "-c")) == len(names)
        error = uros("service", "type", "/real/liste", status=1)
        assert "there is no service '/real/liste'" in error and "'/real/listed'" in error


# --- uros run -------------------------------------------------------------------------------


def log_line(process):
    """Read a line of the log: (node, text)."""
    match = LOG.fullmatch(process.stdout.readline())
    assert match
    return match[3], match[4]


def test_the_talker_and_the_listener_meet(started, domain):
    with started("run", "listener") as listener, started("run", "talker") as talker:
        for count in (1, 2, 3):
            assert log_line(talker) == ("talker", f"Publishing: 'Hello World: {count}'")
        name, text = log_line(listener)
        assert name == "listener" and re.fullmatch(r"I heard: \[Hello World: [12]\]", text)


def test_the_talker_and_the_listener_with_rclpy(started, peer):
    """rclpy receives from the talker, and the listener receives from rclpy."""
    peer.do("subscribe", topic="/chatter", type=STRING)
    with started("run", "talker"):
        assert from_cdr(load(STRING), peer.message("/chatter")).data.startswith("Hello World: ")
    peer.do("unsubscribe", topic="/chatter")
    hello = to_cdr(load(STRING)(data="from rclpy")).hex()
    with started("run", "listener", "-r", "chatter:=/news", "-r", "__node:=reader") as listener:
        heard = []
        reading = threading.Thread(target=lambda: heard.append(log_line(listener)))
        reading.start()
        while reading.is_alive():  # samples from before the two are matched are lost
            peer.do("publish", topic="/news", type=STRING, cdr=[hello])
            reading.join(0.2)
    assert heard == [("reader", "I heard: [from rclpy]")]


def test_rclpy_calls_the_trigger_service(started, peer):
    with started("run", "trigger_service") as service:
        called = peer.do("call", name="/srv_trigger_py", type=TRIGGER, cdr=EMPTY, times=3)
        replies = [
            from_cdr(load(TRIGGER).Response, bytes.fromhex(cdr)) for cdr in called["replies"]
        ]
        first = int(replies[0].message[9:-1])  # the peer may have repeated its first request
        assert [(reply.success, reply.message) for reply in replies] == [
            (n % 2 == 0, f"Response[{n}]") for n in range(first, first + 3)
        ]
        assert log_line(service) == ("trigger_service", "incoming request")
        assert log_line(service) == ("trigger_service", "Response[0]")


@pytest.mark.parametrize("agents", ["dds", "auto", "rtps"])
@pytest.mark.parametrize("services", ["auto", "rtps"])
def test_a_board_calls_the_trigger_service(started, domain, agents, services):
    import uros as package

    with (
        started("run", "trigger_service", "-m", services),
        running_agent("udp", agents, domain) as agent,
    ):
        transport = UdpTransport("127.0.0.1", agent.transport.port)
        node = package.Node("board", transport, domain_id=domain)
        client = node.create_client(load(TRIGGER), "/srv_trigger_py")
        answers = []

        def ask():
            client.call_async(load(TRIGGER).Request()).add_done_callback(
                lambda future: future.exception() or answers.append(future.result())
            )

        node.create_timer(0.2, ask)
        while len(answers) < 3:
            node.spin_once(0.1)
        node.destroy_node()
    numbers = [int(answer.message[9:-1]) for answer in answers]
    assert numbers == list(range(numbers[0], numbers[0] + 3))
    assert [answer.success for answer in answers] == [n % 2 == 0 for n in numbers]


# --- messages as text -----------------------------------------------------------------------

SHOWN = [
    "std_msgs/msg/String", "std_msgs/msg/Byte", "std_msgs/msg/Float64", "std_msgs/msg/Bool",
    "std_srvs/srv/Trigger_Request", "std_srvs/srv/Trigger_Response", "geometry_msgs/msg/Twist",
    "std_msgs/msg/Float32MultiArray", "std_msgs/msg/UInt8MultiArray", "std_msgs/msg/ByteMultiArray",
    "test_msgs/msg/Nested", "test_msgs/msg/UnboundedSequences", "test_msgs/msg/Strings",
]  # fmt: skip
PRINT_REPR = """
import json, sys
from importlib import import_module
from rclpy.serialization import deserialize_message
shown = []
for name, cdr in json.load(sys.stdin):
    package, kind, plain = name.split("/")
    module = import_module(package + "." + kind)
    service, _, part = plain.partition("_")
    cls = getattr(getattr(module, service), part) if part else getattr(module, plain)
    shown.append(repr(deserialize_message(bytes.fromhex(cdr), cls)))
json.dump(shown, sys.stdout)
"""


def test_messages_are_printed_as_rclpy_prints_them(ros_python):
    messages = [load(name)() for name in SHOWN]
    messages += [
        load("std_msgs/msg/String")(data='it\'s "so" \u2603\n'),
        load("std_msgs/msg/Byte")(data=200),
        load("std_msgs/msg/Float64")(data=math.inf),
        load("std_msgs/msg/Float32MultiArray")(data=[0.5, 1, -2]),
        load("std_msgs/msg/ByteMultiArray")(data=[1, 65]),
        load("std_msgs/msg/UInt8MultiArray")(data=bytes([1, 65])),
    ]
    samples = [(message._TYPE, to_cdr(message).hex()) for message in messages]
    environment = {k: v for k, v in os.environ.items() if k != "PYTHONPATH"}
    done = subprocess.run(
        [str(ros_python), "-c", PRINT_REPR], input=json.dumps(samples), capture_output=True,
        text=True, check=True, env=environment, timeout=SECONDS,
    )  # fmt: skip
    printed = [constructed(from_cdr(type(message), to_cdr(message))) for message in messages]
    assert printed == json.loads(done.stdout)


# --- types that no folder has ---------------------------------------------------------------

# A uros that has never heard of test_msgs.
WITHOUT_TEST_MSGS = """
from uros.interfaces import registry
known = registry._packaged
registry._packaged = lambda: {n: f for n, f in known().items() if not n.startswith("test_msgs/")}
"""


def test_definitions_come_from_the_nodes_that_use_the_types(domain, peer, tmp_path):
    def command(*words):
        return [sys.executable, "-c", WITHOUT_TEST_MSGS + UROS, *words, "--domain", str(domain)]

    def run(*words):
        done = subprocess.run(
            command(*words), capture_output=True, text=True, timeout=SECONDS, env=environment()
        )
        return done.returncode, done.stdout, done.stderr

    nested = load("test_msgs/msg/Nested")()
    nested.basic_types_value.int16_value = -77
    sample = [to_cdr(nested).hex()]
    for topic in ("/described", "/kept"):
        peer.do("publish", topic=topic, type=nested._TYPE, cdr=[], seconds=0)
    options = {"stdout": subprocess.PIPE, "text": True, "env": environment()}
    with (
        subprocess.Popen(
            command("bag", "record", "/kept", "-o", tmp_path / "bag"),
            stderr=subprocess.STDOUT,
            **options,
        ) as recorder,
        subprocess.Popen(command("topic", "echo", "/described", "--once"), **options) as echo,
    ):
        try:
            peer.do("publish", topic="/described", type=nested._TYPE, cdr=sample)
            assert "  int16_value: -77\n" in echo.stdout.read()
            lines = itertools.takewhile(lambda line: "efinition of" not in line, recorder.stdout)
            assert "Subscribed to topic '/kept'\n" in list(lines)
            recorder.send_signal(signal.SIGINT)
            assert recorder.wait(SECONDS) == 0
        finally:
            recorder.kill()
            echo.kill()
    (topic,) = BagReader(tmp_path / "bag").topics
    assert topic.definition.startswith("BasicTypes basic_types_value\n====")
    assert "MSG: test_msgs/BasicTypes\n" in topic.definition
    peer.do("subscribe", topic="/asked", type=nested._TYPE)
    values = "{basic_types_value: {int16_value: 5}}"
    assert run("topic", "pub", "--once", "/asked", nested._TYPE, values)[0] == 0
    assert from_cdr(type(nested), peer.message("/asked")).basic_types_value.int16_value == 5
    status, out, err = run("topic", "pub", "--once", "/asked", "test_msgs/msg/Missing")
    assert status == 1 and "unknown type 'test_msgs/msg/Missing'" in err
