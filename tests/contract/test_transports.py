"""The contract of the agent's transports: a client's session, over each of them."""

import os
import select
import threading
import time

import pytest
from support.agent import TRANSPORTS, running_agent
from support.client import BEST_EFFORT, XrceClient
from support.lines import SECONDS, SerialLine, UdpLine

from uros.wire import ids, session
from uros.wire.header import MessageWriter

TOPIC, TYPE = "rt/chatter", "std_msgs::msg::dds_::UInt8MultiArray_"


@pytest.fixture(params=TRANSPORTS)
def agent(request):
    with running_agent(request.param, "memory") as running:
        yield running


def client(agent, number=0, **options):
    board = XrceClient(agent.line(number), key=0x11110000 + number, **options)
    assert board.open() == ids.STATUS_OK
    return board


def payload(size, start=0):
    """Octets of all values, flags and escapes of serial frames too."""
    return bytes((i + start) & 0xFF for i in range(size))


def ping(line, number=1):
    """Send GET_INFO outside of any session; the INFO in answer."""
    w = MessageWriter(bytearray(64), ids.SESSION_NONE_WITHOUT_KEY, ids.STREAM_NONE, 0)
    w.begin(ids.GET_INFO)
    session.push_get_info(w, number, ids.OBJECT_AGENT, ids.INFO_ACTIVITY)
    line.send(w.finish())
    answer = line.receive(time.monotonic() + SECONDS)
    assert answer is not None and answer[4] == ids.INFO
    return answer


def test_a_ping_is_answered_without_a_session(agent):
    line = agent.line()
    assert ping(line, 7)[8:10] == b"\x00\x07"


@pytest.mark.parametrize("session_id", [0x81, 0x01], ids=["without-key", "with-key"])
def test_a_session_from_its_start_to_its_end(agent, session_id):
    board = client(agent, session_id=session_id)
    assert board.ping() == 1
    writer = board.writer("node", TOPIC, TYPE)
    reader = board.reader("node", TOPIC, TYPE)
    board.read(reader)
    for i in range(40):  # more than a window
        board.write(writer, payload(20, i))
    assert [board.sample(reader) for _ in range(40)] == [payload(20, i) for i in range(40)]
    assert board.delete(writer) == ids.STATUS_OK
    assert board.delete(writer) == ids.STATUS_ERR_UNKNOWN_REFERENCE
    assert board.close() == ids.STATUS_OK
    assert agent.agent.clients == {}


def test_best_effort_in_both_directions(agent):
    board = client(agent)
    writer = board.writer("node", TOPIC, TYPE, BEST_EFFORT)
    reader = board.reader("node", TOPIC, TYPE, BEST_EFFORT)
    board.read(reader, stream=ids.STREAM_BEST_EFFORT)
    for i in range(10):
        board.write(writer, payload(30, i), stream=ids.STREAM_BEST_EFFORT)
        assert board.sample(reader) == payload(30, i)


def test_two_clients_exchange_samples(agent):
    first, second = client(agent, 0), client(agent, 1)
    writers = [
        board.writer(name, TOPIC + name, TYPE) for board, name in ((first, "one"), (second, "two"))
    ]
    readers = [
        board.reader(name, TOPIC + name, TYPE) for board, name in ((first, "two"), (second, "one"))
    ]
    for board, reader in zip((first, second), readers, strict=True):
        board.read(reader)
    for i in range(20):
        first.write(writers[0], payload(50, i))
        second.write(writers[1], payload(60, i))
        assert second.sample(readers[1]) == payload(50, i)
        assert first.sample(readers[0]) == payload(60, i)
    assert first.close() == ids.STATUS_OK
    second.write(writers[1], payload(9))
    assert second.ping() == 1 and second.close() == ids.STATUS_OK


def test_services_between_two_clients(agent):
    server, caller = client(agent, 0), client(agent, 1)
    types = ("pkg::srv::dds_::Add_Request_", "pkg::srv::dds_::Add_Response_")
    replier = server.service(ids.KIND_REPLIER, "server", "/add", *types)
    requester = caller.service(ids.KIND_REQUESTER, "caller", "/add", *types)
    server.read(replier)
    caller.read(requester)
    for i in range(5):
        number = caller.write(requester, payload(8, i))
        request = server.sample(replier)
        assert request[24:] == payload(8, i)
        server.write(replier, request[:24] + payload(12, i + 100))
        reply = caller.sample(requester)
        assert reply == number.to_bytes(2, "big") + requester.to_bytes(2, "big") + payload(
            12, i + 100
        )


@pytest.mark.parametrize("size", [600, 15_000, 200_000])
def test_large_samples_travel_in_fragments(agent, size):
    board = client(agent)
    writer, reader = board.writer("node", TOPIC, TYPE), board.reader("node", TOPIC, TYPE)
    board.read(reader)
    for start in (0, 1):
        board.write(writer, payload(size, start))
        assert board.sample(reader) == payload(size, start)


def test_a_large_mtu(agent):
    board = client(agent, mtu=8000)
    writer, reader = board.writer("node", TOPIC, TYPE), board.reader("node", TOPIC, TYPE)
    board.read(reader)
    for size in (7000, 7988, 7989, 20_000):
        board.write(writer, payload(size))
        assert board.sample(reader) == payload(size)


def test_garbage_affects_neither_the_agent_nor_other_clients(agent):
    board = client(agent, 0)
    line = agent.line(1)
    for junk in (b"\0" * 3, bytes(range(200)), b"\x81\x80\x00\x00\x07\x01\xff\xff", b"\x80" * 40):
        if agent.kind in ("tcp", "tcp6", "tls"):
            line.send(junk)  # a stream with length prefixes cannot be resynchronized
        else:
            line.send_raw(junk)
    assert ping(line)
    assert board.ping() == 1


def test_a_client_that_reconnects_finds_its_objects(agent):
    board = client(agent)
    writer = board.writer("node", TOPIC, TYPE)
    assert board.open() == ids.STATUS_OK
    reader = board.reader("node", TOPIC, TYPE)
    board.read(reader)
    board.write(writer, payload(5))
    assert board.sample(reader) == payload(5)


def test_stopping_the_agent_closes_everything(agent):
    board = client(agent)
    board.writer("node", TOPIC, TYPE)
    node_count = len(agent.middleware.bus.nodes)
    agent.stop()
    assert not agent.thread.is_alive()
    assert node_count == 1 and agent.middleware.bus.nodes == []
    assert agent.agent.clients == {}
    agent.transport.close()  # idempotent
    if agent.kind in ("tcp", "tcp6", "tls"):
        rest = b"-"
        while rest:
            assert select.select([board.line.fd], [], [], SECONDS)[0]
            try:
                rest = os.read(board.line.fd, 1000)
            except ConnectionResetError:  # the agent left some data unread
                break


def test_stop_directly_after_the_start(agent):
    agent.stop()
    assert not agent.thread.is_alive()


def test_a_port_is_free_directly_after_the_end():
    with running_agent("tcp", "memory") as first:
        board = client(first)
        assert board.ping() == 1
        port = first.transport.port
    from uros.agent.transports.tcp import TcpServer

    with running_agent("tcp", "memory") as second:
        again = TcpServer(port, "127.0.0.1")
        again.open(second.server)
        again.close()


def test_a_flood_does_not_starve_others():
    """While one client floods the agent's socket, requests of another client are answered.

    The other client's reliable stream repeats the messages that get lost.
    """
    with running_agent("udp", "memory") as agent:
        flooder = UdpLine(agent.transport.port)
        agent.lines.append(flooder)
        stop = threading.Event()

        def flood():
            while not stop.is_set():
                flooder.send_raw(b"\x81\x01\x00\x00\x07\x01\x08\x00" + bytes(8))

        thread = threading.Thread(target=flood)
        board = client(agent)
        thread.start()
        try:
            for number in range(10):
                assert board.delete(board.participant(f"node{number}")) == ids.STATUS_OK
        finally:
            stop.set()
            thread.join()


def test_a_boards_printf_between_frames_is_ignored():
    with running_agent("serial", "memory") as agent:
        line = agent.line()
        line.send_raw(b"\r\nBooting...\r\nfree heap: 12345\r\n")
        assert ping(line)
        line.send_raw(b"I (312) wifi: connected~")
        board = XrceClient(line, key=5)
        assert board.open() == ids.STATUS_OK


def test_a_frame_that_arrives_byte_by_byte():
    class Slow(SerialLine):
        def send_raw(self, data):
            for i in range(len(data)):
                super().send_raw(data[i : i + 1])

    with running_agent("pseudoterminal", "memory") as agent:
        line = Slow.open(agent.transport.device)
        agent.lines.append(line)
        board = XrceClient(line, key=5)
        assert board.open() == ids.STATUS_OK
        assert board.ping() == 1
