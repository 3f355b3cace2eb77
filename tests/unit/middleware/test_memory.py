"""Behaviour of the memory middleware alone; the contract tests cover the rest."""

import pytest

from uros.middleware import memory
from uros.middleware.base import Service
from uros.middleware.memory import Bus, MemoryMiddleware
from uros.qos import DurabilityPolicy, HistoryPolicy, QoSProfile

INT32, STRING = "std_msgs::msg::dds_::Int32_", "std_msgs::msg::dds_::String_"


@pytest.fixture
def middlewares():
    bus = Bus()
    pair = [MemoryMiddleware(bus) for _ in range(2)]
    yield pair
    for middleware in pair:
        middleware.close()


def test_local_samples_are_delivered_at_the_end_of_the_burst(middlewares):
    """One turn later, a killed agent would lose the sample, which is acknowledged by then."""
    node = middlewares[0].create_node(0, "/", "n")
    samples = []
    reader = node.create_reader("rt/a", INT32, QoSProfile(), lambda: samples.extend(reader.take(9)))
    middlewares[0].dispatch_local()
    node.create_writer("rt/a", INT32, QoSProfile()).write(b"sample")
    middlewares[0].dispatch_local()
    assert samples == [b"sample"]


def watched(middleware):
    conflicts = []
    middleware.on_type_conflict = lambda *words: conflicts.append(words)
    return conflicts


def test_a_type_that_differs_is_reported_to_the_second_endpoint(middlewares):
    first, second = map(watched, middlewares)
    first_node, second_node = [item.create_node(0, "/", "n") for item in middlewares]
    first_node.create_writer("rt/a", INT32, QoSProfile())
    second_node.create_reader("rt/a", STRING, QoSProfile(), print)
    second_node.create_reader("rt/b", STRING, QoSProfile(), print)
    assert (first, second) == ([], [("rt/a", STRING, INT32)])


def test_services_are_compared_too(middlewares):
    _, second = map(watched, middlewares)
    first_node, second_node = [item.create_node(0, "/", "n") for item in middlewares]
    first_node.create_replier(Service("rq/a", "A", "rr/a", "B"), QoSProfile(), print)
    second_node.create_requester(Service("rq/a", "A", "rr/a", "C"), QoSProfile(), print)
    assert second == [("rr/a", "C", "B")]


def test_replies_to_others_do_not_hide_an_own_reply(middlewares):
    node = middlewares[0].create_node(0, "/", "n")
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


def test_the_samples_kept_for_late_readers_are_limited(middlewares, monkeypatch):
    monkeypatch.setattr(memory, "MAX_PAST", 10)
    node = middlewares[0].create_node(0, "/", "node")
    qos = QoSProfile(history=HistoryPolicy.KEEP_ALL, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    writer = node.create_writer("rt/a", INT32, qos)
    for number in range(100):
        writer.write(bytes((0, 1, 0, 0, number, 0, 0, 0)))
    reader = node.create_reader("rt/a", INT32, qos, lambda: None)
    assert [sample[4] for sample in reader.take(100)] == list(range(90, 100))
