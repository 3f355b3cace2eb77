"""A real agent that is attacked until it should run out of memory or descriptors: it holds what it
declared, the others are served, and afterwards all is as before."""

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
    def __init__(self, it):
        self.it = it
        self.process = psutil.Process(it.popen.pid)
        self.udp = int(it.until(r"UDPv4Agent .*port: (\d+)")[1])
        self.tcp = int(it.until(r"TCPv4Agent .*port: (\d+)")[1])
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
        one = XrceClient(line, key, **more)
        assert one.open() == ids.STATUS_OK
        return one

    def served(self):
        """The one that means well has its samples, and soon: by the agent's own time, as the
        machine may be busy with something else."""
        before = sum(self.process.cpu_times()[:2])
        self.count += 1
        sample = self.count.to_bytes(4, "big")
        self.good.write(self.writer, sample)
        assert self.good.sample(self.reader) == sample
        assert self.good.ping() == 1
        assert sum(self.process.cpu_times()[:2]) - before < 3
        assert self.it.popen.poll() is None

    def rss(self):
        return self.process.memory_info().rss

    def fds(self):
        return self.process.num_fds()


@contextmanager
def attacked(*options):
    with process("udp4", "--port", "0", *options, "tcp4", "--port", "0", "-v", "4") as it:
        one = Agent(it)
        try:
            yield one
            one.served()
            # What it says is read, or it would be lost.
            assert one.it.end() == 0
            assert "internal error" not in one.it.text, one.it.text[-3000:]
            assert "Traceback" not in one.it.text
        finally:
            for line in one.lines:
                line.close()


def flood(agent, datagrams, every=50):
    """Send them all; now and then the one that means well is asked for."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sock:
        sock.connect(("127.0.0.1", agent.udp))
        for number, datagram in enumerate(datagrams):
            sock.send(datagram)
            if number % every == every - 1:
                assert agent.good.ping() == 1  # and so the agent keeps up


# --- memory -----------------------------------------------------------------------------------


def test_ten_thousand_half_open_sessions():
    with attacked("-m", "memory") as agent:
        before = agent.rss()
        flood(agent, (create_client(key, session_id=0x01) for key in range(1, 10_001)), 100)
        agent.served()
        assert agent.rss() - before < 64 * MB
        late = agent.client(0x1A7E)  # newcomers find room, and those that made something stay
        assert late.writer("late", "rt/late", TYPE)


def test_fragments_that_never_end_of_two_hundred_clients():
    """1.6 GB, were each given its 8 MiB."""
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
        agent.it.read()
        assert "memory used up" in agent.it.text


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


def test_answers_and_objects_that_nobody_wants():
    """Objects with long representations, and questions about them without an acknowledgement."""
    with attacked("-m", "memory", "--max-memory", "24", "--max-objects", "200") as agent:
        before = agent.rss()
        fat = "<types><struct name='a'/></types>" + " " * 30_000

        def datagrams():
            for key in range(1, 61):
                yield create_client(key, session_id=0x01, mtu=65507)
                for number in range(30):
                    # Acknowledged all the time, as only the statuses would be kept else.
                    things = [create(oid(number, 10), ids.AS_XML, fat, 0)]
                    yield message(things, 0x80, number, 0x01, key)
                    yield message([acknack(number)], 0, 0, 0x01, key)

        flood(agent, datagrams(), 10)
        agent.served()
        assert agent.rss() - before < 24 * MB + 48 * MB


def test_slow_tcp_readers():
    """They ask for samples and read none."""
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
        for _ in range(150):  # 270 MB, were all kept
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
        held = []
        for _ in range(60):
            sock = socket.create_connection(("127.0.0.1", agent.tcp), SECONDS)
            held.append(stack.enter_context(sock))
        agent.it.until("cannot accept .*LimitNOFILE")
        agent.served()
        assert agent.it.text.count("cannot accept") < 10
        for sock in held:
            # A reset: what was not accepted yet leaves the queue too.
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


@pytest.mark.parametrize("middleware", ["memory", "dds"])
def test_without_any_descriptor_boards_are_served(middleware, own_domain_id):
    """Not one more for anything: files of types, domains, connections, the log's."""
    with attacked("-m", middleware, "--domain", str(own_domain_id)) as agent:
        limit_descriptors(agent, 3)  # those that are open stay open
        for number in range(20):
            agent.served()
            other = agent.client(0x100 + number)
            node = other.participant("n")  # on the domain that is joined already
            assert node
            assert other.writer("n", f"rt/t{number}", "a::msg::dds_::A_")
            assert other.close() == ids.STATUS_OK
        sock = socket.socket()
        sock.settimeout(SECONDS)
        with sock:
            sock.connect(("127.0.0.1", agent.tcp))
            agent.it.until("cannot accept")
            agent.served()
            limit_descriptors(agent, 256)
            sock.sendall(framed(message([get_info()], 0, 0, 0x80)))
            assert sock.recv(100)


def test_a_serial_line_that_comes_back_when_no_descriptor_is_left(tmp_path):
    master, slave = os.openpty()
    link = tmp_path / "tty"
    link.symlink_to(os.ttyname(slave))
    with process("udp4", "--port", "0", "-m", "memory", "serial", "--dev", str(link)) as it:
        it.until("serial .*running|SerialAgent .*running|dev: ")
        it.popen.poll()
        pid = it.popen.pid
        resource.prlimit(pid, resource.RLIMIT_NOFILE, (3, HARD))
        os.close(master)
        os.close(slave)
        it.until("device lost")
        master, slave = os.openpty()
        link.unlink()
        link.symlink_to(os.ttyname(slave))
        it.until("errno: 24")
        resource.prlimit(pid, resource.RLIMIT_NOFILE, (256, HARD))
        it.until(r"(?s)errno: 24.*running")
        assert it.end() == 0
        assert "internal error" not in it.text
    os.close(master)
    os.close(slave)


@pytest.mark.parametrize("middleware", ["memory", "dds"])
def test_a_reader_that_keeps_all_and_never_reads_holds_a_part_of_the_memory(
    middleware, own_domain_id
):
    """316 samples of 1 MB: they made 355 MB, and stayed."""
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
        agent.it.read()
        assert "samples dropped" in agent.it.text


@pytest.mark.parametrize("kind", ["udp", "tcp"])
def test_all_sessions_there_are_from_one_socket(kind):
    """4,096 sessions with an object each: no board came in for five minutes after."""
    with attacked("-m", "memory") as agent:

        def datagrams():
            for key in range(1, 4201):
                yield create_client(key, session_id=0x01)
                yield message([participant(name=f"n{key}")], 0x80, 0, 0x01, key)

        if kind == "udp":
            flood(agent, datagrams(), 100)
            late(agent)
        else:
            with socket.create_connection(("127.0.0.1", agent.tcp)) as sock:
                for number, datagram in enumerate(datagrams()):
                    sock.send(framed(datagram))
                    if number % 100 == 0:
                        assert agent.good.ping() == 1
                        sock.recv(65536)
                late(agent)


def late(agent):
    """Boards come from other sockets of the same address, and stay."""
    clients = [agent.client(key) for key in range(0x1A7E, 0x1A7E + 20)]
    for one in clients:
        assert one.writer("late", "rt/late", TYPE)
    assert all(one.ping() == 1 for one in clients)
    agent.served()
