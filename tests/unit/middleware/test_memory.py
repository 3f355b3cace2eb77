"""What is memory's own; the rest is in the contract that all middlewares keep."""

import pytest

from uros.middleware import memory
from uros.middleware.base import Service
from uros.middleware.memory import Bus, MemoryMiddleware
from uros.qos import DurabilityPolicy, HistoryPolicy, QoSProfile

INT32, STRING = "std_msgs::msg::dds_::Int32_", "std_msgs::msg::dds_::String_"


@pytest.fixture
def made():
    bus = Bus()
    ones = [MemoryMiddleware(bus) for _ in range(2)]
    yield ones
    for one in ones:
        one.close()


def test_what_this_process_wrote_is_there_right_after_the_burst(made):
    """A turn later it would be lost with an agent that is killed, and is acknowledged by then."""
    one = made[0].create_node(0, "/", "n")
    got = []
    reader = one.create_reader("rt/a", INT32, QoSProfile(), lambda: got.extend(reader.take(9)))
    made[0].dispatch_local()
    one.create_writer("rt/a", INT32, QoSProfile()).write(b"sample")
    made[0].dispatch_local()
    assert got == [b"sample"]


def watched(middleware):
    seen = []
    middleware.on_type_conflict = lambda *words: seen.append(words)
    return seen


def test_a_type_that_differs_is_reported_to_who_comes_second(made):
    first, second = map(watched, made)
    one, two = [item.create_node(0, "/", "n") for item in made]
    one.create_writer("rt/a", INT32, QoSProfile())
    two.create_reader("rt/a", STRING, QoSProfile(), print)
    two.create_reader("rt/b", STRING, QoSProfile(), print)
    assert (first, second) == ([], [("rt/a", STRING, INT32)])


def test_services_are_compared_too(made):
    _, second = map(watched, made)
    one, two = [item.create_node(0, "/", "n") for item in made]
    one.create_replier(Service("rq/a", "A", "rr/a", "B"), QoSProfile(), print)
    two.create_requester(Service("rq/a", "A", "rr/a", "C"), QoSProfile(), print)
    assert second == [("rr/a", "C", "B")]


def test_others_replies_do_not_hide_ones_own(made):
    node = made[0].create_node(0, "/", "n")
    service = Service("rq/a", "A", "rr/a", "B")
    replier = node.create_replier(service, QoSProfile(100), print)
    requesters = [node.create_requester(service, QoSProfile(100), print) for _ in range(2)]
    for i in range(5):
        requesters[0].request(b"\0\1\0\0" + bytes([i]))
    requesters[1].request(b"\0\1\0\0mine")
    for guid, sequence, sample in replier.take(100):
        assert replier.reply(guid, sequence, sample)
    assert requesters[1].take(1) == [(1, b"\0\1\0\0mine")]
    assert requesters[1].take(1) == []
    assert len(requesters[0].take(100)) == 5


def test_a_writer_that_keeps_all_for_late_readers_keeps_an_end_of_it(made, monkeypatch):
    monkeypatch.setattr(memory, "MAX_PAST", 10)
    node = made[0].create_node(0, "/", "node")
    qos = QoSProfile(history=HistoryPolicy.KEEP_ALL, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    writer = node.create_writer("rt/a", INT32, qos)
    for number in range(100):
        writer.write(bytes((0, 1, 0, 0, number, 0, 0, 0)))
    reader = node.create_reader("rt/a", INT32, qos, lambda: None)
    assert [sample[4] for sample in reader.take(100)] == list(range(90, 100))
