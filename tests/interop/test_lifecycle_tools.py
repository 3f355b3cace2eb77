"""``uros lifecycle`` with a real rclpy lifecycle node in a process of its own, and one of uros."""

from pathlib import Path

import pytest
from support.middleware import WITH_SERVICES
from support.peer import RosPeer
from support.spinning import spinning

from uros.host.direct import Direct
from uros.host.lifecycle import LifecycleNode
from uros.middleware import open_middleware
from uros.tools import cli

pytestmark = pytest.mark.timeout(120)

LENS = "/lab/lens"


@pytest.fixture(scope="module")
def peer(ros_python, domain):
    with RosPeer(ros_python, domain, Path(__file__).parent / "inspected_peer.py") as running:
        yield running


@pytest.fixture
def uros(domain, capsys):
    """Run a command; return standard output, or both streams where it fails."""

    def run(*arguments, status=0):
        if "--timeout" not in arguments and arguments[0] != "nodes":
            arguments = (arguments[0], "--timeout", "20", *arguments[1:])
        returned = cli.main(["lifecycle", *arguments, "--domain", str(domain)])
        printed = capsys.readouterr()
        assert returned == status, printed
        return printed.out if status == 0 else printed.out + printed.err

    return run


def test_nodes_and_their_states(uros, peer):
    assert uros("nodes") == "/lab/dull\n/lab/lens\n"
    assert uros("nodes", "-c") == "2\n"
    assert uros("nodes", "--json") == '[{"name": "/lab/dull"}, {"name": "/lab/lens"}]\n'
    assert uros("get", LENS) == "unconfigured [1]\n"
    assert uros("get", "--timeout", "2", status=1) == (
        "/lab/lens: unconfigured [1]\n"
        "WARNING: the state of /lab/dull is not known: /lab/dull/get_state did not answer within"
        " 2 s; is its node busy, or not spinning?\n"
    )


def test_a_node_is_led_through_its_states(uros, peer):
    assert uros("list", "lab/lens") == (
        "- configure [1]\n\tStart: unconfigured\n\tGoal: configuring\n"
        "- shutdown [5]\n\tStart: unconfigured\n\tGoal: shuttingdown\n"
    )
    graph = uros("list", LENS, "--all")
    assert graph.count("- ") == 25 and "- transition_error [62]\n\tStart: errorprocessing" in graph
    said = uros("set", LENS, "activat", status=1)
    assert said == (
        "uros: /lab/lens has no transition 'activat' in the state unconfigured [1]; possible:"
        " configure [1], shutdown [5]\n"
    )
    assert uros("set", LENS, "configure") == "Transitioning successful\n"
    assert uros("get", LENS) == "inactive [2]\n"
    assert uros("set", LENS, "3") == "Transitioning successful\n"
    assert uros("get", LENS) == "active [3]\n"
    assert "; did you mean 'deactivate'?" in uros("set", LENS, "deactivat", status=1)
    uros("set", LENS, "deactivate")
    uros("set", LENS, "cleanup")
    peer.do("outcome", configure="FAILURE")
    assert uros("set", LENS, "configure", status=1) == "Transitioning failed\n"
    assert uros("get", LENS) == "unconfigured [1]\n"
    peer.do("outcome")


def test_nodes_that_are_not_there_or_have_no_life_cycle(uros, peer):
    said = uros("get", "/lab/len", "--timeout", "2", status=1)
    assert "there is no node '/lab/len' in domain" in said and "did you mean '/lab/lens'?" in said
    said = uros("set", "/real/peer", "configure", status=1)
    assert said.startswith(
        "uros: the node /real/peer has no life cycle; nodes that have one: /lab/"
    )


def test_a_node_of_uros_is_led_through_its_states(uros, domain):
    node = LifecycleNode("iris", Direct(open_middleware(WITH_SERVICES), domain), domain_id=domain)
    with spinning(node):
        assert uros("set", "/iris", "configure") == "Transitioning successful\n"
        assert uros("get", "/iris") == "inactive [2]\n"
        assert "- activate [3]\n\tStart: inactive\n\tGoal: activating\n" in uros("list", "/iris")
