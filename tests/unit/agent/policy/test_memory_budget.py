"""The memory budget of all clients: counted, limited, the largest clients are evicted."""

import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.client import XrceClient
from unit.agent.helpers import (
    RESOURCES,
    WRITER,
    Board,
    Desk,
    create_client,
    endpoint,
    fragment,
    group,
    message,
    oid,
    parse,
    participant,
    publisher_entities,
    read_data,
    subscriber_entities,
    topic,
    whole,
    write_data,
    xml,
)
from unit.agent.test_agent import still_works
from unit.agent.test_server import Running

from uros.agent.policy import memory_budget as module
from uros.agent.policy.limits import Limits
from uros.agent.policy.memory_budget import MESSAGE_BYTES, OBJECT_BYTES, MemoryBudget, unlimited
from uros.wire import ids

MB = 1024 * 1024


class Holder:
    def __init__(self, key, size, heard=0):
        self.key, self.size, self.at = key, size, heard

    def held(self):
        return self.size

    def heard(self):
        return self.at


class Clients:
    """Holders of memory, and the budget that counts them."""

    def __init__(self, limit, *sizes):
        self.all = {key: Holder(key, size) for key, size in enumerate(sizes)}
        self.gone = []
        self.counts = 0
        self.budget = MemoryBudget(limit, self._holders, self._dismiss)

    def _holders(self):
        self.counts += 1
        return self.all.values()

    def _dismiss(self, key, size):
        assert self.all.pop(key).size == size
        self.gone.append(key)


# --- the account ------------------------------------------------------------------------


def test_charges_are_added_and_usage_is_recounted_when_the_limit_may_be_hit():
    clients = Clients(MB, 1000)
    assert all(clients.budget.keep(1000) for _ in range(900))
    clients.budget.settle(0)
    assert clients.counts == 0
    while clients.budget.keep(1000):
        pass
    assert not clients.budget.keep(1)  # unchanged until the next count
    clients.budget.settle(0)
    assert clients.counts == 1 and not clients.gone and clients.budget.total == 1000
    assert clients.budget.keep(1000)


def test_the_largest_client_is_evicted_and_clients_within_their_share_stay():
    clients = Clients(MB, MB // 8, MB, MB // 8, 1000)
    clients.budget.since = 2 * MB
    clients.budget.settle(0)
    assert clients.gone == [1]
    assert clients.budget.total == MB // 4 + 1000 and not clients.budget.full


def test_of_large_clients_the_silent_one_is_evicted_first():
    clients = Clients(MB, MB // 2, MB // 2, MB // 2)
    clients.all[0].at, clients.all[1].at, clients.all[2].at = 5000, 100, 5000
    clients.budget.since = 2 * MB
    clients.budget.settle(5001)
    assert clients.gone[0] == 1 and len(clients.gone) == 2


def test_a_clock_that_wraps_is_no_silence():
    clients = Clients(MB, MB, MB // 2)
    clients.all[0].at, clients.all[1].at = 0x3FFFFFFF, 0x3FFFFF00
    clients.budget.since = 2 * MB
    clients.budget.settle(1)
    assert clients.gone == [1, 0] or clients.gone == [0]


def test_a_request_that_may_exceed_the_limit_causes_a_count_at_once():
    clients = Clients(MB, 1000)
    clients.budget.since = MB - 1000
    assert clients.budget.admit(4000) and clients.counts == 1
    clients.all[0].size = MB - 10_000
    clients.budget.since = MB
    assert not clients.budget.admit(4000)
    assert clients.budget.full
    counts = clients.counts
    # Refused clients cause no count.
    assert not clients.budget.admit(1) and clients.counts == counts
    clients.all[0].size = 0
    clients.budget.since = clients.budget.room + 1
    clients.budget.settle(0)
    assert clients.budget.admit(4000)


@given(
    st.integers(1, 1 << 24),
    st.lists(st.integers(0, 1 << 22), max_size=20),
    st.lists(st.integers(0, 1 << 22), max_size=20),
)
def test_the_remaining_clients_are_within_the_limit(limit, sizes, charges):
    clients = Clients(limit, *sizes)
    for size in charges:
        clients.budget.keep(size)
    clients.budget.settle(0)
    if sum(charges) + MESSAGE_BYTES * len(charges) > limit:
        assert sum(holder.size for holder in clients.all.values()) <= limit
    assert clients.budget.room >= 0


def test_a_session_without_an_agent_has_no_limit():
    budget = unlimited()
    assert budget.keep(1 << 60) and budget.admit(1 << 60)
    budget.settle(0)


# --- what is charged ----------------------------------------------------------------------


def desk_of(memory, **more):
    return Desk(limits=Limits(memory=memory, **more))


@pytest.fixture
def small():
    desk = desk_of(MB)
    yield desk
    desk.close()


def fill(desk, count, each=60_000):
    """Open so many sessions, each with an incomplete fragmented message."""
    for number in range(count):
        key = 0x7000 + number
        desk.hear(create_client(key, session_id=0x01, mtu=65507), peer=2)
        desk.hear(message([fragment(bytes(each))], 0x80, 0, 0x01, key), peer=2)
        desk.agent.budget.settle(desk.clock)


def test_fragments_of_many_clients_stay_within_the_memory_budget(small):
    board = Board(small, peer=5, key=5)
    board.ask(*publisher_entities())
    fill(small, 60)
    held_bytes = sum(client.held() for client in small.agent.clients.values())
    assert held_bytes <= MB + 65_000
    assert 5 in small.agent.clients  # its own messages are small
    assert "memory used up" in small.log() and "raise --max-memory" in small.log()
    still_works(small)


def test_a_fragment_without_room_is_sent_again_and_nothing_is_lost(small):
    board = Board(small, mtu=65507)
    board.ask(*publisher_entities())
    written = []
    session = small.agent.clients[board.key].session
    session.writers[WRITER] = lambda cdr: written.append(bytes(cdr[4:])) or True
    sample = bytes(range(256)) * 100
    submessage = whole(write_data(WRITER, sample))
    small.agent.budget.since = small.agent.budget.room + 1  # memory that another client frees
    parts = [
        message(
            [fragment(submessage[start : start + 8000], start + 8000 >= len(submessage))],
            0x80, board.sequence[0x80] + start // 8000,
        )
        for start in range(0, len(submessage), 8000)
    ]  # fmt: skip
    for part in parts:
        small.hear(part)
    assert not written and session.held() == len(parts[0]) - 4 + MESSAGE_BYTES
    small.agent.budget.settle(small.clock)
    small.wait(100)
    for part in parts:  # all but the first are unacknowledged
        small.hear(part)
    assert written == [sample]


def test_early_messages_without_room_are_dropped_and_requested_again(small):
    board = Board(small)
    board.ask(*publisher_entities())
    session = small.agent.clients[board.key].session
    number = board.sequence[0x80]
    budget = small.agent.budget
    budget.since = budget.room + 1
    early = message([write_data(WRITER, b"early")], 0x80, number + 1)
    small.hear(early)
    assert not session._in[0x80].stream.waiting
    assert session._in[0x80].stream.acknack() == (number, 0b11)
    budget.settle(small.clock)
    small.hear(early)
    assert session._in[0x80].stream.acknack() == (number, 0b01)
    assert len(session._in[0x80].stream.waiting) == 1 and session.held() > MESSAGE_BYTES


def test_early_messages_of_a_stalled_stream_likewise(small):
    board = Board(small)
    board.ask(*publisher_entities())
    session = small.agent.clients[board.key].session
    session.writers[WRITER] = lambda cdr: False
    board.send(write_data(WRITER, b"first"))
    budget, number = small.agent.budget, board.sequence[0x80]
    budget.since = budget.room + 1
    for ahead in (0, 1):
        small.hear(message([write_data(WRITER, b"next")], 0x80, number + ahead))
    assert not session._in[0x80].stream.waiting
    budget.settle(small.clock)
    small.hear(message([write_data(WRITER, b"next")], 0x80, number))
    assert len(session._in[0x80].stream.waiting) == 1


def test_objects_and_clients_are_refused_while_the_budget_is_exhausted():
    desk = desk_of(40 * OBJECT_BYTES)
    board = Board(desk)
    answers = board.ask(participant(), *[topic(oid(i, 2), name=f"rt/t{i}") for i in range(60)])
    assert RESOURCES in answers and answers.count(ids.STATUS_OK) > 20
    assert "see --max-memory" in desk.log()
    (_, sent), *_ = desk.hear(create_client(0x99), peer=9)
    assert parse(sent)[1][0][2][0] == RESOURCES
    assert "memory for clients used up" in desk.log()
    assert desk.agent.clients[board.key].objects  # connected clients are served
    # But a client that uses all memory does not keep a new client out for ever.
    desk.agent.budget.settle(desk.clock)
    assert board.key not in desk.agent.clients
    (_, sent), *_ = desk.hear(create_client(0x99), peer=9)
    assert parse(sent)[1][0][2][0] == ids.STATUS_OK
    desk.close()


def test_representations_count_towards_the_budget():
    desk = desk_of(MB, representations=10 * MB)
    board = Board(desk, mtu=65507)
    fat = "<types><struct name='a'/></types>" + " " * 40_000
    answers = []
    for i in range(40):
        answers += board.ask(xml(oid(i, 10), fat))
    assert answers.count(ids.STATUS_OK) < 27 and answers[-1] == RESOURCES
    assert desk.agent.clients[board.key].held() <= MB
    desk.close()


def test_unacknowledged_samples_count_towards_the_budget(small):
    writer = Board(small, peer=5, key=5, mtu=65507)
    writer.ask(*publisher_entities())
    idle = []
    for number in range(30):
        board = Board(small, peer=10 + number, key=10 + number, mtu=65507)
        board.ask(*subscriber_entities())
        board.polite = False
        board.send(read_data(oid(1, ids.KIND_DATAREADER)))
        idle.append(board)
    for _ in range(10):
        writer.send(write_data(WRITER, bytes(50_000)))
        small.agent.budget.settle(small.clock)
        assert sum(client.held() for client in small.agent.clients.values()) < 3 * MB
    assert len(small.agent.clients) < 31
    assert "memory used up" in small.log()


def test_messages_over_max_message_in_both_directions():
    desk = Desk(limits=Limits(message=10_000))
    board = Board(desk, mtu=4000)
    board.ask(*publisher_entities())
    board.ask(*subscriber_entities()[2:])
    board.send(read_data(oid(1, ids.KIND_DATAREADER)))
    client = desk.agent.clients[board.key]
    submessage = whole(write_data(WRITER, bytes(12_000)))
    for start in range(0, len(submessage), 3000):
        board.send(fragment(submessage[start : start + 3000], start + 3000 >= len(submessage)))
    assert "fragments of over 10000 bytes" in desk.log()
    client.session.writers[WRITER](memoryview(bytes((0, 1, 0, 0)) + bytes(12_000)))
    desk.settle()
    assert board.samples() == [] and client.session.dropped == 1
    assert "are too many for stream" in desk.log()
    board.send(write_data(WRITER, bytes(2000)))
    board.settle()
    assert board.samples() == [bytes(2000)]
    desk.close()


def test_the_server_settles_at_the_end_of_a_turn():
    running = Running(level=4)
    running.agent.budget.limit = running.agent.budget.room = 600_000
    running.thread.start()
    assert running.server.ready.wait(10)
    try:
        good = running.client(1)
        for number in range(40):
            bad = XrceClient(good.line, 0x100 + number, session_id=0x01, mtu=60_000)
            bad.line = type(good.line)(running.udp.port)
            running.lines.append(bad.line)
            assert bad.open() in (ids.STATUS_OK, ids.STATUS_ERR_RESOURCES)
            bad.line.send(message([fragment(bytes(50_000))], 0x80, 0, 0x01, 0x100 + number))
            assert good.ping() == 1
        assert (
            running.call(lambda: sum(client.held() for client in running.agent.clients.values()))
            < 700_000
        )
        assert 1 in running.agent.clients
    finally:
        running.server.stop()
        running.thread.join(10)
        for line in running.lines:
            line.close()
    assert "internal error" not in running.said.getvalue()


def test_the_charge_of_an_object_is_about_its_memory():
    """Python's memory is measured; the memory of a middleware is its own."""
    import tracemalloc

    desk = Desk(limits=Limits(objects=10_000))
    desk.agent.log.level = 0
    board = Board(desk, mtu=4000)
    board.ask(participant(), group())
    tracemalloc.start()
    try:
        before = tracemalloc.get_traced_memory()[0]
        for i in range(1, 500):
            board.ask(topic(oid(i, 2), name=f"rt/some/topic/{i}"),
                      endpoint(oid(i, 5), topic_id=oid(i, 2)))  # fmt: skip
        board.inbox.clear()
        each = (tracemalloc.get_traced_memory()[0] - before) / 1000
    finally:
        tracemalloc.stop()
    assert each < module.OBJECT_BYTES
    desk.close()


@pytest.mark.parametrize(
    ("fair", "count", "full"), [(50, 19, True), (49, 19, False), (30, 19, False)]
)
def test_the_budget_after_the_largest_client_was_evicted(fair, count, full):
    """No other client holds more than its share; together they may still leave no room."""
    clients = Clients(1000, *[fair] * count, 1000)
    clients.budget.since = 1001
    clients.budget.settle(0)
    assert len(clients.gone) == 1
    assert clients.budget.total == fair * count
    assert clients.budget.room == 1000 - fair * count
    assert clients.budget.full is full
    assert clients.budget.admit(1) is not full


def test_the_client_with_most_bytes_times_silence_is_evicted():
    """Neither the largest client nor the one that is silent for longest is evicted."""
    clients = Clients(300_000, 150_000, 130_000, 101_000, 1000)
    for key, silence in enumerate((1, 3, 2, 50_000)):
        clients.all[key].at = 60_000 - silence
    clients.budget.since = 300_001
    clients.budget.settle(60_000)
    assert clients.gone[0] == 1
