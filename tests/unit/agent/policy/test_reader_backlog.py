"""The backlog of middleware readers: its bytes are bounded and part of the memory budget."""

import pytest
from hypothesis import given
from hypothesis import strategies as st
from unit.agent.helpers import (
    READER,
    REPLIER,
    SUBSCRIBER,
    WRITER,
    Board,
    Desk,
    delete,
    group,
    of,
    participant,
    publisher_entities,
    read_data,
    service,
    subscriber_entities,
    xml,
)

from uros.agent.policy import reader_backlog as module
from uros.agent.policy.limits import Limits
from uros.agent.policy.memory_budget import MESSAGE_BYTES, MemoryBudget, unlimited
from uros.agent.policy.reader_backlog import Backlog
from uros.middleware.base import Service
from uros.qos import HistoryPolicy, QoSProfile, services_profile
from uros.wire import ids

MB = 1024 * 1024
KEEP_ALL = (
    "<data_reader><topic><name>rt/chatter</name><dataType>T</dataType>"
    "<historyQos><kind>KEEP_ALL</kind></historyQos></topic>"
    "<qos><reliability><kind>RELIABLE</kind></reliability></qos></data_reader>"
)


class Reader:
    """A middleware reader that keeps the last samples up to its depth, given by their sizes."""

    def __init__(self, depth):
        self.depth = depth
        self.samples = []
        self.untold = 0

    def put(self, *sizes):
        self.samples += sizes
        self.untold += len(sizes)
        del self.samples[: max(0, len(self.samples) - self.depth)]

    def take(self, limit):
        samples, self.samples = self.samples[:limit], self.samples[limit:]
        self.untold = min(self.untold, len(self.samples))
        return samples

    def arrived(self, limit):
        untold = min(self.untold, len(self.samples))
        count = min(untold, limit)
        self.untold = untold - count
        return self.samples[len(self.samples) - untold :][:count]


def octets(*sizes):
    return sum(sizes) + MESSAGE_BYTES * len(sizes)


def test_waiting_samples_are_charged_until_they_are_taken():
    reader, budget = Reader(10), unlimited()
    backlog = Backlog(reader, 10, budget, pytest.fail)
    reader.put(100, 200)
    assert not backlog.check()
    assert backlog.octets == budget.since == octets(100, 200)
    assert not backlog.check() and budget.since == octets(100, 200)
    backlog.took(len(reader.take(1)), 1)
    assert backlog.octets == octets(200) and not backlog.empty
    backlog.took(len(reader.take(5)), 5)
    assert not backlog.octets and backlog.empty


def test_samples_displaced_by_the_depth_are_no_longer_counted():
    reader, budget = Reader(3), unlimited()
    backlog = Backlog(reader, 3, budget, pytest.fail)
    for size in range(1, 10):
        reader.put(size * 1000)
        backlog.check()
    assert backlog.octets == octets(7000, 8000, 9000)
    assert budget.since == backlog.octets  # an unchanged amount is charged once


def test_over_the_limit_the_oldest_samples_are_dropped_and_one_of_any_size_stays():
    warnings = []
    reader, budget = Reader(5000), unlimited()
    backlog = Backlog(reader, 5000, budget, warnings.append)
    for _ in range(316):
        reader.put(MB)
        backlog.check()
    assert backlog.octets <= module.MAX_UNREAD_BYTES
    assert sum(reader.samples) > module.MAX_UNREAD_BYTES - 2 * MB
    assert len(warnings) == 316 - len(reader.samples) and "1 samples that wait" in warnings[0]
    assert budget.freed
    reader.put(100 * MB)
    backlog.check()
    assert reader.samples == [100 * MB]


def test_a_reader_may_use_an_eighth_of_the_budget():
    budget = MemoryBudget(8 * MB, lambda: (), lambda *_: None)
    backlog = Backlog(Reader(9), 9, budget, lambda _: None)
    assert backlog._most == MB


def test_one_check_counts_a_limited_number_of_samples():
    reader = Reader(5000)
    backlog = Backlog(reader, 5000, unlimited(), pytest.fail)
    reader.put(*[1] * (module.MAX_LOOKED_AT + 5))
    assert backlog.check() and not backlog.check()
    assert backlog.octets == octets(*[1] * (module.MAX_LOOKED_AT + 5))


@given(st.lists(st.tuples(st.sampled_from("plt"), st.integers(1, 6)), max_size=80))
def test_the_count_covers_all_waiting_samples_and_is_zero_when_empty(steps):
    reader = Reader(7)
    backlog = Backlog(reader, 7, unlimited(), pytest.fail)
    for step, count in steps:
        if step == "p":
            reader.put(*[10] * count)
        elif step == "l":
            while backlog.check():
                pass
            assert backlog.octets >= octets(*reader.samples)
        else:
            backlog.took(len(reader.take(count)), count)
        assert backlog.octets <= octets(*[10] * 7)
    while backlog.check():
        pass
    backlog.empty = False
    while not backlog.empty:
        backlog.took(len(reader.take(3)), 3)
    assert not backlog.octets


# --- at the agent ----------------------------------------------------------------------------


@pytest.fixture
def small():
    desk = Desk(limits=Limits(memory=64 * MB))
    yield desk
    desk.close()


def far_writer(desk, topic="rt/chatter", type_name="T"):
    node = desk.middleware.create_node(0, "/", "far")
    return node.create_writer(topic, type_name, QoSProfile(history=HistoryPolicy.KEEP_ALL))


def keeping_all(desk, peer=1, key=1):
    board = Board(desk, peer, key, mtu=60_000)
    assert board.ask(participant(), group(SUBSCRIBER), xml(READER, KEEP_ALL, SUBSCRIBER)) == [0] * 3
    return board


def unread_of(board, object_id=READER):
    reader = of(board).objects[object_id].endpoint
    return sum(map(len, reader._reader._samples._samples))


def flood(desk, writer, count=316, size=MB):
    for _ in range(count):
        writer.write(b"\0\1\0\0" + bytes(size))
        desk.settle()
        desk.agent.budget.settle(desk.clock)


@pytest.mark.parametrize("requested", ["never", "once"])
def test_a_reader_that_keeps_all_is_bounded_in_octets_and_counted(small, requested):
    board = keeping_all(small)
    board.polite = False  # the client acknowledges nothing: its window is soon full
    if requested == "once":
        board.send(read_data(READER))
    flood(small, far_writer(small))
    assert 7 * MB < unread_of(board) <= 8 * MB  # an eighth
    assert unread_of(board) <= of(board).held() < 64 * MB
    assert "samples dropped" in small.log()
    assert small.log().count("samples dropped") < 10
    assert small.agent.budget.freed


def test_read_samples_and_samples_of_a_closed_reader_are_no_longer_charged(small):
    board, writer = keeping_all(small), far_writer(small)
    bare = of(board).held()
    flood(small, writer, 6, 200_000)
    assert of(board).held() > bare + 6 * 200_000
    board.send(read_data(READER))
    board.wait(1000)
    assert len(board.samples()) == 6
    assert of(board).held() == bare
    board.send(read_data(READER, control=(0, 0, 0, 0)))
    flood(small, writer, 6)
    assert of(board).held() > bare + 6 * MB
    small.agent.budget.freed = False
    board.ask(delete(READER))
    assert of(board).held() < bare and small.agent.budget.freed


def test_readers_of_many_clients_stay_within_the_memory_budget(small):
    for number in range(1, 21):
        keeping_all(small, number, number)
    flood(small, far_writer(small), 30)
    held_bytes = sum(client.held() for client in small.agent.clients.values())
    assert held_bytes <= 64 * MB and len(small.agent.clients) < 20
    assert "memory used up" in small.log()


def test_a_client_that_reads_causes_no_check(desk, monkeypatch):
    board = Board(desk)
    board.ask(*subscriber_entities())
    board.send(read_data(READER))
    monkeypatch.setattr(Backlog, "check", pytest.fail)
    writer = far_writer(desk, type_name="std_msgs::msg::dds_::Int32_")
    for number in range(50):
        writer.write(b"\0\1\0\0" + number.to_bytes(4, "little"))
        board.settle()
    assert len(board.samples()) == 50


def test_waiting_requests_are_counted(small):
    board = Board(small)
    board.ask(participant(), service(REPLIER))
    bare = of(board).held()
    node = small.middleware.create_node(0, "/", "far")
    pair = of(board).objects[REPLIER].named
    endpoint_service = Service(pair[0], pair[1], "rr/addReply", "example::srv::dds_::Add_Response_")
    requester = node.create_requester(endpoint_service, services_profile(), lambda: None)
    for _ in range(20):
        requester.request(b"\0\1\0\0" + bytes(MB))
        small.settle()
    assert bare + 7 * MB < of(board).held() < bare + 9 * MB
    board.send(read_data(REPLIER))
    board.wait(1000)
    assert of(board).held() == bare


def test_samples_kept_by_a_transient_local_writer_are_counted(small):
    board = Board(small, mtu=60_000)
    entities = publisher_entities()[:3]
    text = (
        "<data_writer><topic><name>rt/chatter</name><dataType>T</dataType>"
        "<historyQos><kind>KEEP_LAST</kind><depth>3</depth></historyQos></topic>"
        "<qos><durability><kind>TRANSIENT_LOCAL</kind></durability></qos></data_writer>"
    )
    assert board.ask(*entities, xml(WRITER, text, ids.KIND_PUBLISHER | 0x10)) == [0] * 4
    bare = of(board).held()
    write = of(board).session.writers[WRITER]
    for size in (1000, 2000, 3000, 4000):
        assert write(memoryview(bytes(size)))
    assert of(board).held() == bare + octets(2000, 3000, 4000)
    board.ask(delete(WRITER))
    assert of(board).held() < bare
