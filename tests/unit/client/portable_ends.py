"""Failures at the end of a session, in fragments and in callbacks. Also runs on MicroPython."""

from support.board import Ask, Blob, Number, message, number_bytes, pattern
from support.services import Bench

from uros.client import AGENT_CONNECTED
from uros.client.entities import Future
from uros.wire import ids


def comes_back(bench):
    """Lose the agent; return whether the node connects to another one."""
    bench.agent.silent = True
    bench.run(3000)
    bench.agent.silent = False
    bench.agent.forget()
    bench.run(5000)
    return bench.node.state == AGENT_CONNECTED and bench.agent.is_open


def test_a_memory_error_at_the_end_of_a_session_is_retried() -> None:
    bench = Bench(connect=False)
    client = bench.node.create_client(Ask, "ask")
    bench.connect()
    was = client.on_lost
    calls = []

    def starving():
        calls.append(1)
        if len(calls) == 1:
            raise MemoryError
        was()

    client.on_lost = starving
    assert comes_back(bench) and len(calls) == 2


def test_a_transport_whose_close_raises_is_reopened() -> None:
    bench = Bench(connect=False)
    bench.node.create_client(Ask, "ask")
    bench.connect()
    was = bench.agent.close

    def close():
        was()
        raise OSError(5, "gone")

    bench.agent.close = close
    assert comes_back(bench)
    bench.node.destroy_node()


def test_a_queued_response_that_cannot_be_packed_is_reported() -> None:
    class Bad(Number):
        _TYPE = Ask.Response._TYPE

        def pack_into(self, buf, offset, start):
            raise ValueError("does not fit")

    bench = Bench(connect=False)
    service = bench.node.create_service(Ask, "ask", lambda request, response: Bad())
    bench.connect()
    bench.node.connection.ready = False  # as while another entity is created
    bench.agent.sample(service.object_id(ids.KIND_REPLIER), bytes(24) + number_bytes(1))
    bench.run(20)
    assert bench.errors == []
    bench.node.connection.ready = True
    bench.run(20)
    assert len(bench.errors) == 1


class NoMemory:
    """Fragments that cannot be stored for lack of memory."""

    def __init__(self, real):
        self.real = real

    def add(self, part, last):
        raise MemoryError

    def __getattr__(self, name):
        return getattr(self.real, name)


def test_a_fragment_without_memory_loses_its_message_alone() -> None:
    texts = [pattern(290), pattern(290, 9), pattern(290, 5)]
    for starved in range(9):
        bench = Bench(connect=False)
        heard = []
        blobs = bench.node.create_subscription(
            Blob, "blobs", lambda message, heard=heard: heard.append(bytes(message.octets))
        )
        bench.connect()
        connection = bench.node.connection
        reader_id = blobs.object_id(ids.KIND_DATAREADER).to_bytes(2, "big")
        number = connection._in.next
        count = 0
        for text in texts:
            whole = message(ids.DATA, b"\0\1" + reader_id + text)[4:]
            assert 200 < len(whole) <= 300
            for at in (0, 100, 200):
                flags = ids.FLAG_LITTLE_ENDIAN | (ids.FLAG_LAST_FRAGMENT if at == 200 else 0)
                datagram = message(
                    ids.FRAGMENT, whole[at : at + 100], 0x80, number, connection.id, flags
                )
                number = (number + 1) & 0xFFFF
                real = connection._fragments
                if count == starved:
                    connection._fragments = NoMemory(real)
                count += 1
                try:
                    connection.receive(datagram, 0)
                except MemoryError:
                    pass
                connection._fragments = real
        bench.run(10)
        assert heard == [text for i, text in enumerate(texts) if i != starved // 3]


def test_the_session_is_served_while_a_subscription_is_overfull() -> None:
    """No more samples are received then, but HEARTBEATs and pings are sent between callbacks."""
    bench = Bench(connect=False)
    sender = bench.node.create_publisher(Number, "others", 10)

    def slow(message):
        bench.clock.sleep(100)
        sender.publish(message)

    numbers = bench.node.create_subscription(Number, "numbers", slow, 3)
    bench.connect()
    for i in range(30):  # as after a late message of the reliable stream
        numbers.on_data(number_bytes(i), 0, 4, True)
    sent = []
    send = bench.agent.send
    bench.agent.send = lambda buf, size: (
        sent.append((buf[4], numbers.overfull())), send(buf, size)
    )  # fmt: skip
    while numbers.overfull():
        bench.node.spin_once(0)
    assert (ids.HEARTBEAT, True) in sent and (ids.GET_INFO, True) in sent


def test_spin_until_future_complete_accepts_none_and_long_timeouts() -> None:
    bench = Bench()
    future = Future()
    bench.node.create_timer(2.0, lambda: future.done() or future.finish(5))
    assert not bench.node.spin_until_future_complete(future, 1.0)
    assert bench.node.spin_until_future_complete(future, None) and future.result() == 5
    assert bench.node.spin_until_future_complete(Future(), 0) is False
    later = Future()
    bench.node.create_timer(2.0, lambda: later.done() or later.finish(6))
    assert bench.node.spin_until_future_complete(later, 1e9)  # longer than ticks can count
