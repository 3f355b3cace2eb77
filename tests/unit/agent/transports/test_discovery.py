"""Discovery: boards search for the agent over real sockets on loopback, also by multicast."""

import errno
import io
import socket
import threading
from contextlib import contextmanager

import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.certificates import Authority
from support.client import XrceClient
from support.lines import SECONDS, UdpLine
from unit.agent.helpers import create_client, get_info, message, sub
from unit.agent.transports.faults import wait_for

from uros import addresses
from uros.agent.agent import Agent
from uros.agent.clock import Clock
from uros.agent.log import Log
from uros.agent.server import Server
from uros.agent.transports.base import TransportError
from uros.agent.transports.certificates import Certificates
from uros.agent.transports.discovery import (
    GROUP,
    MAX_ANSWERS,
    MAX_ANSWERS_IN_ALL,
    MAX_LOCATORS,
    SCAN_PAUSE,
    DiscoveryServer,
    answer_limit,
    read_question,
    write_answer,
)
from uros.agent.transports.memory import MemoryServer
from uros.agent.transports.tcp import TcpServer
from uros.agent.transports.tls import TlsServer
from uros.agent.transports.udp import UdpServer
from uros.middleware.memory import MemoryMiddleware
from uros.wire import ids, session
from uros.wire.cdr import Reader
from uros.wire.errors import DecodeError
from uros.wire.header import pull_header, pull_subheader

# Recorded: the example Discovery of eProsima's client 2.4.3.
C_QUESTION = bytes.fromhex("80 00 0000 02 01 0800 0009 fffd 03000000")
# The C++ agent's, that looks for other agents (--p2p): it leaves the object's id empty.
P2P_QUESTION = message([sub(ids.GET_INFO, bytes.fromhex("0000 0000 02000000"))], 0, 0, 0x80)

LOOPBACK4, LOOPBACK6 = socket.inet_aton("127.0.0.1"), bytes(15) + b"\x01"


@pytest.fixture(autouse=True)
def loopback_only(monkeypatch):
    """Join the group on no network outside of this machine."""
    monkeypatch.setattr(addresses, "ipv4_by_interface", lambda: {"lo": "127.0.0.1"})


class Running:
    def __init__(self, transports, port=0):
        self.said = io.StringIO()
        self.discovery = DiscoveryServer(transports, port)
        agent = Agent(MemoryMiddleware(), Log(4, self.said))
        self.server = Server(agent, [*transports, self.discovery])
        self.thread = threading.Thread(target=self.server.run, daemon=True)
        self.sockets = []

    def asker(self):
        sock = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        sock.settimeout(SECONDS)
        # Send to the group over loopback, whatever the machine's routes are.
        sock.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_IF, LOOPBACK4)
        self.sockets.append(sock)
        return sock

    def ask(self, where="127.0.0.1", question=C_QUESTION, sock=None):
        """Return the locators of the INFO that answers."""
        sock = sock or self.asker()
        sock.sendto(question, (where, self.discovery.port))
        return info(sock.recv(2000))[4]


def info(datagram):
    _, _, _, _, at = pull_header(datagram, len(datagram))
    kind, flags, start, stop = pull_subheader(datagram, at, len(datagram))
    assert kind == ids.INFO
    return session.pull_info(Reader(datagram, start, stop, bool(flags & 1)))


@contextmanager
def running(*transports, port=0):
    running_server = Running(list(transports), port)
    running_server.thread.start()
    assert running_server.server.ready.wait(SECONDS)
    try:
        yield running_server
    finally:
        running_server.server.stop()
        running_server.thread.join(SECONDS)
        for sock in running_server.sockets:
            sock.close()
    assert not running_server.thread.is_alive()
    assert "internal error" not in running_server.said.getvalue(), running_server.said.getvalue()


# --- questions and answers ---------------------------------------------------------------------


def test_the_c_clients_question():
    assert read_question(C_QUESTION, len(C_QUESTION)) == (0x80, 0, 9, ids.OBJECT_AGENT)


def test_an_answer_byte_by_byte():
    """By hand, from the order and sizes of the fields; it goes into the C client's 200 bytes."""
    answer = write_answer((0x80, 0, 9, 0xFFFD), [(b"\xc0\0\2\7", 8888), (bytes(16), 8889)])
    assert answer == bytes.fromhex(
        "80 00 0000 06 01 3c00"
        "0009 fffd 00 00 01 0d 58524345 0100 010f 00 01 0d 00 0100 0000 02000000"
        "01 c0000207 00 b822 02 00000000000000000000000000000000 000000 b9220000"
    ), answer.hex()
    longest = write_answer((0x00, 0xFFFFFFFF, 9, 0xFFFD), [(bytes(16), 8888)] * MAX_LOCATORS)
    assert len(longest) <= 200


@pytest.mark.parametrize("question", [C_QUESTION, P2P_QUESTION, message([get_info()], 0, 0, 0x00)])
def test_the_answer_has_the_ids_of_the_question(question):
    with running(UdpServer(0)) as agent_run:
        sock = agent_run.asker()
        sock.sendto(question, ("127.0.0.1", agent_run.discovery.port))
        answer = sock.recv(2000)
        head = 8 if question[0] == 0 else 4
        assert answer[:head] == question[:head]  # session, stream, number, and key
        assert answer[head + 4 : head + 8] == question[head + 4 : head + 8]  # request and object
        assert agent_run.discovery.faults == 0


def test_a_big_endian_question():
    payload = bytes.fromhex("0009 fffd 00000003")
    datagram = bytes([0x80, 0, 0, 0, ids.GET_INFO, 0, 8, 0]) + payload
    assert read_question(datagram, len(datagram)) == (0x80, 0, 9, ids.OBJECT_AGENT)


@given(st.binary(max_size=64) | st.binary(max_size=40).map(lambda rest: C_QUESTION[:8] + rest))
def test_any_question_is_answered_or_ignored(datagram):
    try:
        question = read_question(datagram, len(datagram))
    except DecodeError:
        return
    answer = write_answer(question, [(bytes(4), 1), (bytes(16), 65535)])
    assert info(answer)[:2] == question[2:]
    try:
        read_question(answer, len(answer))
    except DecodeError:
        return
    raise AssertionError("two agents would answer each other for ever")


# --- where the agent is --------------------------------------------------------------------------


def test_questions_to_the_group_and_to_the_address_get_the_same_answer():
    udp = UdpServer(0)
    with running(udp) as agent_run:
        assert agent_run.ask(GROUP) == agent_run.ask("127.0.0.1") == [(LOOPBACK4, udp.port)]


def test_the_announced_address_serves_boards():
    udp = UdpServer(0, "::")
    with running(udp) as agent_run:
        ((address, port),) = agent_run.ask(GROUP)
        line = UdpLine(port, socket.inet_ntop(socket.AF_INET6, address))
        client = XrceClient(line, 7)
        assert client.open() == ids.STATUS_OK and client.close() == ids.STATUS_OK
        line.close()


def test_udp_comes_before_tcp_and_ipv4_before_ipv6():
    udp_servers = UdpServer(0, "::"), UdpServer(0)
    with running(TcpServer(0, "::"), TcpServer(0), *udp_servers) as agent_run:
        locators = agent_run.ask()
        assert [address for address, _ in locators] == [LOOPBACK4, LOOPBACK6] * 2
        assert [port for _, port in locators[:2]] == [udp_servers[1].port, udp_servers[0].port]


def test_udp_and_tcp_on_one_port_are_one_locator():
    server = DiscoveryServer([UdpServer(8888), TcpServer(8888), TcpServer(8889)])
    locators = server.locators(("127.0.0.1", 9))
    assert locators == [(LOOPBACK4, 8888), (LOOPBACK4, 8889)]


def test_a_port_with_tls_is_not_announced(tmp_path):
    authority = Authority(tmp_path)
    tls = TlsServer(8889, "0.0.0.0", Certificates(*authority.agent(), authority.ca))
    server = DiscoveryServer([tls, TcpServer(8888)])
    assert server.locators(("127.0.0.1", 9)) == [(LOOPBACK4, 8888)]


def test_no_more_locators_than_a_c_client_has_room_for():
    server = DiscoveryServer([UdpServer(8888 + i) for i in range(MAX_LOCATORS + 1)])
    assert len(server.locators(("127.0.0.1", 9))) == MAX_LOCATORS


def locators(listens_on, asker, own_address, monkeypatch):
    monkeypatch.setattr(addresses, "own_address", lambda _: own_address)
    interfaces = {"lo": "127.0.0.1", "e": "192.0.2.2"}
    monkeypatch.setattr(addresses, "ipv4_by_interface", lambda: interfaces)
    monkeypatch.setattr(addresses, "ipv6_of", {"e": "2001:db8::2", None: "2001:db8::3"}.get)
    addresses_and_ports = DiscoveryServer([UdpServer(8888, listens_on)]).locators((asker, 1))
    assert all(port == 8888 for _, port in addresses_and_ports)
    family = socket.AF_INET6 if ":" in listens_on else socket.AF_INET
    return [socket.inet_ntop(family, address) for address, _ in addresses_and_ports]


@pytest.mark.parametrize(
    ("listens_on", "asker", "own_address", "expected"),
    [
        ("0.0.0.0", "192.0.2.7", "192.0.2.2", ["192.0.2.2"]),
        ("0.0.0.0", "127.0.0.1", "127.0.0.1", ["127.0.0.1"]),
        ("0.0.0.0", "192.0.2.2", "192.0.2.2", ["192.0.2.2"]),
        ("0.0.0.0", "198.51.100.7", None, []),
        ("127.0.0.1", "192.0.2.7", "192.0.2.2", []),
        ("127.0.0.1", "127.0.0.1", "127.0.0.1", ["127.0.0.1"]),
        ("127.0.0.1", "192.0.2.2", "192.0.2.2", ["127.0.0.1"]),
        ("198.51.100.2", "192.0.2.7", "192.0.2.2", ["198.51.100.2"]),
        ("::", "192.0.2.7", "192.0.2.2", ["2001:db8::2"]),
        ("::", "192.0.2.7", "192.0.2.99", ["2001:db8::3"]),
        ("::", "127.0.0.1", "127.0.0.1", ["::1"]),
        ("::1", "192.0.2.7", "192.0.2.2", []),
        ("::1", "127.0.0.1", "127.0.0.1", ["::1"]),
        ("2001:db8::2", "192.0.2.7", "192.0.2.2", ["2001:db8::2"]),
        ("fe80::1%e", "192.0.2.7", "192.0.2.2", []),
    ],
)
def test_the_announced_address_for_each_asker(
    listens_on, asker, own_address, expected, monkeypatch
):
    assert locators(listens_on, asker, own_address, monkeypatch) == expected


def test_without_a_network_transport_questions_get_no_answer():
    with running(MemoryServer()) as agent_run:
        sock = agent_run.asker()
        sock.sendto(C_QUESTION, ("127.0.0.1", agent_run.discovery.port))
        sock.sendto(b"x", ("127.0.0.1", agent_run.discovery.port))
        wait_for(agent_run.said.getvalue, "not a question for agents")
        sock.setblocking(False)
        with pytest.raises(BlockingIOError):
            sock.recv(100)
        assert "nothing to discover" in agent_run.said.getvalue()


# --- neighbours on the port --------------------------------------------------------------------


def neighbour(port, group=None):
    """Return a socket as DDS has in domain 0: on the same port, of another group."""
    sock = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    sock.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    sock.bind(("0.0.0.0", port))
    if group:
        membership = socket.inet_aton(group) + LOOPBACK4
        sock.setsockopt(socket.IPPROTO_IP, socket.IP_ADD_MEMBERSHIP, membership)
    sock.settimeout(SECONDS)
    return sock


def test_a_dds_participant_on_the_port_does_not_disturb_discovery():
    udp = UdpServer(0)
    with running(udp) as agent_run, neighbour(agent_run.discovery.port, "239.255.0.1") as dds:
        sock = agent_run.asker()
        sock.sendto(b"RTPS\2\5\1\x10" + bytes(40), ("239.255.0.1", agent_run.discovery.port))
        assert dds.recv(100).startswith(b"RTPS")
        assert agent_run.ask("127.0.0.1") == agent_run.ask(GROUP) == [(LOOPBACK4, udp.port)]
        assert agent_run.discovery.faults == 0


def test_two_agents_on_the_port_are_both_found_in_the_group():
    with running(UdpServer(0)) as first, running(UdpServer(0), port=first.discovery.port) as second:
        sock = first.asker()
        sock.sendto(C_QUESTION, (GROUP, first.discovery.port))
        locators = [info(sock.recv(2000))[4][0] for _ in range(2)]
        ports = {agent_run.discovery._servers[0].port for agent_run in (first, second)}
        assert {port for _, port in locators} == ports and len(ports) == 2


def test_a_port_that_is_not_shared_names_the_remedy():
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as port_owner:
        port_owner.bind(("0.0.0.0", 0))
        port = port_owner.getsockname()[1]
        with pytest.raises(TransportError) as caught:
            DiscoveryServer([], port).open(None)
    assert f"UDP port {port} is in use" in str(caught.value)
    assert "choose another port with --discovery" in str(caught.value)


# --- interfaces ----------------------------------------------------------------------------------


def test_the_log_has_port_group_and_interfaces():
    with running(UdpServer(0)) as agent_run:
        log = agent_run.said.getvalue()
        where = f"port: {agent_run.discovery.port}, group: {GROUP}, interfaces: lo (127.0.0.1)"
        assert "DiscoveryServer" in log and where in log
        assert "only this machine can find the agent" in log


class Host:
    """A server that records the calls of its transport."""

    clock = Clock()

    def __init__(self):
        self.watched, self.calls, self.said = set(), [], []

    def watch(self, fileno, ready, writing=False):
        self.watched.add(fileno)

    def unwatch(self, fileno):
        self.watched.remove(fileno)

    def wake_at(self, seconds, call):
        assert seconds == SCAN_PAUSE
        self.calls.append(call)

    def note(self, level, part, function, event, about):
        self.said.append((event, about))


@pytest.fixture
def opened(monkeypatch):
    """A server that finds ``interfaces`` at each ``scan()``."""
    interfaces = {"lo": "127.0.0.1"}
    monkeypatch.setattr(addresses, "ipv4_by_interface", lambda: dict(interfaces))
    host, server = Host(), DiscoveryServer([UdpServer(0)], 0)
    server.open(host)
    server.interfaces = interfaces
    server.scan = lambda: host.calls.pop()()
    yield host, server
    server.close()
    server.close()
    assert host.watched == set()


def test_interfaces_that_appear_and_disappear(opened):
    host, server = opened
    host.said.clear()
    server.interfaces["lo2"] = "127.0.0.2"
    server.scan()
    assert host.said == [("interface found", "lo2 (127.0.0.2)")] and len(host.watched) == 3
    del server.interfaces["lo"]
    server.interfaces["lo2"] = "127.0.0.3"
    server.scan()
    assert ("interface lost", "lo (127.0.0.1)") in host.said
    assert len(host.watched) == 2 and server._own["lo2"][0] == "127.0.0.3"
    host.said.clear()
    server.scan()
    assert host.said == []


def test_an_interface_without_multicast_is_named_once_and_tried_again(opened, monkeypatch):
    host, server = opened
    server.interfaces["wlan0"] = "192.0.2.55"  # no interface of ours has it: ENODEV
    for _ in range(3):
        server.scan()
    notes = [about for event, about in host.said if event == "no multicast"]
    assert len(notes) == 1 and "wlan0 (192.0.2.55)" in notes[0] and "ip route add" in notes[0]
    server.interfaces["wlan0"] = "127.0.0.9"
    server.scan()
    assert ("interface found", "wlan0 (127.0.0.9)") in host.said


def test_a_lost_membership_is_renewed(opened):
    host, server = opened
    membership = socket.inet_aton(GROUP) + LOOPBACK4
    server._group.setsockopt(socket.IPPROTO_IP, socket.IP_DROP_MEMBERSHIP, membership)
    server.scan()
    with pytest.raises(OSError) as caught:  # the socket is in the group
        server._group.setsockopt(socket.IPPROTO_IP, socket.IP_ADD_MEMBERSHIP, membership)
    assert caught.value.errno == errno.EADDRINUSE


def test_interfaces_are_not_scanned_after_close(opened):
    host, server = opened
    server.close()
    server.scan()
    assert host.calls == [] and host.watched == set()


def test_no_interface_at_all(monkeypatch):
    monkeypatch.setattr(addresses, "ipv4_by_interface", dict)
    host, server = Host(), DiscoveryServer([UdpServer(0)], 0)
    server.open(host)
    assert "interfaces: none" in host.said[0][1]
    assert host.said[1][0] == "only this machine can find the agent"
    server.close()


# --- hostile askers -----------------------------------------------------------------------------


def test_answers_to_one_address_are_limited():
    limit = answer_limit()
    assert sum(limit.take("192.0.2.1", 5.0) for _ in range(900)) == MAX_ANSWERS
    assert limit.take("192.0.2.2", 5.0)
    assert sum(limit.take("192.0.2.1", 6.0) for _ in range(900)) == MAX_ANSWERS


def test_answers_to_all_addresses_are_limited_and_so_is_their_memory():
    limit = answer_limit()
    assert sum(limit.take(str(i), 5.0) for i in range(9999)) == MAX_ANSWERS_IN_ALL
    assert len(limit) == MAX_ANSWERS_IN_ALL
    assert sum(limit.take(str(i), 6.0) for i in range(9999)) == MAX_ANSWERS_IN_ALL
    assert len(limit) <= 2 * MAX_ANSWERS_IN_ALL


def test_a_flood_of_questions_gets_a_limited_number_of_answers():
    now = [100.0]
    host, server = Host(), DiscoveryServer([UdpServer(8888)], 0)
    host.clock = Clock(lambda: now[0])
    server.open(host)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sock:
        sock.bind(("127.0.0.1", 0))

        def ask(times):
            for _ in range(times):
                sock.sendto(C_QUESTION, ("127.0.0.1", server.port))
            own = server._own["lo"][1]
            for _ in range(times // 64 + 1):
                server._drain(own)
            answers = 0
            sock.setblocking(False)
            try:
                while sock.recv(2000):
                    answers += 1
            except BlockingIOError:
                return answers

        assert ask(100) == MAX_ANSWERS
        assert ask(10) == 0
        now[0] += 1.0
        assert ask(10) == 10
    server.close()


BAD = {
    "nothing": b"",
    "a byte": b"\x80",
    "rtps": b"RTPS\2\5\1\x10" + bytes(60),
    "truncated": C_QUESTION[:-1],
    "in a session": message([get_info()], 0, 0, 0x81),
    "large": b"\x80" * 60_000,
    "another submessage": message([sub(ids.HEARTBEAT, bytes(5))], 0, 0, 0x80),
    "an info": write_answer((0x80, 0, 9, 0xFFFD), []),
}


@pytest.mark.parametrize("name", BAD)
def test_bad_datagrams_are_counted_and_the_next_is_answered(name):
    with running(UdpServer(0)) as agent_run:
        sock = agent_run.asker()
        for where in ("127.0.0.1", GROUP):
            sock.sendto(BAD[name], (where, agent_run.discovery.port))
            assert agent_run.ask(where, sock=sock)
        assert agent_run.discovery.faults == 2
        assert (
            agent_run.said.getvalue().count("not a question for agents") == 1
        )  # limited log lines


def test_a_create_client_on_the_discovery_port_is_logged_with_the_remedy():
    udp, tcp = UdpServer(0), TcpServer(0)
    with running(udp, tcp) as agent_run:
        agent_run.asker().sendto(create_client(7), ("127.0.0.1", agent_run.discovery.port))
        wait_for(agent_run.said.getvalue, "not a question for agents")
        assert f"boards talk to it at UDP {udp.port}, TCP {tcp.port}" in agent_run.said.getvalue()
        assert agent_run.server.agent.clients == {}


@given(st.lists(st.binary(max_size=80), max_size=20))
def test_any_datagrams(datagrams):
    with running(UdpServer(0)) as agent_run:
        sock = agent_run.asker()
        for datagram in datagrams:
            sock.sendto(datagram, ("127.0.0.1", agent_run.discovery.port))
        agent_run.ask(GROUP)


def test_send_of_the_discovery_server_does_nothing():
    server = DiscoveryServer([])
    server.send(("127.0.0.1", 9), b"x")
    assert server.address(("127.0.0.1", 9)) == "127.0.0.1:9" and server.sessions == {}
