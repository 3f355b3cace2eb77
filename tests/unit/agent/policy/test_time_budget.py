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


def test_one_client_gets_its_part_and_others_theirs(clock):
    budget = TimeBudget(clock.monotonic)
    budget.enabled = True
    greedy, modest = budget.for_client(), budget.for_client()
    worked = {greedy: 0, modest: 0}
    for turn in range(2000):  # 10 s
        clock.now += 0.005
        for one in (greedy, modest) if turn % 100 == 0 else (greedy,):
            if one.start():
                clock.now += 0.001
                one.charge()
                worked[one] += 1
    assert 2000 < 1000 * (module.BURST_OF_ONE + 12 * module.SHARE_OF_ONE) < 4000
    assert worked[greedy] < 1000 * (module.BURST_OF_ONE + 13 * module.SHARE_OF_ONE)
    assert worked[modest] == 20  # every time


def test_all_together_never_work_longer_than_a_burst(clock):
    budget = TimeBudget(clock.monotonic)
    budget.enabled = True
    start, turn = clock.now, 0
    for one in [budget.for_client() for _ in range(100)]:
        if one.start():
            clock.now += 0.001
            one.charge()
            turn += 1
    assert clock.now - start <= 5 * module.BURST_OF_ALL and turn < 100


def test_without_a_server_nobody_waits(clock):
    budget = TimeBudget(clock.monotonic).for_client()
    for _ in range(100):
        assert budget.start()
        clock.now += 1
        budget.charge()


# --- closing ------------------------------------------------------------------------------


def test_closing_is_done_in_slices_in_order_and_once(clock):
    later, closed, failed = [], [], []
    closing = DeferredCloseQueue(failed.append, clock.monotonic)
    closing.schedule = lambda: later.append(1)

    def close(number):
        def it():
            clock.now += 0.001
            closed.append(number)
            if number == 3:
                raise RuntimeError("of the middleware")

        return it

    for number in range(100):
        closing.add(close(number))
    assert 9 <= len(closed) <= 12 and len(later) == 1
    before = len(closed)
    closing.begin_turn()  # another turn, but what waits goes first
    closing.add(close(100))
    assert len(closed) == before
    while later:
        later.clear()
        closing.work()
        assert len(closed) - before <= 12
        before = len(closed)
    assert closed == list(range(101)) and len(failed) == 1 and not closing


def test_what_waits_has_an_end_and_so_has_the_end(clock, monkeypatch):
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
    """Creating and closing a writer takes as long as on a network; the list grows with each."""
    create, close = MemoryNode.create_writer, MemoryWriter.close
    done = []

    def creates(self, *args):
        time.sleep(seconds)  # the very thing: a library that keeps the thread
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
    """How much the agent did of ``done`` while each of so many pings waited, sorted."""
    found = []
    for _ in range(count):
        before = len(done)
        assert client.ping() == 1
        found.append(len(done) - before)
    return sorted(found)


class Storm:
    """A client that makes and deletes one writer for ever, as fast as its window allows."""

    def __init__(self, client):
        self.client = client
        _make(client, participant(), topic(), group())
        self.made = 0

    def blow(self):
        """Fill the window; take what has come."""
        client = self.client
        while client._out.available():
            self.made += 1
            thing = oid(7, 5)
            one = endpoint(thing, topic_id=oid(1, 2)) if self.made % 2 else delete(thing)
            client._put(one[0], one[2], ids.STREAM_RELIABLE, one[1])
        while (got := client.line.receive(time.monotonic())) is not None:
            client.take(got)


def blow(good, storms, done, enough, pings=150):
    """What was done while each ping waited, until there was ``enough`` of a storm."""
    found = []
    while len(found) < pings or not enough(found):
        for storm in storms:
            storm.blow()
        found += waits(good, 1, done)
    return sorted(found)


def test_a_storm_of_creations_by_many_does_not_hold_up_others(monkeypatch):
    done = slow(monkeypatch, 0.002)
    with running(level=3) as server:
        good = server.client(1)
        storms = [Storm(server.client(10 + number)) for number in range(8)]
        found = blow(good, storms, done, lambda found: sum(found) > 50)
        # 128 wait in the windows. 20 ms of them at once are 10.
        assert sum(found) > 50 and found[len(found) // 2] <= 10 and found[-1] <= 40, found[-20:]
        assert good.ping() == 1
        assert "internal error" not in server.said.getvalue()


def _make(client, *submessages):
    for submessage in submessages:
        client._put(submessage[0], submessage[2], ids.STREAM_RELIABLE, submessage[1])
    client.until(lambda: not len(client._out), "nothing is acknowledged")


def test_a_client_with_many_endpoints_leaves_in_slices(monkeypatch):
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
        found = waits(good, 30, done)
        assert found[-1] <= 40, found  # 10 ms of them are 5
        # Its name is free at once.
        again = server.client(2)
        assert again.writer("a", "rt/a1", TYPE)
        deadline = time.monotonic() + 10
        while server.call(lambda: len(server.agent.close_queue)):
            assert time.monotonic() < deadline
            assert good.ping() == 1
        assert (0, "rt/a0") not in bus.writers


def _send_object(client, submessage):
    client._put(submessage[0], submessage[2], ids.STREAM_RELIABLE, submessage[1])


def test_timers_that_are_due_all_at_once_leave_others_their_turn():
    """As those of a thousand clients whose streams wait."""
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
    server._selector.close()
    server._wake.close()


def test_what_still_waits_is_closed_at_the_end(monkeypatch):
    slow(monkeypatch, 0.001)
    with running(level=3) as server:
        bad = server.client(2)
        bad.writer("a", "rt/a0", TYPE)
        for number in range(10, 110):
            _send_object(bad, endpoint(oid(number, 5), topic_id=oid(1, 2), parent=oid(1, 3)))
        bad.until(lambda: not len(bad._out), "nothing is acknowledged", 30)
        bad.close()
    assert not server.middleware.bus.writers and not server.middleware.bus.nodes


def test_a_storm_on_dds(own_domain_id):
    """Two clients that make and delete; the third is served."""
    with running_agent("udp", "dds", own_domain_id, level=3) as agent:
        good = XrceClient(agent.line(0), 1)
        assert good.open() == ids.STATUS_OK
        clients = [XrceClient(agent.line(number), 10 + number) for number in (1, 2)]
        assert [it.open() for it in clients] == [ids.STATUS_OK] * 2
        storms = [Storm(it) for it in clients]
        blow(good, storms, [], lambda _: sum(it.made for it in storms) > 100)
        assert good.writer("a", "rt/good", TYPE)


def test_a_storm_is_not_a_storm_of_lines(desk, monkeypatch):
    import io

    from uros.agent import log as log_module

    said = io.StringIO()
    monkeypatch.setattr(log_module, "_INFO_RATE", 0)
    log = Log(INFO, said)
    for number in range(2 * log_module._INFO_BURST):
        log.info("ProxyClient", "create_topic", "topic created", str(number))
    assert said.getvalue().count("\n") == log_module._INFO_BURST
    log.warning("Root", "x", "y", "z")
    assert f"z ({log_module._INFO_BURST} lines of info were left out" in said.getvalue()
    log.warning("Root", "x", "y", "again")
    assert said.getvalue().endswith("again\n")
    log(WARNING, "Root", "x", "y")
    every = io.StringIO()
    debug = Log(5, every)
    for number in range(2 * log_module._INFO_BURST):
        debug.info("ProxyClient", "create_topic", "topic created", str(number))
    assert every.getvalue().count("\n") == 2 * log_module._INFO_BURST
