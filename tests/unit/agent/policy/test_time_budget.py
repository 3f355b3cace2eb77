"""Clients that create and delete as fast as they can: others are served, closing is deferred."""

import time

import pytest
from support.agent import running_agent
from support.client import XrceClient
from unit.agent.helpers import (
    delete,
    endpoint,
    group,
    oid,
    participant,
    topic,
)
from unit.agent.test_server import TYPE, running

from uros.agent.agent import Agent
from uros.agent.log import INFO, WARNING, Log
from uros.agent.policy import time_budget as module
from uros.agent.policy.time_budget import DeferredCloseQueue, TimeBudget
from uros.agent.server import Server
from uros.middleware.memory import MemoryMiddleware, MemoryNode, MemoryWriter
from uros.wire import ids


@pytest.fixture
def clock():
    """``clock.now`` is the time."""

    class Clock:
        now = 50.0

        def monotonic(self):
            return self.now

    return Clock()


# --- budgets ----------------------------------------------------------------------------


def test_a_greedy_client_gets_its_share_and_another_client_all_its_turns(clock):
    budget = TimeBudget(clock.monotonic)
    budget.enabled = True
    greedy, modest = budget.for_client(), budget.for_client()
    worked = {greedy: 0, modest: 0}
    for turn in range(2000):  # 10 s
        clock.now += 0.005
        for account in (greedy, modest) if turn % 100 == 0 else (greedy,):
            if account.start():
                clock.now += 0.001
                account.charge()
                worked[account] += 1
    assert 2000 < 1000 * (module.BURST_OF_ONE + 12 * module.SHARE_OF_ONE) < 4000
    assert worked[greedy] < 1000 * (module.BURST_OF_ONE + 13 * module.SHARE_OF_ONE)
    assert worked[modest] == 20  # in each of its turns


def test_all_together_never_work_longer_than_a_burst(clock):
    budget = TimeBudget(clock.monotonic)
    budget.enabled = True
    start, turn = clock.now, 0
    for account in [budget.for_client() for _ in range(100)]:
        if account.start():
            clock.now += 0.001
            account.charge()
            turn += 1
    assert clock.now - start <= 5 * module.BURST_OF_ALL and turn < 100


def test_without_a_server_no_client_waits(clock):
    budget = TimeBudget(clock.monotonic).for_client()
    for _ in range(100):
        assert budget.start()
        clock.now += 1
        budget.charge()


# --- closing ------------------------------------------------------------------------------


def test_closing_is_done_in_slices_in_order_and_once(clock):
    deferred, closed, failed = [], [], []
    closing = DeferredCloseQueue(failed.append, clock.monotonic)
    closing.schedule = lambda: deferred.append(1)

    def close(number):
        def close_call():
            clock.now += 0.001
            closed.append(number)
            if number == 3:
                raise RuntimeError("of the middleware")

        return close_call

    for number in range(100):
        closing.add(close(number))
    assert 9 <= len(closed) <= 12 and len(deferred) == 1
    before = len(closed)
    closing.begin_turn()  # another turn, but the waiting calls come first
    closing.add(close(100))
    assert len(closed) == before
    while deferred:
        deferred.clear()
        closing.work()
        assert len(closed) - before <= 12
        before = len(closed)
    assert closed == list(range(101)) and len(failed) == 1 and not closing


def test_the_queue_of_deferred_calls_is_bounded_and_so_is_the_shutdown(clock, monkeypatch):
    monkeypatch.setattr(module, "MAX_CLOSING", 10)
    closed = []
    closing = DeferredCloseQueue(lambda error: None, clock.monotonic)
    closing.schedule = lambda: None
    closing._spent = 1.0
    for number in range(30):
        closing.add(lambda number=number: closed.append(number))
        assert len(closing) <= 10
    closing.finish()
    assert closed == list(range(30))


# --- in a server ----------------------------------------------------------------------------


def slow(monkeypatch, seconds):
    """Delay creating and closing a writer as on a network; return the list that records both."""
    create, close = MemoryNode.create_writer, MemoryWriter.close
    done = []

    def creates(self, *args):
        time.sleep(seconds)  # stands for a library call that blocks the thread
        done.append("create")
        return create(self, *args)

    def closes(self):
        time.sleep(seconds)
        done.append("close")
        return close(self)

    monkeypatch.setattr(MemoryNode, "create_writer", creates)
    monkeypatch.setattr(MemoryWriter, "close", closes)
    return done


def waits(client, count, done):
    """Return how much was appended to ``done`` while each of so many pings waited, sorted."""
    counts = []
    for _ in range(count):
        before = len(done)
        assert client.ping() == 1
        counts.append(len(done) - before)
    return sorted(counts)


class Storm:
    """A client that creates and deletes one writer for ever, as fast as its window allows."""

    def __init__(self, client):
        self.client = client
        _make(client, participant(), topic(), group())
        self.submessage_count = 0

    def blow(self):
        """Fill the window; handle the messages that have arrived."""
        client = self.client
        while client._out.available():
            self.submessage_count += 1
            writer_id = oid(7, 5)
            submessage = (
                endpoint(writer_id, topic_id=oid(1, 2))
                if self.submessage_count % 2
                else delete(writer_id)
            )
            client._put(submessage[0], submessage[2], ids.STREAM_RELIABLE, submessage[1])
        while (datagram := client.line.receive(time.monotonic())) is not None:
            client.take(datagram)


def blow(good, storms, done, enough, pings=150):
    """Return how much was done while each ping waited, until ``enough`` accepts the counts."""
    counts = []
    while len(counts) < pings or not enough(counts):
        for storm in storms:
            storm.blow()
        counts += waits(good, 1, done)
    return sorted(counts)


def test_many_clients_that_create_for_ever_do_not_delay_others(monkeypatch):
    done = slow(monkeypatch, 0.002)
    with running(level=3) as server:
        good = server.client(1)
        storms = [Storm(server.client(10 + number)) for number in range(8)]
        counts = blow(good, storms, done, lambda counts: sum(counts) > 50)
        # 128 wait in the windows. 20 ms of them at once are 10.
        assert sum(counts) > 50 and counts[len(counts) // 2] <= 10 and counts[-1] <= 40, counts[
            -20:
        ]
        assert good.ping() == 1
        assert "internal error" not in server.said.getvalue()


def _make(client, *submessages):
    for submessage in submessages:
        client._put(submessage[0], submessage[2], ids.STREAM_RELIABLE, submessage[1])
    client.until(lambda: not len(client._out), "nothing is acknowledged")


def test_endpoints_of_a_deleted_client_are_closed_in_slices(monkeypatch):
    with running(level=3) as server:
        good, bad = server.client(1), server.client(2)
        writer = bad.writer("a", "rt/a0", TYPE)
        assert writer
        for number in range(10, 310):
            _send_object(bad, endpoint(oid(number, 5), topic_id=oid(1, 2), parent=oid(1, 3)))
        bad.until(lambda: not len(bad._out), "nothing is acknowledged", 30)
        bus = server.middleware.bus
        assert len(bus.writers[0, "rt/a0"]) == 301
        done = slow(monkeypatch, 0.002)  # 0.6 s at once
        assert bad.close() == ids.STATUS_OK
        counts = waits(good, 30, done)
        assert counts[-1] <= 40, counts  # 10 ms of them are 5
        # The name of its node is free at once.
        again = server.client(2)
        assert again.writer("a", "rt/a1", TYPE)
        deadline = time.monotonic() + 10
        while server.call(lambda: len(server.agent.close_queue)):
            assert time.monotonic() < deadline
            assert good.ping() == 1
        assert (0, "rt/a0") not in bus.writers


def _send_object(client, submessage):
    client._put(submessage[0], submessage[2], ids.STREAM_RELIABLE, submessage[1])


def test_many_timers_due_at_once_do_not_delay_other_clients():
    """The timers stand for those of a thousand clients whose streams wait."""
    server, done = Server(Agent(MemoryMiddleware(), Log(0)), []), []
    for _ in range(20):
        server.wake_at(0.0, lambda: time.sleep(0.002) or done.append(1))
    turns = 0
    while server._calls:
        before = len(done)
        server._due(time.monotonic() + 0.001)
        turns += 1
        assert 1 <= len(done) - before <= 8
    assert len(done) == 20 and turns >= 3
    server.agent.middleware.close()
    server._poller.close()
    server._wake.close()


def test_deferred_calls_are_made_at_shutdown(monkeypatch):
    slow(monkeypatch, 0.001)
    with running(level=3) as server:
        bad = server.client(2)
        bad.writer("a", "rt/a0", TYPE)
        for number in range(10, 110):
            _send_object(bad, endpoint(oid(number, 5), topic_id=oid(1, 2), parent=oid(1, 3)))
        bad.until(lambda: not len(bad._out), "nothing is acknowledged", 30)
        bad.close()
    assert not server.middleware.bus.writers and not server.middleware.bus.nodes


@pytest.mark.cyclone
def test_clients_that_create_for_ever_on_dds_do_not_delay_others(own_domain_id):
    """Two clients create and delete; the third is served."""
    with running_agent("udp", "dds", own_domain_id, level=3) as agent:
        good = XrceClient(agent.line(0), 1)
        assert good.open() == ids.STATUS_OK
        clients = [XrceClient(agent.line(number), 10 + number) for number in (1, 2)]
        assert [client.open() for client in clients] == [ids.STATUS_OK] * 2
        storms = [Storm(client) for client in clients]
        blow(good, storms, [], lambda _: sum(client.submessage_count for client in storms) > 100)
        assert good.writer("a", "rt/good", TYPE)


def test_clients_that_create_for_ever_write_few_log_lines(desk, monkeypatch):
    import io

    from uros.agent import log as log_module

    log_stream = io.StringIO()
    monkeypatch.setattr(log_module, "_INFO_RATE", 0)
    log = Log(INFO, log_stream)
    for number in range(2 * log_module._INFO_BURST):
        log.info("ProxyClient", "create_topic", "topic created", str(number))
    assert log_stream.getvalue().count("\n") == log_module._INFO_BURST
    log.warning("Root", "x", "y", "z")
    assert f"z ({log_module._INFO_BURST} lines of info were left out" in log_stream.getvalue()
    log.warning("Root", "x", "y", "again")
    assert log_stream.getvalue().endswith("again\n")
    log(WARNING, "Root", "x", "y")
    every = io.StringIO()
    debug = Log(5, every)
    for number in range(2 * log_module._INFO_BURST):
        debug.info("ProxyClient", "create_topic", "topic created", str(number))
    assert every.getvalue().count("\n") == 2 * log_module._INFO_BURST
