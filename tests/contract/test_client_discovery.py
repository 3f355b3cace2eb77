"""Boards that know nothing of their agent find it: real agents, multicast on loopback."""

from contextlib import ExitStack

import pytest
from support.lines import SECONDS
from support.ports import free_port
from unit.agent.transports.test_discovery import running
from uros.interfaces.std_msgs.msg import Int32

from uros.agent.transports import addresses
from uros.agent.transports.discovery import GROUP
from uros.agent.transports.tcp import TcpServer
from uros.agent.transports.udp import UdpServer
from uros.client import AGENT_CONNECTED, AGENT_DISCONNECTED, WAITING_AGENT, Node
from uros.ticks import ticks_diff, ticks_ms
from uros.transport.discovery import DiscoveringTransport, discover_agent
from uros.transport.tcp import TcpTransport
from uros.transport.wlan import Over

QUICK = {"ping_ms": 20, "silence_ms": 200, "wait_ms": 20}
HERE = "127.0.0.1"


@pytest.fixture(autouse=True)
def loopback_only(monkeypatch):
    """Agents join the group on no network outside of this machine."""
    monkeypatch.setattr(addresses, "ipv4_by_interface", lambda: {"lo": HERE})


@pytest.fixture
def boards():
    """Makes nodes that ask at a port, and ends them."""
    made = []

    def make(port, host=GROUP, **options):
        transport = DiscoveringTransport(((host, port),), HERE, **options)
        made.append(Node("node", transport, key=len(made) + 1, **QUICK))
        return made[-1]

    yield make
    for it in made:
        it.connection.transport.close()


def until(node, done):
    begun = ticks_ms()
    while not done():
        assert ticks_diff(ticks_ms(), begun) < SECONDS * 1000, node.connection.reason
        node.spin_once(0.005)


def connected(node):
    until(node, lambda: node.state == AGENT_CONNECTED)


@pytest.mark.parametrize("host", [GROUP, HERE], ids=["multicast", "unicast"])
def test_an_agent_is_found_and_samples_travel(host, boards):
    udp = UdpServer(0)
    with running(udp) as agent:
        asked = ((host, agent.discovery.port),)
        assert discover_agent(10_000, asked, HERE) == (HERE, udp.port)
        node = boards(agent.discovery.port, host)
        heard = []
        publisher = node.create_publisher(Int32, "numbers")
        node.create_subscription(Int32, "numbers", lambda it: heard.append(it.data), 100)
        connected(node)
        assert node.connection.transport.agent == (HERE, udp.port)
        for i in range(100):
            assert publisher.publish(Int32(data=i))
        until(node, lambda: len(heard) == 100)
        assert heard == list(range(100)) and agent.discovery.faults == 0
        node.destroy_node()


def test_an_agent_that_comes_back_at_another_port(boards):
    with running(UdpServer(0)) as agent:
        port = agent.discovery.port
        node = boards(port)
        states, heard = [], []
        node.on_state = states.append
        publisher = node.create_publisher(Int32, "numbers")
        node.create_subscription(Int32, "numbers", lambda it: heard.append(it.data))
        connected(node)
        found = [node.connection.transport.agent]
    for turn in range(2):
        until(node, lambda: node.state == WAITING_AGENT)
        udp = UdpServer(0)
        with running(udp, port=port):
            connected(node)
            found.append(node.connection.transport.agent)
            assert found[-1] == (HERE, udp.port)
            assert publisher.publish(Int32(data=turn))
            until(node, lambda turn=turn: turn in heard)
    assert len(set(found)) == 3 and heard == [0, 1]
    assert states.count(AGENT_DISCONNECTED) == 2


def test_of_two_agents_one_is_taken_and_the_other_when_that_has_left(boards):
    agents = {}
    with ExitStack() as one, ExitStack() as two:
        port = 0
        for leaving in (one, two):
            udp = UdpServer(0)
            port = leaving.enter_context(running(udp, port=port)).discovery.port
            agents[HERE, udp.port] = leaving
        assert discover_agent(10_000, ((GROUP, port),), HERE) in agents
        node = boards(port)
        connected(node)
        agents.pop(node.connection.transport.agent).close()
        until(node, lambda: node.state == WAITING_AGENT)
        connected(node)
        assert node.connection.transport.agent in agents


def test_the_program_goes_on_while_there_is_no_agent(boards):
    port = free_port()
    node = boards(port, patience_ms=50)
    calls = []
    node.create_timer(0.01, lambda: calls.append(1))
    until(node, lambda: len(calls) >= 20 and node.connection.reason)
    assert node.state == WAITING_AGENT
    assert f"no agent answers at {GROUP} port {port}" in node.connection.reason
    assert "--discovery" in node.connection.reason
    with running(UdpServer(0), port=port):
        connected(node)


def test_over_a_network_that_is_not_there_yet(boards):
    class Link:
        up = False

        def check(self):
            if not self.up:
                raise OSError("joining robots")

    with running(UdpServer(0)) as agent:
        node = boards(agent.discovery.port)
        link = Link()
        node.connection.transport = Over(link, node.connection.transport)
        until(node, lambda: "joining robots" in node.connection.reason)
        link.up = True
        connected(node)


def test_nobody_answers():
    before = ticks_ms()
    assert discover_agent(200, ((GROUP, free_port()),), HERE) is None
    assert ticks_diff(ticks_ms(), before) >= 200


def test_an_agent_on_ipv6_alone(boards):
    udp = UdpServer(0, "::1")
    with running(udp) as agent:
        node = boards(agent.discovery.port)
        connected(node)
        assert node.connection.transport.agent == ("0:0:0:0:0:0:0:1", udp.port)


def test_an_agent_on_tcp_for_a_board_that_speaks_it(boards):
    tcp = TcpServer(0)
    with running(tcp) as agent:
        node = boards(agent.discovery.port, make=TcpTransport)
        connected(node)
        assert node.connection.transport.agent == (HERE, tcp.port)


def test_an_agent_of_which_one_port_is_silent(boards):
    """TCP first or UDP: it does not say, so a board tries what it was told in turn."""
    with running(TcpServer(0), UdpServer(0)) as agent:
        node = boards(agent.discovery.port, make=TcpTransport)
        connected(node)
        assert node.connection.connections == 1
