"""IPv4 and IPv6 beside each other, and machines that have only one of them."""

import errno
import socket

import pytest
from support.agent import running_agent
from support.client import XrceClient
from support.lines import TcpLine, UdpLine

from uros.agent.transports import ip
from uros.agent.transports.base import TransportError
from uros.agent.transports.tcp import TcpServer
from uros.agent.transports.udp import UdpServer
from uros.wire import ids

SERVERS = {"udp": (UdpServer, UdpLine), "tcp": (TcpServer, TcpLine)}


class Host:
    def __init__(self):
        self.said = []

    def watch(self, *_):
        pass

    unwatch = watch

    def note(self, level, part, function, event, about):
        self.said.append((level, part, event, about))


@pytest.fixture(params=SERVERS)
def kind(request):
    return request.param


def test_both_families_on_one_port(kind):
    """Each socket receives its own family: no IPv4 client reaches the IPv6 socket."""
    make, line_of = SERVERS[kind]
    with running_agent(kind, "memory") as four:
        with running_agent(make(four.transport.port, "::"), "memory") as six:
            for agent, host, key in ((four, "127.0.0.1", 4), (six, "::1", 6)):
                line = line_of(four.transport.port, host)
                agent.lines.append(line)
                assert XrceClient(line, key).open() == ids.STATUS_OK
            assert list(four.agent.clients) == [4] and list(six.agent.clients) == [6]


def test_names_and_addresses_in_the_log(kind):
    for suffix, number, loopback in (("", 4, "127.0.0.1"), ("6", 6, "[::1]")):
        with running_agent(kind + suffix, "memory") as agent:
            line = agent.line()
            assert XrceClient(line, 7).open() == ids.STATUS_OK
            port = line._socket.getsockname()[1]
        log = agent.said.getvalue()
        assert f"{kind.upper()}v{number}Agent" in log
        assert f"address: {loopback}:{port}\n" in log, log


def test_an_address_in_its_usual_notation():
    assert ip.text_of(("192.0.2.7", 1)) == "192.0.2.7:1"
    assert ip.text_of(("2001:db8::7", 1, 0, 0)) == "[2001:db8::7]:1"
    assert ip.text_of(("fe80::7%eth0", 1, 0, 2)) == "[fe80::7%eth0]:1"


def test_a_port_in_use_says_what_to_do(kind):
    first = SERVERS[kind][0](0, "::1")
    first.open(Host())
    try:
        with pytest.raises(TransportError) as caught:
            SERVERS[kind][0](first.port, "::1").open(Host())
        assert "is in use" in str(caught.value) and "--port" in str(caught.value)
    finally:
        first.close()


@pytest.mark.parametrize("host", ["192.0.2.1", "2001:db8::1"])
def test_an_address_that_is_not_ours(kind, host):
    with pytest.raises(TransportError) as caught:
        SERVERS[kind][0](0, host).open(Host())
    everything = "::" if ":" in host else "0.0.0.0"
    assert str(caught.value).endswith(
        f"this machine has no address {host}: choose one that it has, or {everything} for all"
    )


def test_a_kernel_without_ipv6(kind, monkeypatch):
    """A kernel started with ipv6.disable=1, or built without IPv6."""
    real = socket.socket

    def only_ipv4(family, *rest):
        if family == socket.AF_INET6:
            raise OSError(errno.EAFNOSUPPORT, "Address family not supported by protocol")
        return real(family, *rest)

    monkeypatch.setattr(ip.socket, "socket", only_ipv4)
    with pytest.raises(TransportError) as caught:
        SERVERS[kind][0](0, "::").open(Host())
    assert "IPv6 is not available on this machine: turn it on" in str(caught.value)
    assert not ip.ipv6_works()
    server, host = SERVERS[kind][0](0), Host()
    server.open(host)
    server.close()
    assert [event for *_, event, _ in host.said] == ["running..."]


def test_ipv6_turned_off(kind, monkeypatch):
    """Turned off by sysctl: the agent can listen on ::, but no client can connect."""
    assert ip.ipv6_works()
    monkeypatch.setattr(ip, "ipv6_works", lambda: False)
    server, host = SERVERS[kind][0](0, "::"), Host()
    server.open(host)
    server.close()
    assert host.said[-1][2] == "nobody can reach this port" and "turn it on" in host.said[-1][3]
    with pytest.raises(TransportError, match="turn it on"):
        SERVERS[kind][0](0, "2001:db8::1").open(host)


def test_a_transport_can_be_opened_again(kind):
    server = SERVERS[kind][0](0, "::1")
    server.open(Host())
    port = server.port
    server.close()
    server.open(Host())
    assert server.port == port and server.listens_on == "::1"
    server.close()


def test_sending_where_nothing_can_be_sent():
    server = UdpServer(0, "::1")
    server.open(Host())
    for peer in (("::1", 0, 0, 0), ("2001:db8::1", 9, 0, 0), ("fe80::1", 9, 0, 0)):
        server.send(peer, b"x")
    server.send(("::1", 9, 0, 0), bytes(70_000))
    server.close()
