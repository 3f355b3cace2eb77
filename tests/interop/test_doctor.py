"""`uros doctor` beside a real rclpy node and a board on a real agent: faults between the two."""

import re

import pytest
from conftest import leased_domain
from support.doctor import agent, board, look, one_of, spare_port
from support.peer import RosPeer

TEMPERATURE = "sensor_msgs/msg/Temperature"
BEST_EFFORT = {"reliability": "best_effort"}

pytestmark = pytest.mark.timeout(120)


@pytest.fixture
def port(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    return spare_port()


def test_a_healthy_pair(peer, domain, port):
    peer.do("subscribe", topic="/temp", type=TEMPERATURE)
    with agent(port) as which, board(port, domain):
        problems, found = look(which, domain, port)
    peer.do("unsubscribe", topic="/temp")
    assert problems == []
    for check in ("domain", "types", "qos", "clock"):
        assert one_of(found, check).state == "ok", check


def test_a_reliable_subscription_of_a_best_effort_board(peer, domain, port):
    peer.do("subscribe", topic="/temp", type=TEMPERATURE)
    with agent(port) as which, board(port, domain, BEST_EFFORT):
        (one,), _ = look(which, domain, port)
        assert "/board publishes on /temp reaches /real/peer: reliability offered" in one.what
    option = re.fullmatch(r"start the agent with --qos (\S+)", one.fix)[1]
    with agent(port, "--qos", option) as which, board(port, domain, BEST_EFFORT):
        assert look(which, domain, port)[0] == []
        peer.message("/temp")  # it has come through
    peer.do("unsubscribe", topic="/temp")


def test_a_latched_subscription_of_a_volatile_board(peer, domain, port):
    peer.do("subscribe", topic="/temp", type=TEMPERATURE, durability="transient_local")
    with agent(port) as which, board(port, domain):
        (one,), _ = look(which, domain, port)
        assert "durability offered is volatile, requested transient_local" in one.what
    option = re.fullmatch(r"start the agent with --qos (\S+)", one.fix)[1]
    with agent(port, "--qos", option) as which, board(port, domain):
        assert look(which, domain, port)[0] == []
        peer.message("/temp")
    peer.do("unsubscribe", topic="/temp")


def test_another_type(peer, domain, port):
    peer.do("subscribe", topic="/temp", type="std_msgs/msg/String")
    with agent(port) as which, board(port, domain):
        (one,), _ = look(which, domain, port)
    assert one.check == "types"
    assert "Temperature in /board" in one.what and "String in /real/peer" in one.what
    new = re.search(r"--remap (\S+)\)", one.fix)[1]
    with agent(port, "--remap", new) as which, board(port, domain):
        assert look(which, domain, port)[0] == []
    peer.do("unsubscribe", topic="/temp")


def test_another_domain(ros_python, domain, port):
    with leased_domain() as other, RosPeer(ros_python, other) as peer:
        peer.do("subscribe", topic="/temp", type=TEMPERATURE)
        with agent(port) as which, board(port, domain):
            (one,), _ = look(which, other, port)
            assert one.check == "domain" and f"/real/peer subscribes to it in domain {other}" in (
                one.what
            )
        # The node goes where the board is, as the first half of the fix says.
        number = re.match(r"export ROS_DOMAIN_ID=(\d+) before /real/peer starts", one.fix)[1]
        assert int(number) == domain
        # The second half: the agent puts the board where the node is.
        number = re.search(r"start the agent with --domain (\d+)$", one.fix)[1]
        with agent(port, "--domain", number) as which, board(port, domain):
            assert look(which, other, port)[0] == []
            peer.message("/temp")
