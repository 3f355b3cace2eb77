"""What every transport of the agent must do for a client, whichever way its bytes travel."""

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
    one = XrceClient(agent.line(number), key=0x11110000 + number, **options)
    assert one.open() == ids.STATUS_OK
    return one


def payload(size, start=0):
    """Every octet there is, flags and escapes of serial frames too."""
    return bytes((i + start) & 0xFF for i in range(size))


def ping(line, number=1):
    """GET_INFO outside of any session; the INFO that answers."""
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
    one = client(agent, session_id=session_id)
    assert one.ping() == 1
    writer = one.writer("node", TOPIC, TYPE)
    reader = one.reader("node", TOPIC, TYPE)
    one.read(reader)
    for i in range(40):  # more than a window
        one.write(writer, payload(20, i))
    assert [one.sample(reader) for _ in range(40)] == [payload(20, i) for i in range(40)]
    assert one.delete(writer) == ids.STATUS_OK
    assert one.delete(writer) == ids.STATUS_ERR_UNKNOWN_REFERENCE
    assert one.close() == ids.STATUS_OK
    assert agent.agent.clients == {}


def test_best_effort_both_ways(agent):
    one = client(agent)
    writer = one.writer("node", TOPIC, TYPE, BEST_EFFORT)
    reader = one.reader("node", TOPIC, TYPE, BEST_EFFORT)
    one.read(reader, stream=ids.STREAM_BEST_EFFORT)
    for i in range(10):
        one.write(writer, payload(30, i), stream=ids.STREAM_BEST_EFFORT)
        assert one.sample(reader) == payload(30, i)


def test_two_clients_talk_to_each_other(agent):
    one, two = client(agent, 0), client(agent, 1)
    writers = [it.writer(name, TOPIC + name, TYPE) for it, name in ((one, "one"), (two, "two"))]
    readers = [it.reader(name, TOPIC + name, TYPE) for it, name in ((one, "two"), (two, "one"))]
    for it, reader in zip((one, two), readers, strict=True):
        it.read(reader)
    for i in range(20):
        one.write(writers[0], payload(50, i))
        two.write(writers[1], payload(60, i))
        assert two.sample(readers[1]) == payload(50, i)
        assert one.sample(readers[0]) == payload(60, i)
    assert one.close() == ids.STATUS_OK
    two.write(writers[1], payload(9))
    assert two.ping() == 1 and two.close() == ids.STATUS_OK


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
    one = client(agent)
    writer, reader = one.writer("node", TOPIC, TYPE), one.reader("node", TOPIC, TYPE)
    one.read(reader)
    for start in (0, 1):
        one.write(writer, payload(size, start))
        assert one.sample(reader) == payload(size, start)


def test_a_large_mtu(agent):
    one = client(agent, mtu=8000)
    writer, reader = one.writer("node", TOPIC, TYPE), one.reader("node", TOPIC, TYPE)
    one.read(reader)
    for size in (7000, 7988, 7989, 20_000):
        one.write(writer, payload(size))
        assert one.sample(reader) == payload(size)


def test_garbage_is_survived_and_others_do_not_notice(agent):
    one = client(agent, 0)
    stranger = agent.line(1)
    for junk in (b"\0" * 3, bytes(range(200)), b"\x81\x80\x00\x00\x07\x01\xff\xff", b"\x80" * 40):
        if agent.kind in ("tcp", "tcp6", "tls"):
            stranger.send(junk)  # a stream of lengths has no place to start again at
        else:
            stranger.send_raw(junk)
    assert ping(stranger)
    assert one.ping() == 1


def test_a_client_that_comes_back_finds_its_objects(agent):
    one = client(agent)
    writer = one.writer("node", TOPIC, TYPE)
    assert one.open() == ids.STATUS_OK
    reader = one.reader("node", TOPIC, TYPE)
    one.read(reader)
    one.write(writer, payload(5))
    assert one.sample(reader) == payload(5)


def test_the_end_closes_everything(agent):
    one = client(agent)
    one.writer("node", TOPIC, TYPE)
    node_count = len(agent.middleware.bus.nodes)
    agent.stop()
    assert not agent.thread.is_alive()
    assert node_count == 1 and agent.middleware.bus.nodes == []
    assert agent.agent.clients == {}
    agent.transport.close()  # twice is once
    if agent.kind in ("tcp", "tcp6", "tls"):
        rest = b"-"
        while rest:
            assert select.select([one.line.fd], [], [], SECONDS)[0]
            try:
                rest = os.read(one.line.fd, 1000)
            except ConnectionResetError:  # something of ours was not read any more
                break


def test_stop_before_anything_happened(agent):
    agent.stop()
    assert not agent.thread.is_alive()


def test_a_port_is_free_again_at_once():
    with running_agent("tcp", "memory") as first:
        one = client(first)
        assert one.ping() == 1
        port = first.transport.port
    from uros.agent.transports.tcp import TcpServer

    with running_agent("tcp", "memory") as second:
        again = TcpServer(port, "127.0.0.1")
        again.open(second.server)
        again.close()


def test_a_flood_does_not_starve_others():
    """One sends as fast as it can, into the socket that is another's too; what the other
    asks for on its reliable stream, which repeats what gets lost there, is done meanwhile."""
    with running_agent("udp", "memory") as agent:
        flooder = UdpLine(agent.transport.port)
        agent.lines.append(flooder)
        stop = threading.Event()

        def flood():
            while not stop.is_set():
                flooder.send_raw(b"\x81\x01\x00\x00\x07\x01\x08\x00" + bytes(8))

        thread = threading.Thread(target=flood)
        one = client(agent)
        thread.start()
        try:
            for number in range(10):
                assert one.delete(one.participant(f"node{number}")) == ids.STATUS_OK
        finally:
            stop.set()
            thread.join()


def test_a_boards_printf_between_frames_is_passed_over():
    with running_agent("serial", "memory") as agent:
        line = agent.line()
        line.send_raw(b"\r\nBooting...\r\nfree heap: 12345\r\n")
        assert ping(line)
        line.send_raw(b"I (312) wifi: connected~")
        one = XrceClient(line, key=5)
        assert one.open() == ids.STATUS_OK


def test_a_frame_in_single_bytes():
    class Slow(SerialLine):
        def send_raw(self, data):
            for i in range(len(data)):
                super().send_raw(data[i : i + 1])

    with running_agent("pseudoterminal", "memory") as agent:
        line = Slow.open(agent.transport.device)
        agent.lines.append(line)
        one = XrceClient(line, key=5)
        assert one.open() == ids.STATUS_OK
        assert one.ping() == 1
