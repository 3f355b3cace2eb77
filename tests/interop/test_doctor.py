"""`uros doctor` with a real rclpy node and a board on a real agent: faults between the two.

Each fault has a fix in the doctor's report; the fix is applied, and the doctor finds no problem.
"""

import re

import pytest
from conftest import leased_domain
from support.doctor import agent, board, one_of, run_doctor, spare_port
from support.peer import RosPeer

TEMPERATURE = "sensor_msgs/msg/Temperature"
BEST_EFFORT = {"reliability": "best_effort"}

pytestmark = pytest.mark.timeout(120)


@pytest.fixture
def port(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    return spare_port()


def test_a_healthy_pair(peer, domain, port):
    """A board and a node that match: the doctor reports no problem."""
    peer.do("subscribe", topic="/temp", type=TEMPERATURE)
    with agent(port) as which, board(port, domain):
        problems, findings = run_doctor(which, domain, port)
    peer.do("unsubscribe", topic="/temp")
    assert problems == []
    for check in ("domain", "types", "qos", "clock"):
        assert one_of(findings, check).state == "ok", check


def test_a_reliable_subscription_of_a_best_effort_board(peer, domain, port):
    peer.do("subscribe", topic="/temp", type=TEMPERATURE)
    with agent(port) as which, board(port, domain, BEST_EFFORT):
        (problem,), _ = run_doctor(which, domain, port)
        assert "/board publishes on /temp reaches /real/peer: reliability offered" in problem.what
    option = re.fullmatch(r"start the agent with --qos (\S+)", problem.fix)[1]
    with agent(port, "--qos", option) as which, board(port, domain, BEST_EFFORT):
        assert run_doctor(which, domain, port)[0] == []
        peer.message("/temp")  # a sample arrives
    peer.do("unsubscribe", topic="/temp")


@pytest.mark.slow
def test_a_latched_subscription_of_a_volatile_board(peer, domain, port):
    peer.do("subscribe", topic="/temp", type=TEMPERATURE, durability="transient_local")
    with agent(port) as which, board(port, domain):
        (problem,), _ = run_doctor(which, domain, port)
        assert "durability offered is volatile, requested transient_local" in problem.what
    option = re.fullmatch(r"start the agent with --qos (\S+)", problem.fix)[1]
    with agent(port, "--qos", option) as which, board(port, domain):
        assert run_doctor(which, domain, port)[0] == []
        peer.message("/temp")
    peer.do("unsubscribe", topic="/temp")


@pytest.mark.slow
def test_a_subscription_with_another_type(peer, domain, port):
    peer.do("subscribe", topic="/temp", type="std_msgs/msg/String")
    with agent(port) as which, board(port, domain):
        (problem,), _ = run_doctor(which, domain, port)
    assert problem.check == "types"
    assert "Temperature in /board" in problem.what and "String in /real/peer" in problem.what
    rule = re.search(r"--remap (\S+)\)", problem.fix)[1]
    with agent(port, "--remap", rule) as which, board(port, domain):
        assert run_doctor(which, domain, port)[0] == []
    peer.do("unsubscribe", topic="/temp")


def test_a_node_in_another_domain(ros_python, domain, port):
    with leased_domain() as peer_domain, RosPeer(ros_python, peer_domain) as peer:
        peer.do("subscribe", topic="/temp", type=TEMPERATURE)
        with agent(port) as which, board(port, domain):
            (problem,), _ = run_doctor(which, peer_domain, port)
            assert problem.check == "domain"
            assert f"/real/peer subscribes to it in domain {peer_domain}" in problem.what
        # The first half of the fix: the node joins the domain of the board.
        number = re.match(r"export ROS_DOMAIN_ID=(\d+) before /real/peer starts", problem.fix)[1]
        assert int(number) == domain
        # The second half: the agent puts the board into the domain of the node.
        number = re.search(r"start the agent with --domain (\d+)$", problem.fix)[1]
        with agent(port, "--domain", number) as which, board(port, domain):
            assert run_doctor(which, peer_domain, port)[0] == []
            peer.message("/temp")
