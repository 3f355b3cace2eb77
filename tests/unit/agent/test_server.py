"""The thread of the agent: timers, several transports, stalls, and faults of one client."""

import io
import os
import socket
import struct
import threading
import time
from contextlib import contextmanager

import pytest
from support.agent import running_agent
from support.client import XrceClient
from support.lines import SECONDS, TcpLine, UdpLine
from unit.agent.helpers import fragment, get_info, heartbeat, message, write_data
from unit.agent.transports.faults import wait_for

from uros.agent.agent import Agent
from uros.agent.log import Log
from uros.agent.persistence.journal import open_journal
from uros.agent.persistence.session_store import SessionStore
from uros.agent.server import Server
from uros.agent.transports.base import TransportError
from uros.agent.transports.tcp import TcpServer
from uros.agent.transports.udp import UdpServer
from uros.middleware.base import MiddlewareError
from uros.middleware.memory import MemoryMiddleware, MemoryWriter
from uros.wire import ids

TYPE = "std_msgs::msg::dds_::UInt8MultiArray_"


class Running:
    def __init__(self, level=4):
        self.said = io.StringIO()
        self.middleware = MemoryMiddleware()
        self.udp, self.tcp = UdpServer(0, "127.0.0.1"), TcpServer(0, "127.0.0.1")
        self.agent = Agent(self.middleware, Log(level, self.said))
        self.server = Server(self.agent, [self.udp, self.tcp])
        self.thread = threading.Thread(target=self.server.run, daemon=True)
        self.lines = []

    def client(self, key, transport="udp", **more):
        line = UdpLine(self.udp.port) if transport == "udp" else TcpLine(self.tcp.port)
        self.lines.append(line)
        xrce_client = XrceClient(line, key, **more)
        assert xrce_client.open() == ids.STATUS_OK
        return xrce_client

    def call(self, function):
        """Run a function in the server's thread; return its result."""
        done, out = threading.Event(), []

        def run():
            try:
                out.append(function())
            finally:
                done.set()

        self.server.wake_at(0.0, run)
        self.server._wake.set()
        # The timer heap is checked when the next turn begins; a second wake begins it.
        while not done.wait(0.05):
            self.server._wake.set()
        return out[0] if out else None

    @contextmanager
    def paused(self):
        """Hold the server's thread inside the block: what arrives belongs to one turn."""
        stands, go_on = threading.Event(), threading.Event()

        def stand():
            stands.set()
            go_on.wait(SECONDS)

        self.server.soon(stand)
        assert stands.wait(SECONDS)
        try:
            yield
        finally:
            go_on.set()


@contextmanager
def running(**more):
    agent_run = Running(**more)
    agent_run.thread.start()
    assert agent_run.server.ready.wait(SECONDS)
    try:
        yield agent_run
    finally:
        agent_run.server.stop()
        agent_run.thread.join(SECONDS)
        for line in agent_run.lines:
            line.close()
        assert not agent_run.thread.is_alive()


@pytest.fixture
def server():
    with running() as agent_run:
        yield agent_run
        assert "internal error" not in agent_run.said.getvalue()


def test_boards_on_several_transports_exchange_samples(server):
    first, second = server.client(1), server.client(2, "tcp")
    writer = first.writer("a", "rt/a", TYPE)
    reader = second.reader("b", "rt/a", TYPE)
    second.read(reader)
    first.write(writer, b"over the bridge")
    assert second.sample(reader) == b"over the bridge"
    assert second.line.fd >= 0 and second.close() == 0
    first.write(writer, b"nobody")


def test_only_a_sample_for_a_board_starts_busy_polling(server, monkeypatch):
    expected = []
    monkeypatch.setattr(server.server._busy_poll, "expect_answer", lambda: expected.append(1))
    board = server.client(1)
    writer = board.writer("a", "rt/a", TYPE)
    board.write(writer, b"nobody reads it")
    reader = board.reader("b", "rt/a", TYPE)
    board.read(reader)
    assert board.ping() and not expected
    board.write(writer, b"back to the board")
    assert board.sample(reader) == b"back to the board"
    assert board.ping()  # the turn that sent the sample has ended
    assert expected == [1]


def test_with_state_acknowledged_samples_are_delivered_before_shutdown(monkeypatch, tmp_path):
    monkeypatch.setattr(MemoryMiddleware, "dispatch_local", lambda self: None)
    write = MemoryWriter.write

    def write_and_end(self, cdr):
        agent_run.server.stop()  # a signal, before the sample is delivered to its reader
        return write(self, cdr)

    monkeypatch.setattr(MemoryWriter, "write", write_and_end)
    agent_run = Running()
    journal = open_journal(str(tmp_path / "state"))
    agent_run.server.attachments.append(SessionStore(journal, agent_run.agent.log))
    agent_run.thread.start()
    assert agent_run.server.ready.wait(SECONDS)
    first, second = agent_run.client(1), agent_run.client(2)
    writer, reader = first.writer("a", "rt/a", TYPE), second.reader("b", "rt/a", TYPE)
    second.read(reader)
    first.write(writer, b"the last one")  # the sample is acknowledged
    agent_run.thread.join(SECONDS)
    assert second.sample(reader) == b"the last one"
    for line in agent_run.lines:
        line.close()


def test_a_key_in_the_header_moves_between_addresses_of_one_transport(server):
    client = server.client(0x0A0B, session_id=0x05)
    writer, reader = client.writer("a", "rt/a", TYPE), client.reader("a", "rt/a", TYPE)
    client.read(reader)
    client.line = UdpLine(server.udp.port)
    server.lines.append(client.line)
    client.write(writer, b"from elsewhere")
    assert client.sample(reader) == b"from elsewhere"


def test_a_key_in_the_header_does_not_move_to_another_transport(server):
    client = server.client(0x0A0C, session_id=0x05)
    client.participant("a")
    client.line = TcpLine(server.tcp.port)
    server.lines.append(client.line)
    client._put(ids.GET_INFO, get_info()[2], ids.STREAM_NONE, ids.FLAG_LITTLE_ENDIAN)
    wait_for(server.said.getvalue, "unknown session")
    assert server.agent.place(0x0A0C)[0] is server.udp
    assert client.open() == ids.STATUS_OK  # a new session, without its objects
    assert server.agent.place(0x0A0C)[0] is server.tcp
    assert not server.agent.clients[0x0A0C].objects


def test_heartbeats_follow_the_clock(server):
    client = server.client(3)
    writer, reader = client.writer("a", "rt/a", TYPE), client.reader("a", "rt/a", TYPE)
    client.read(reader)
    messages = []
    take = client.take
    client.take = lambda datagram: messages.append(datagram)
    client._put(
        ids.WRITE_DATA, b"\0\1" + writer.to_bytes(2, "big") + b"lost", ids.STREAM_RELIABLE, 1
    )
    client.until(lambda: sum(item[4] == ids.HEARTBEAT for item in messages) >= 2, "no heartbeat")
    client.take = take
    assert client.sample(reader) == b"lost"  # sent again on request


def test_pace_follows_the_clock(server):
    client = server.client(4)
    writer, reader = client.writer("a", "rt/a", TYPE), client.reader("a", "rt/a", TYPE)
    client.read(reader, control=(0xFFFF, 0, 0, 60))
    for i in range(4):
        client.write(writer, bytes([i]))
    times = []
    for i in range(4):
        assert client.sample(reader) == bytes([i])
        times.append(time.monotonic())
    assert all(later - earlier > 0.03 for earlier, later in zip(times[1:], times[2:], strict=False))


def test_a_writer_without_room_delays_its_client_alone(server, monkeypatch):
    full = threading.Event()
    full.set()
    write = MemoryWriter.write
    monkeypatch.setattr(
        MemoryWriter,
        "write",
        lambda self, cdr: not (full.is_set() and "slow" in self._key[1]) and write(self, cdr),
    )
    slow, fast = server.client(5), server.client(6)
    writer = slow.writer("a", "rt/slow", TYPE)
    reader = fast.reader("b", "rt/slow", TYPE, depth=100)
    fast.read(reader)
    fast_writer = fast.writer("b", "rt/fast", TYPE)
    fast_reader = fast.reader("b", "rt/fast", TYPE)
    fast.read(fast_reader)
    for i in range(10):
        head = b"\0\1" + writer.to_bytes(2, "big")
        slow._put(ids.WRITE_DATA, head + bytes([i]), ids.STREAM_RELIABLE, 1)
    for i in range(100):
        fast.write(fast_writer, bytes([i]))
        assert fast.sample(fast_reader) == bytes([i])
    assert len(slow._out) >= 10 and not fast.samples.get(reader)
    full.clear()
    assert [fast.sample(reader) for _ in range(10)] == [bytes([i]) for i in range(10)]
    slow.until(lambda: not len(slow._out), "nothing is acknowledged")


def test_an_internal_error_is_logged_and_affects_no_other_client():
    with running() as agent_run:
        first, second = agent_run.client(7), agent_run.client(8)
        victim = agent_run.agent.clients[7]

        def fail(*_):
            raise ZeroDivisionError("a fault of ours")

        agent_run.call(lambda: setattr(victim, "submessage", fail))
        first._put(ids.GET_INFO, bytes(8), ids.STREAM_NONE, 1)
        assert second.ping() == 1
        agent_run.call(fail)
        assert second.ping() == 1
        agent_run.call(lambda: setattr(victim, "next_deadline", fail))
        first.line.send(message([heartbeat(0, 3)], 0))
        assert second.ping() == 1
    log = agent_run.said.getvalue()
    assert "internal error" in log
    assert "ZeroDivisionError: a fault of ours at " in log and "test_server.py:" in log
    assert "please report it" in log


def test_a_middleware_tick_that_fails_is_logged(server):
    def fail():
        raise MiddlewareError("the network is gone")

    middleware = server.middleware
    middleware.tick = fail
    server.call(lambda: None)
    client = server.client(9)
    assert client.ping() == 1
    assert "the network is gone" in server.said.getvalue()
    del middleware.tick


def test_a_transport_that_cannot_open_ends_the_run_and_closes_the_others():
    with socket.create_server(("127.0.0.1", 0)) as port_owner:
        udp = UdpServer(0, "127.0.0.1")
        tcp = TcpServer(port_owner.getsockname()[1], "127.0.0.1")
        before = set(os.listdir("/proc/self/fd")) if os.path.isdir("/proc/self/fd") else None
        server = Server(Agent(MemoryMiddleware(), Log(0)), [udp, tcp])
        with pytest.raises(TransportError, match="TCP port .* is in use"):
            server.run()
        assert server.ready.is_set() and udp._socket is None
        if before is not None:
            assert len(os.listdir("/proc/self/fd")) <= len(before)


def test_stop_twice_and_after_the_end():
    with running() as agent_run:
        agent_run.server.stop()
        agent_run.server.stop()
        agent_run.thread.join(SECONDS)
    agent_run.server.stop()


def test_trace_levels_are_those_of_the_cpp_agent():
    with running(level=6) as agent_run:
        client = agent_run.client(0x0102)
        assert client.ping() == 1
    log = agent_run.said.getvalue()
    assert "UDPv4Agent         | recv_message             | [==>> UDP <<==]" in log
    assert "UDPv4Agent         | send_message             | [** <<UDP>> **]" in log
    assert "client_key: 0x00000102, len: 16, data: 81 00 00 00 02 01" in log


def test_a_hostile_client_cannot_make_a_turn_long(server):
    """One message of the largest size of one client, between two messages of another."""
    villain, bystander = server.client(10), server.client(11)
    part = message([fragment(bytes(60_000))], 0x80, 0)
    requests = message([get_info()] * 3600, 1, 0)
    unknown = message([write_data(0x0995, b"")] * 5400, 1, 1)
    for datagram in (part, requests, unknown):
        before = server.call(time.thread_time)
        villain.line.send_raw(datagram)
        assert bystander.ping() == 1
        # CPU time of the thread: the machine may be busy with something else.
        assert server.call(time.thread_time) - before < 0.5


@pytest.mark.cyclone
def test_a_type_that_differs_on_dds_is_a_warning_with_both_types(own_domain_id):
    other_type = TYPE.replace("UInt8", "Int8")
    with running_agent("udp", "dds", own_domain_id) as agent:
        first, second = [XrceClient(agent.line(i), 0x21 + i) for i in range(2)]
        assert first.open() == second.open() == ids.STATUS_OK
        first.writer("a", "rt/a", TYPE)
        second.reader("b", "rt/a", other_type)
        wait_for(agent.said.getvalue, "type differs")
        assert second.ping() == 1
    (line,) = [row for row in agent.said.getvalue().splitlines() if "type differs" in row]
    assert " warning " in line and "topic: rt/a, " in line and TYPE in line and other_type in line


def test_a_burst_ends_after_so_many_bytes_as_after_so_many_datagrams():
    """Otherwise a burst of the largest datagrams would delay the turns of all others."""

    class Host:
        count = 0

        def now(self):
            return 0

        def unmatched(self, transport, peer, buf, view, length):
            self.count += 1

        def watch(self, *_):
            pass

        unwatch = note = watch

    host, server = Host(), UdpServer(0, "127.0.0.1")
    server.open(host)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sock:
        sock.connect(("127.0.0.1", server.port))
        for size, burst in ((40_000, 2), (100, 64)):
            host.count = 0
            for _ in range(80 if size == 100 else 10):
                sock.send(bytes(size))
            server._drain()
            assert host.count == burst
            while host.count != (80 if size == 100 else 10):
                server._drain()
    server.close()


# --- what else lives in its thread -----------------------------------------------------------


class Attached:
    def __init__(self, trouble=None):
        self.trouble = trouble
        self.said = []

    def open(self, server):
        self.said.append(("open", threading.current_thread()))
        if self.trouble is not None:
            raise self.trouble

    def close(self):
        self.said.append(("close", threading.current_thread()))


def test_attachments_open_and_close_in_the_agents_thread():
    running, attachment = Running(), Attached()
    running.server.attachments.append(attachment)
    running.thread.start()
    assert running.server.ready.wait(SECONDS)
    running.server.stop()
    running.thread.join(SECONDS)
    assert attachment.said == [("open", running.thread), ("close", running.thread)]


def test_an_attachment_that_cannot_open_ends_the_agent_with_all_closed():
    running = Running()
    failing, attachment = Attached(TransportError(1, "no")), Attached()
    running.server.attachments += [failing, attachment]
    with pytest.raises(TransportError, match="no"):
        running.server.run()
    assert [item[0] for item in failing.said + attachment.said] == ["open", "close", "close"]
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sock:
        sock.bind(("127.0.0.1", running.udp.port))  # the port is free again


def test_calls_from_other_threads_run_in_order_and_a_failing_call_affects_no_other():
    with running_agent("udp", "memory") as running:
        values, done = [], threading.Event()
        running.server.soon(lambda: values.append(threading.current_thread()))
        running.server.soon(lambda: 1 / 0)
        running.server.soon(lambda: values.append(1))
        running.server.soon(lambda: running.server.soon(done.set))  # from its own thread too
        assert done.wait(SECONDS)
        assert values == [running.thread, 1]
        assert "ZeroDivisionError" in running.said.getvalue()
        running.said.truncate(0)  # running_agent() checks that the log has no fault


@pytest.mark.parametrize("transport", ["udp", "tcp"])
def test_sixty_clients_that_close_their_sessions_together_all_get_an_answer(transport):
    with running() as agent:
        clients = [agent.client(1 + number, transport) for number in range(60)]
        with agent.paused():
            for client in clients:
                client._send(
                    ids.DELETE, struct.pack(">HH", 1, ids.OBJECT_CLIENT), ids.STREAM_RELIABLE
                )
        for client in clients:
            client.until(lambda client=client: client.statuses, "it waits in vain")
            assert client.statuses == {(1, ids.OBJECT_CLIENT): ids.STATUS_OK}
        assert "unknown session" not in agent.said.getvalue()
