"""``uros agent --diagnostics``: a real rclpy node on /diagnostics sees boards come and go."""

import sys
import time

import pytest
from interop.test_ros2_middleware import running

from uros.agent.observability.diagnostic_array import ERROR, OK, STALE, WARN
from uros.interfaces import load
from uros.interfaces.codec import from_cdr

TYPE = "diagnostic_msgs/msg/DiagnosticArray"
TOPIC = "/diagnostics"
AGENT = "uros_agent: agent"
SECONDS = 30.0

pytestmark = pytest.mark.timeout(180)


@pytest.fixture(scope="module", params=["rtps", "dds", "auto", "ros2"])
def agent(request, domain, ros_python):
    """An agent with each middleware; boards that do not answer are deleted after six seconds."""
    python = ros_python if request.param == "ros2" else sys.executable
    more = ("--diagnostics", "0.25", "--dead-time", "6")
    with running(python, domain, request.param, more=more) as process:
        process.line("publishing")
        yield process


@pytest.fixture
def subscribed(agent, peer):
    """The peer, subscribed to what this agent publishes."""
    assert peer.do("topic", topic=TOPIC)["infos"]
    peer.do("subscribe", topic=TOPIC, type=TYPE)
    yield peer
    peer.do("unsubscribe", topic=TOPIC)
    peer.messages[TOPIC].clear()


def status(peer, name, level, doing=lambda: None):
    """Wait for a status of this name with one of these levels; return it."""
    last = None
    deadline = time.monotonic() + SECONDS
    while time.monotonic() < deadline:
        doing()
        message = from_cdr(load(TYPE), peer.message(TOPIC))
        for each in message.status:
            if each.name == name:
                last = each
                if each.level in level:
                    return each
    raise AssertionError(f"the last status of {name!r} is {last}")


def test_a_board_connects_and_closes_its_session(agent, subscribed, domain):
    board = agent.board(0xD1A6)
    board.writer("talker", "rt/chatter", "std_msgs::msg::dds_::String_")
    name = "uros_agent: board 0x0000D1A6 talker"
    connected = status(subscribed, name, {OK}, board.ping)
    assert (connected.message, connected.hardware_id) == ("connected", "0x0000D1A6")
    values = {pair.key: pair.value for pair in connected.values}
    assert (values["nodes"], values["transport"]) == (f"/talker@{domain}", "UDPv4Agent")
    while int(values["messages from the board"]) < 4:  # the first status may tell of less
        connected = status(subscribed, name, {OK}, board.ping)
        values = {pair.key: pair.value for pair in connected.values}
    assert status(subscribed, AGENT, {OK}, board.ping).message == "1 board"
    board.close()
    left = status(subscribed, name, {STALE})
    assert left.message.startswith("disconnected ") and left.message.endswith("before: connected")
    assert status(subscribed, AGENT, {OK}).message == "0 boards"


def test_a_board_vanishes(agent, subscribed):
    board = agent.board(0xD1A7)
    board.writer("sensor", "rt/chatter", "std_msgs::msg::dds_::String_")
    name = "uros_agent: board 0x0000D1A7 sensor"
    status(subscribed, name, {OK}, board.ping)
    silent = status(subscribed, name, {WARN, ERROR})
    assert silent.message.startswith("silent for ")
    left = status(subscribed, name, {STALE})
    assert left.message.startswith("disconnected ") and "before: silent for " in left.message


def test_the_node_the_type_hash_and_the_qos_are_those_of_ros(agent, subscribed):
    seen = subscribed.do(
        "node", namespace="/", name="uros_agent", publishers={TOPIC: TYPE}
    )  # fmt: skip
    assert seen["publishers"][TOPIC] == [TYPE]
    (ours,) = subscribed.do("topic", topic=TOPIC)["infos"]
    (theirs,) = subscribed.do("topic", topic=TOPIC, of="subscriptions")["infos"]
    assert ours == theirs == {
        "type": TYPE, "hash": theirs["hash"], "reliability": "RELIABLE", "durability": "VOLATILE",
    }  # fmt: skip
    assert theirs["hash"].startswith("RIHS01_")


def test_the_stamp_is_the_time(agent, subscribed):
    subscribed.messages[TOPIC].clear()
    subscribed.times[TOPIC].clear()
    cdr, received_ns = subscribed.timed_message(TOPIC)
    stamp = from_cdr(load(TYPE), cdr).header.stamp
    assert abs(received_ns / 1e9 - stamp.sec - stamp.nanosec / 1e9) < SECONDS
