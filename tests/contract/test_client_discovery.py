"""Boards that discover their agent: real agents, multicast on loopback."""

from contextlib import ExitStack

import pytest
from support.lines import SECONDS
from support.ports import free_port
from unit.agent.transports.test_discovery import running
from uros.interfaces.std_msgs.msg import Int32

from uros import addresses
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
    """Agents join the multicast group on loopback only."""
    monkeypatch.setattr(addresses, "ipv4_by_interface", lambda: {"lo": HERE})


@pytest.fixture
def boards():
    """A function that creates nodes with discovery at a port; closes them at the end."""
    created = []

    def make(port, host=GROUP, **options):
        transport = DiscoveringTransport(((host, port),), HERE, **options)
        created.append(Node("node", transport, key=len(created) + 1, **QUICK))
        return created[-1]

    yield make
    for node in created:
        node.connection.transport.close()


def until(node, done):
    begun = ticks_ms()
    while not done():
        assert ticks_diff(ticks_ms(), begun) < SECONDS * 1000, node.connection.reason
        node.spin_once(0.005)


def connected(node):
    until(node, lambda: node.state == AGENT_CONNECTED)


@pytest.mark.parametrize("host", [GROUP, HERE], ids=["multicast", "unicast"])
def test_a_discovered_agent_carries_samples(host, boards):
    udp = UdpServer(0)
    with running(udp) as agent:
        addresses_asked = ((host, agent.discovery.port),)
        assert discover_agent(10_000, addresses_asked, HERE) == (HERE, udp.port)
        node = boards(agent.discovery.port, host)
        received = []
        publisher = node.create_publisher(Int32, "numbers")
        node.create_subscription(
            Int32, "numbers", lambda message: received.append(message.data), 100
        )
        connected(node)
        assert node.connection.transport.agent == (HERE, udp.port)
        for i in range(100):
            assert publisher.publish(Int32(data=i))
        until(node, lambda: len(received) == 100)
        assert received == list(range(100)) and agent.discovery.faults == 0
        node.destroy_node()


def test_an_agent_that_restarts_on_another_port_is_discovered_again(boards):
    with running(UdpServer(0)) as agent:
        port = agent.discovery.port
        node = boards(port)
        states, received = [], []
        node.on_state = states.append
        publisher = node.create_publisher(Int32, "numbers")
        node.create_subscription(Int32, "numbers", lambda message: received.append(message.data))
        connected(node)
        agents = [node.connection.transport.agent]
    for turn in range(2):
        until(node, lambda: node.state == WAITING_AGENT)
        udp = UdpServer(0)
        with running(udp, port=port):
            connected(node)
            agents.append(node.connection.transport.agent)
            assert agents[-1] == (HERE, udp.port)
            assert publisher.publish(Int32(data=turn))
            until(node, lambda turn=turn: turn in received)
    assert len(set(agents)) == 3 and received == [0, 1]
    assert states.count(AGENT_DISCONNECTED) == 2


def test_the_second_of_two_agents_is_used_after_the_first_has_ended(boards):
    agents = {}
    with ExitStack() as first, ExitStack() as second:
        port = 0
        for leaving in (first, second):
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


def test_the_program_continues_while_there_is_no_agent(boards):
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


def test_discovery_waits_for_the_network_link(boards):
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


def test_discovery_without_an_agent_times_out():
    before = ticks_ms()
    assert discover_agent(200, ((GROUP, free_port()),), HERE) is None
    assert ticks_diff(ticks_ms(), before) >= 200


def test_an_agent_on_ipv6_alone(boards):
    udp = UdpServer(0, "::1")
    with running(udp) as agent:
        node = boards(agent.discovery.port)
        connected(node)
        assert node.connection.transport.agent == ("0:0:0:0:0:0:0:1", udp.port)


def test_an_agent_on_tcp_for_a_board_on_tcp(boards):
    tcp = TcpServer(0)
    with running(tcp) as agent:
        node = boards(agent.discovery.port, make=TcpTransport)
        connected(node)
        assert node.connection.transport.agent == (HERE, tcp.port)


def test_an_agent_with_a_port_that_does_not_answer_the_board(boards):
    """The agent offers a TCP and a UDP port without types, and the board tries both in turn."""
    with running(TcpServer(0), UdpServer(0)) as agent:
        node = boards(agent.discovery.port, make=TcpTransport)
        connected(node)
        assert node.connection.connections == 1
