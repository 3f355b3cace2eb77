"""Attacks on the memory and descriptors of a real agent.

The agent stays within its declared limits, other clients are served, and resources are freed
afterwards.
"""

import os
import resource
import socket
import struct
import sys
import time
from contextlib import ExitStack, contextmanager

import psutil
import pytest
from support.client import XrceClient
from support.lines import SECONDS, TcpLine, UdpLine
from support.variants import slow_except
from unit.agent.helpers import (
    acknack,
    create,
    create_client,
    endpoint,
    fragment,
    get_info,
    group,
    message,
    oid,
    participant,
    read_data,
    topic,
)
from unit.agent.transports.test_process import agent as process
from unit.agent.transports.test_tcp import framed

from uros.wire import ids

TYPE = "std_msgs::msg::dds_::UInt8MultiArray_"
MB = 1024 * 1024

pytestmark = pytest.mark.skipif(
    sys.platform != "linux", reason="not on this platform: the limits of a process are Linux's"
)


class Agent:
    def __init__(self, process):
        self.agent_process = process
        self.process = psutil.Process(process.popen.pid)
        self.udp = int(process.until(r"UDPv4Agent .*port: (\d+)")[1])
        self.tcp = int(process.until(r"TCPv4Agent .*port: (\d+)")[1])
        self.lines = []
        self.good = self.client(0x600D)
        self.writer = self.good.writer("good", "rt/good", TYPE)
        self.reader = self.good.reader("good", "rt/good", TYPE)
        self.good.read(self.reader)
        self.count = 0
        self.served()

    def client(self, key, kind=UdpLine, **more):
        line = kind(self.udp if kind is UdpLine else self.tcp)
        self.lines.append(line)
        xrce_client = XrceClient(line, key, **more)
        assert xrce_client.open() == ids.STATUS_OK
        return xrce_client

    def served(self):
        """Test that the honest client gets its samples within a limited CPU time of the agent; the
        machine may be busy with something else."""
        before = sum(self.process.cpu_times()[:2])
        self.count += 1
        sample = self.count.to_bytes(4, "big")
        self.good.write(self.writer, sample)
        assert self.good.sample(self.reader) == sample
        assert self.good.ping() == 1
        assert sum(self.process.cpu_times()[:2]) - before < 3
        assert self.agent_process.popen.poll() is None

    def rss(self):
        return self.process.memory_info().rss

    def fds(self):
        return self.process.num_fds()


@contextmanager
def attacked(*options):
    with process(
        "udp4", "--port", "0", *options, "tcp4", "--port", "0", "-v", "4"
    ) as agent_process:
        agent = Agent(agent_process)
        try:
            yield agent
            agent.served()
            # The output is read, or it would be lost.
            assert agent.agent_process.end() == 0
            assert "internal error" not in agent.agent_process.text, agent.agent_process.text[
                -3000:
            ]
            assert "Traceback" not in agent.agent_process.text
        finally:
            for line in agent.lines:
                line.close()


def flood(agent, datagrams, every=50):
    """Send all datagrams; now and then the honest client sends a ping."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sock:
        sock.connect(("127.0.0.1", agent.udp))
        for number, datagram in enumerate(datagrams):
            sock.send(datagram)
            if number % every == every - 1:
                assert agent.good.ping() == 1  # so the agent keeps up with the flood


# --- memory -----------------------------------------------------------------------------------


def test_ten_thousand_half_open_sessions():
    with attacked("-m", "memory") as agent:
        before = agent.rss()
        flood(agent, (create_client(key, session_id=0x01) for key in range(1, 10_001)), 100)
        agent.served()
        assert agent.rss() - before < 64 * MB
        late_client = agent.client(
            0x1A7E
        )  # new clients are admitted, and clients with objects stay
        assert late_client.writer("late", "rt/late", TYPE)


def test_endless_fragments_of_two_hundred_clients():
    """They would take 1.6 GB if each client got its 8 MiB."""
    with attacked("-m", "memory", "--max-memory", "32") as agent:
        before = agent.rss()

        def datagrams():
            for key in range(1, 201):
                yield create_client(key, session_id=0x01, mtu=65507)
            for number in range(16):
                for key in range(1, 201):
                    yield message([fragment(bytes(60_000))], 0x80, number, 0x01, key)

        flood(agent, datagrams(), 10)
        agent.served()
        assert agent.rss() - before < 32 * MB + 48 * MB
        agent.agent_process.read()
        assert "memory used up" in agent.agent_process.text


def test_early_messages_of_many_clients():
    with attacked("-m", "memory", "--max-memory", "32") as agent:
        before = agent.rss()

        def datagrams():
            for key in range(1, 201):
                yield create_client(key, session_id=0x01, mtu=65507)
                for number in range(1, 16):
                    yield message([get_info(), fragment(bytes(60_000))], 0x80, number, 0x01, key)

        flood(agent, datagrams(), 10)
        agent.served()
        assert agent.rss() - before < 32 * MB + 48 * MB


def test_answers_without_acknowledgement_and_large_objects():
    """Objects with long representations, and GET_INFO about them without acknowledgement."""
    with attacked("-m", "memory", "--max-memory", "24", "--max-objects", "200") as agent:
        before = agent.rss()
        fat = "<types><struct name='a'/></types>" + " " * 30_000

        def datagrams():
            for key in range(1, 61):
                yield create_client(key, session_id=0x01, mtu=65507)
                for number in range(30):
                    # Acknowledged continually, as otherwise only the statuses would be kept.
                    submessages = [create(oid(number, 10), ids.AS_XML, fat, 0)]
                    yield message(submessages, 0x80, number, 0x01, key)
                    yield message([acknack(number)], 0, 0, 0x01, key)

        flood(agent, datagrams(), 10)
        agent.served()
        assert agent.rss() - before < 24 * MB + 48 * MB


def test_slow_tcp_readers():
    """Clients request samples and read none."""
    with attacked("-m", "memory") as agent, ExitStack() as stack:
        before = agent.rss()
        for number in range(30):
            sock = stack.enter_context(socket.socket())
            sock.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
            sock.connect(("127.0.0.1", agent.tcp))
            key = 0x700 + number
            entities = [
                participant(), topic(name="rt/big", type_name=TYPE),
                group(oid(1, ids.KIND_SUBSCRIBER)),
                endpoint(oid(1, 6), parent=oid(1, 4), qos=ids.QOS_KEEP_LAST),
                read_data(oid(1, 6), stream=ids.STREAM_BEST_EFFORT),
            ]  # fmt: skip
            sock.sendall(framed(create_client(key, mtu=65000)))
            sock.sendall(framed(message(entities, 0x80, 0, 0x81, key)))
        agent.served()
        writer = agent.good.writer("good", "rt/big", TYPE)
        agent.good.mtu = 60_000
        for _ in range(150):  # 270 MB if all were kept
            agent.good.write(writer, bytes(50_000), stream=ids.STREAM_BEST_EFFORT)
            assert agent.good.ping() == 1
        agent.served()
        assert agent.rss() - before < 64 * MB + 48 * MB


# --- descriptors ----------------------------------------------------------------------------------


# Only root may raise the hard limit again.
HARD = resource.getrlimit(resource.RLIMIT_NOFILE)[1] if sys.platform == "linux" else 0


def limit_descriptors(agent, number):
    resource.prlimit(agent.process.pid, resource.RLIMIT_NOFILE, (number, HARD))


def test_connections_until_no_descriptor_is_left_and_back():
    with attacked("-m", "memory") as agent, ExitStack() as stack:
        before = agent.fds()
        limit_descriptors(agent, before + 20)
        connections = []
        for _ in range(60):
            sock = socket.create_connection(("127.0.0.1", agent.tcp), SECONDS)
            connections.append(stack.enter_context(sock))
        agent.agent_process.until("cannot accept .*LimitNOFILE")
        agent.served()
        assert agent.agent_process.text.count("cannot accept") < 10
        for sock in connections:
            # A reset also removes connections that were not accepted yet.
            sock.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
            sock.close()
        again = agent.client(0xACE, TcpLine)
        assert again.writer("again", "rt/again", TYPE)
        again.line.close()
        agent.lines.remove(again.line)
        deadline = time.monotonic() + SECONDS
        while agent.fds() > before + 1:
            assert time.monotonic() < deadline
            assert agent.good.ping() == 1


@pytest.mark.parametrize("middleware", ["memory", pytest.param("dds", marks=pytest.mark.cyclone)])
def test_without_any_descriptor_boards_are_served(middleware, own_domain_id):
    """No descriptor is left for files of types, domains, connections or the log."""
    with attacked("-m", middleware, "--domain", str(own_domain_id)) as agent:
        limit_descriptors(agent, 3)  # open descriptors stay open
        for number in range(20):
            agent.served()
            new_client = agent.client(0x100 + number)
            node = new_client.participant("n")  # on the domain that the agent has joined already
            assert node
            assert new_client.writer("n", f"rt/t{number}", "a::msg::dds_::A_")
            assert new_client.close() == ids.STATUS_OK
        sock = socket.socket()
        sock.settimeout(SECONDS)
        with sock:
            sock.connect(("127.0.0.1", agent.tcp))
            agent.agent_process.until("cannot accept")
            agent.served()
            limit_descriptors(agent, 256)
            sock.sendall(framed(message([get_info()], 0, 0, 0x80)))
            assert sock.recv(100)


def test_a_serial_line_that_comes_back_when_no_descriptor_is_left(tmp_path):
    master, slave = os.openpty()
    link = tmp_path / "tty"
    link.symlink_to(os.ttyname(slave))
    with process(
        "udp4", "--port", "0", "-m", "memory", "serial", "--dev", str(link)
    ) as agent_process:
        agent_process.until("serial .*running|SerialAgent .*running|dev: ")
        agent_process.popen.poll()
        pid = agent_process.popen.pid
        resource.prlimit(pid, resource.RLIMIT_NOFILE, (3, HARD))
        os.close(master)
        os.close(slave)
        agent_process.until("device lost")
        master, slave = os.openpty()
        link.unlink()
        link.symlink_to(os.ttyname(slave))
        agent_process.until("errno: 24")
        resource.prlimit(pid, resource.RLIMIT_NOFILE, (256, HARD))
        agent_process.until(r"(?s)errno: 24.*running")
        assert agent_process.end() == 0
        assert "internal error" not in agent_process.text
    os.close(master)
    os.close(slave)


@pytest.mark.parametrize(
    "middleware", ["memory", pytest.param("dds", marks=[pytest.mark.cyclone, pytest.mark.slow])]
)
def test_a_reader_that_keeps_all_and_never_reads_holds_a_part_of_the_memory(
    middleware, own_domain_id
):
    """316 samples of 1 MB took 355 MB for good before the limit existed."""
    options = "-m", middleware, "--domain", str(own_domain_id), "--max-memory", "64"
    with attacked(*options) as agent:
        bad = agent.client(0xBAD)
        reader = bad.reader("bad", "rt/much", TYPE, qos=ids.QOS_RELIABLE)
        writer = agent.client(0x5E4D, mtu=60_000)
        topic = writer.writer("much", "rt/much", TYPE)
        writer.write(topic, bytes(MB))
        before = agent.rss()
        for _ in range(315):
            writer.write(topic, bytes(MB))
        assert agent.rss() - before < 64 * MB
        agent.served()
        assert bad.delete(reader) == ids.STATUS_OK
        agent.agent_process.read()
        assert "samples dropped" in agent.agent_process.text


@pytest.mark.parametrize("kind", slow_except(["udp", "tcp"], "udp"))
def test_all_sessions_from_one_socket(kind):
    """4,096 sessions with an object each must not keep boards out, as they did for five minutes."""
    with attacked("-m", "memory") as agent:

        def datagrams():
            for key in range(1, 4201):
                yield create_client(key, session_id=0x01)
                yield message([participant(name=f"n{key}")], 0x80, 0, 0x01, key)

        if kind == "udp":
            flood(agent, datagrams(), 100)
            check_late_clients(agent)
        else:
            with socket.create_connection(("127.0.0.1", agent.tcp)) as sock:
                for number, datagram in enumerate(datagrams()):
                    sock.send(framed(datagram))
                    if number % 100 == 0:
                        assert agent.good.ping() == 1
                        sock.recv(65536)
                check_late_clients(agent)


def check_late_clients(agent):
    """Test that boards from other sockets of the same address are admitted and stay."""
    clients = [agent.client(key) for key in range(0x1A7E, 0x1A7E + 20)]
    for client in clients:
        assert client.writer("late", "rt/late", TYPE)
    assert all(client.ping() == 1 for client in clients)
    agent.served()
