"""A middleware that fails, or never has room, in any call.

The client gets a status or a log line, other clients are served, and the agent shuts down cleanly.
"""

import threading
import time

import pytest
from support.client import XrceClient, now_ms
from support.lines import SECONDS, UdpLine
from unit.agent.helpers import message, write_data
from unit.agent.test_server import TYPE, running
from unit.agent.transports.faults import wait_for

from uros.middleware.base import MiddlewareError
from uros.middleware.memory import (
    MemoryMiddleware,
    MemoryNode,
    MemoryReader,
    MemoryReplier,
    MemoryRequester,
    MemoryWriter,
)
from uros.wire import entities, ids

ERRORS = [
    MiddlewareError("no network"), RuntimeError("a bug"), MemoryError(), OSError(24, "EMFILE"),
]  # fmt: skip


def error_name(error):
    return type(error).__name__


class Bad:
    """While ``armed``, makes calls fail for entities with "bad" in their names, or for all."""

    def __init__(self, monkeypatch):
        self.patch = monkeypatch
        self.armed = False
        self.calls = 0

    def fail(self, owner, name, error, is_bad=lambda *_: True):
        real = getattr(owner, name)

        def call(instance, *args):
            if self.armed and is_bad(instance, *args):
                self.calls += 1
                raise error
            return real(instance, *args)

        self.patch.setattr(owner, name, call)


@pytest.fixture
def bad(monkeypatch):
    return Bad(monkeypatch)


class Pair:
    """Two clients on one topic that the faults must not affect."""

    def __init__(self, server):
        self.first, self.second = server.client(0x51), server.client(0x52)
        self.writer = self.first.writer("first", "rt/good", TYPE)
        self.reader = self.second.reader("second", "rt/good", TYPE)
        self.second.read(self.reader)
        self.count = 0

    def check(self):
        for _ in range(3):
            self.count += 1
            sample = self.count.to_bytes(4, "big")
            self.first.write(self.writer, sample)
            assert self.second.sample(self.reader) == sample
            assert self.first.ping() == self.second.ping() == 1


def echo(server):
    """Return a client, its writer and its reader, both on the topic that fails."""
    client = server.client(1)
    writer, reader = client.writer("n", "rt/bad", TYPE), client.reader("n", "rt/bad", TYPE)
    client.read(reader)
    return client, writer, reader


def create_status(client, kind, parent, push, *values, number=9):
    object_id = number << 4 | kind
    content = client._payload(push, *values)
    return client.request(
        ids.CREATE, entities.push_create, object_id, ids.IN_BINARY, content, parent
    )


def service(client, kind, parent):
    return create_status(
        client, kind, parent, entities.push_binary_service,
        "bad", "a::srv::dds_::A_Request_", "a::srv::dds_::A_Response_", "rq/badRequest",
        "rr/badReply",
    )  # fmt: skip


# --- creating -------------------------------------------------------------------------------


@pytest.mark.parametrize("error", ERRORS, ids=error_name)
@pytest.mark.parametrize(
    "call", ["create_node", "create_writer", "create_reader", "create_requester", "create_replier"]
)
def test_an_entity_that_cannot_be_created_is_an_error_status(bad, call, error):
    """The board gets an error status at once, so it does not wait for an answer in vain."""
    if call == "create_node":
        bad.fail(MemoryMiddleware, call, error, lambda _, domain, space, name, *more: name == "bad")
    elif call.endswith("er") and call[7:] in ("writer", "reader"):
        bad.fail(MemoryNode, call, error, lambda _, topic, *more: "bad" in topic)
    else:
        bad.fail(MemoryNode, call, error, lambda _, service, *more: "bad" in service.request_topic)
    with running() as server:
        pair = Pair(server)
        client = server.client(1)
        node = client.participant("n")
        bad.armed = True
        if call == "create_node":
            status = create_status(client, 1, 0, entities.push_binary_participant, "bad", None)
        elif call in ("create_requester", "create_replier"):
            kind = ids.KIND_REQUESTER if call == "create_requester" else ids.KIND_REPLIER
            status = service(client, kind, node)
        else:
            with pytest.raises(AssertionError, match="DDS_ERROR"):
                make = client.writer if call == "create_writer" else client.reader
                make("n", "rt/bad", TYPE)
            status = ids.STATUS_ERR_DDS_ERROR
        assert status == ids.STATUS_ERR_DDS_ERROR and bad.calls == 1
        pair.check()
        bad.armed = False
        assert client.ping() == 1
        good = client.writer("n2", "rt/bad", TYPE)
        client.write(good, b"now it can be")
        pair.check()


# --- samples ----------------------------------------------------------------------------------


@pytest.mark.parametrize("error", ERRORS, ids=error_name)
def test_a_write_that_fails_loses_its_sample_alone(bad, error):
    bad.fail(MemoryWriter, "write", error, lambda instance, cdr: "bad" in instance._key[1])
    with running() as server:
        pair = Pair(server)
        client, writer, reader = echo(server)
        bad.armed = True
        for _ in range(5):
            client.write(writer, b"lost")
        for _ in range(5):
            client._put(
                ids.WRITE_DATA, b"\0\1" + writer.to_bytes(2, "big") + b"lost", ids.STREAM_RELIABLE,
                1,
            )  # fmt: skip
        assert client.ping() == 1
        pair.check()
        # The submessage behind it in the same message is handled.
        fine, ear = client.writer("n", "rt/fine", TYPE), client.reader("n", "rt/fine", TYPE)
        client.read(ear)
        writes = [(writer, b"lost"), (fine, b"not lost")]
        number = client._out.next
        client._out.put(b"")
        client._out.take(now_ms())
        client.line.send(
            message(
                [write_data(*item) for item in writes], 0x80, number, client.session_id, client.key
            )
        )
        assert client.sample(ear) == b"not lost"
        bad.armed = False
        client.write(writer, b"again")
        assert client.sample(reader) == b"again" and bad.calls == 11
        client.until(lambda: not len(client._out), "the stream stands still")


@pytest.mark.parametrize("error", ERRORS, ids=error_name)
def test_a_take_that_fails_ends_the_delivery_and_is_logged(bad, error):
    bad.fail(MemoryReader, "take", error, lambda instance, limit: "bad" in instance._key[1])
    with running() as server:
        pair = Pair(server)
        client, writer, reader = echo(server)
        bad.armed = True
        client.write(writer, b"sample")
        expected_text = (
            "delivery ended" if isinstance(error, MiddlewareError) else error_name(error)
        )
        wait_for(server.said.getvalue, expected_text)
        for _ in range(20):
            client.write(writer, b"sample")
        pair.check()
        assert bad.calls == 1  # the agent does not retry
        assert server.agent.clients[1].objects[reader].delivery is None
        bad.armed = False
        client.read(reader)  # but the client can send READ_DATA again
        assert client.sample(reader) == b"sample"


@pytest.mark.parametrize("error", ERRORS, ids=error_name)
@pytest.mark.parametrize(
    ("owner", "call"),
    [(MemoryRequester, "request"), (MemoryRequester, "take"), (MemoryReplier, "take")],
)
def test_services_likewise(bad, owner, call, error):
    bad.fail(owner, call, error)
    with running() as server:
        pair = Pair(server)
        client = server.client(1)
        node = client.participant("n")
        assert service(client, ids.KIND_REQUESTER, node) == ids.STATUS_OK
        assert service(client, ids.KIND_REPLIER, node) == ids.STATUS_OK
        requester, replier = 9 << 4 | ids.KIND_REQUESTER, 9 << 4 | ids.KIND_REPLIER
        bad.armed = True
        client.read(requester)
        client.read(replier)
        client._put(
            ids.WRITE_DATA, b"\0\1" + requester.to_bytes(2, "big") + bytes(8), ids.STREAM_RELIABLE,
            1,
        )  # fmt: skip
        client.until(lambda: not len(client._out), "the stream stands still")
        assert bad.calls
        pair.check()


def test_requests_without_a_server_that_understands_them_get_a_status(monkeypatch):
    """Test requests that are refused at once, and requests that wait when such a server appears."""
    why = []
    requesters = []
    monkeypatch.setattr(MemoryRequester, "refusal", lambda self: "".join(why), raising=False)
    create = MemoryNode.create_requester

    def keep(self, service, qos, on_ready):
        requesters.append(on_ready)
        return create(self, service, qos, on_ready)

    monkeypatch.setattr(MemoryNode, "create_requester", keep)
    with running() as server:
        pair = Pair(server)
        client = server.client(1)
        assert service(client, ids.KIND_REQUESTER, client.participant("n")) == ids.STATUS_OK
        requester_id = 9 << 4 | ids.KIND_REQUESTER
        waiting = [client.write(requester_id, b"abcd") for _ in range(3)]
        why.append("no server understands it")
        server.server.soon(requesters[0])
        for request in waiting:
            client.until(lambda key=(request, requester_id): key in client.statuses, "no STATUS")
            assert client.statuses[request, requester_id] == ids.STATUS_ERR_DDS_ERROR
        monkeypatch.setattr(MemoryRequester, "request", _refuse)
        request = client.write(requester_id, b"abcd")
        client.until(lambda: (request, requester_id) in client.statuses, "no STATUS")
        pair.check()
        assert "request refused" in server.said.getvalue()
        assert "no server understands it" in server.said.getvalue()


def _refuse(self, cdr):
    raise MiddlewareError("not called")


def test_a_writer_that_never_has_room_delays_its_client_alone_and_the_client_can_close(monkeypatch):
    write = MemoryWriter.write
    monkeypatch.setattr(
        MemoryWriter, "write", lambda self, cdr: "bad" not in self._key[1] and write(self, cdr)
    )
    with running() as server:
        pair = Pair(server)
        stuck = [server.client(number) for number in range(1, 9)]
        for client in stuck:
            writer = client.writer("n", "rt/bad", TYPE)
            for _ in range(client._out.available()):
                client._put(
                    ids.WRITE_DATA, b"\0\1" + writer.to_bytes(2, "big") + b"x",
                    ids.STREAM_RELIABLE, 1,
                )  # fmt: skip
        before = server.server.turns
        pair.check()
        assert server.server.turns - before < 2000  # the thread does not spin
        for client in stuck:
            assert client.close() == ids.STATUS_OK
        pair.check()
        assert server.call(lambda: len(server.agent.clients)) == 2


# --- closing ------------------------------------------------------------------------------------


@pytest.mark.parametrize("error", ERRORS, ids=error_name)
@pytest.mark.parametrize("owner", [MemoryWriter, MemoryReader, MemoryNode])
def test_entities_that_fail_to_close_are_logged_and_the_others_are_closed(bad, owner, error):
    names = {MemoryNode: lambda instance: "bad" in instance.full_name}
    bad.fail(owner, "close", error, names.get(owner, lambda instance: "bad" in instance._key[1]))
    with running() as server:
        pair = Pair(server)
        client = server.client(1)
        writer, reader = client.writer("bad", "rt/bad", TYPE), client.reader("bad", "rt/bad2", TYPE)
        other_writer = client.writer("fine", "rt/fine", TYPE)
        bad.armed = True
        assert client.delete(writer) == client.delete(reader) == ids.STATUS_OK
        assert client.delete(other_writer) == ids.STATUS_OK
        again = client.writer("again", "rt/fine", TYPE)
        client.write(again, b"works")
        pair.check()
        assert client.close() == ids.STATUS_OK
        assert bad.calls
        pair.check()
        assert (0, "rt/fine") not in server.middleware.bus.writers
        assert error_name(error) in server.said.getvalue()
        bad.armed = False


# --- what is for all ------------------------------------------------------------------------------


@pytest.mark.parametrize("error", ERRORS, ids=error_name)
@pytest.mark.parametrize("call", ["flush", "dispatch_local", "tick", "next_deadline"])
def test_calls_of_the_data_plane_that_fail_for_ever(bad, call, error):
    bad.fail(MemoryMiddleware, call, error)
    with running() as server:
        pair = Pair(server)
        bad.armed = True
        before = server.server.turns, bad.calls
        pair.check()
        wait = threading.Event()
        wait.wait(0.3)  # nothing happens meanwhile: does it spin?
        assert server.server.turns - before[0] < 300
        pair.check()
        assert bad.calls > before[1] or call == "tick"
        new_client = server.client(7)
        new_client.writer("late", "rt/late", TYPE)
        assert server.said.getvalue().count("\n") < 100
        bad.armed = False
        pair.check()


@pytest.mark.parametrize("error", ERRORS, ids=error_name)
def test_a_tick_that_fails_and_is_always_due(bad, monkeypatch, error):
    bad.fail(MemoryMiddleware, "tick", error)
    with running() as server:
        pair = Pair(server)
        bad.armed = True
        monkeypatch.setattr(MemoryMiddleware, "next_deadline", lambda self: time.monotonic() - 1)
        pair.check()
        before = server.server.turns
        threading.Event().wait(0.3)
        assert server.server.turns - before < 50 and bad.calls < 20
        pair.check()
        monkeypatch.undo()
        pair.check()


@pytest.mark.parametrize("error", ERRORS, ids=error_name)
def test_a_dispatch_that_always_fails_delivers_no_samples_and_everything_else_works(bad, error):
    bad.fail(MemoryMiddleware, "dispatch", error)
    with running() as server:
        pair = Pair(server)
        bad.armed = True
        pair.first.write(pair.writer, b"waits")
        for _ in range(20):
            assert pair.first.ping() == 1
        wait = threading.Event()
        before = bad.calls
        wait.wait(0.3)
        assert bad.calls - before < 100  # the thread does not spin
        bad.armed = False
        assert pair.second.sample(pair.reader) == b"waits"
        pair.check()


@pytest.mark.parametrize("error", ERRORS, ids=error_name)
def test_a_shutdown_step_that_fails_does_not_skip_the_others(bad, error):
    bad.fail(MemoryMiddleware, "close", error)
    with running() as server:
        client = server.client(1)
        client.writer("n", "rt/a", TYPE)
        bad.armed = True
        port = server.udp.port
    assert bad.calls == 1 and server.udp._socket is None and server.tcp._socket is None
    assert error_name(error) in server.said.getvalue()
    again = UdpLine(port)
    again.close()
    bad.armed = False
    server.middleware.close()


def test_the_agent_goes_on_when_a_middleware_call_that_hung_returns(monkeypatch):
    """Nobody can be served meanwhile, there is one thread; nothing is lost or left behind."""
    hang, hanging = threading.Event(), threading.Event()
    create = MemoryNode.create_writer

    def stuck(self, topic, *more):
        if "bad" in topic:
            hanging.set()
            hang.wait(SECONDS)
        return create(self, topic, *more)

    monkeypatch.setattr(MemoryNode, "create_writer", stuck)
    with running() as server:
        pair = Pair(server)
        client = XrceClient(UdpLine(server.udp.port), 1)
        server.lines.append(client.line)
        assert client.open() == 0
        thread = threading.Thread(target=client.writer, args=("n", "rt/bad", TYPE))
        thread.start()
        assert hanging.wait(SECONDS)
        pair.first._put(
            ids.WRITE_DATA, b"\0\1" + pair.writer.to_bytes(2, "big") + b"meanwhile",
            ids.STREAM_RELIABLE, 1,
        )  # fmt: skip
        hang.set()
        thread.join()
        assert pair.second.sample(pair.reader) == b"meanwhile"
        pair.check()
