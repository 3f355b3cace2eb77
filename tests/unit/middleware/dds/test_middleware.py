"""Participants shared by nodes, their discovery info, and what a profile may ask for."""

import pytest

from uros.middleware import domains, open_middleware
from uros.middleware.base import MiddlewareError
from uros.middleware.dds import cyclone, participant
from uros.middleware.dds import middleware as module
from uros.middleware.dds.middleware import DdsMiddleware
from uros.middleware.discovery_info import codec
from uros.middleware.discovery_info.codec import decode
from uros.qos import HistoryPolicy, QoSProfile

TYPE = "std_msgs::msg::dds_::String_"


@pytest.fixture
def middleware():
    dds = DdsMiddleware()
    yield dds
    dds.close()


class Clock:
    """The clock of the middleware, set by the test."""

    def __init__(self, monkeypatch):
        self.now = 1000.0
        for where in (module, participant):
            monkeypatch.setattr(where, "time", self)

    def monotonic(self):
        return self.now


class Listener:
    """Reads ``ros_discovery_info`` from a participant of its own."""

    def __init__(self, middleware, domain):
        node = middleware.create_node(domain, "/", "listener")
        qos = codec.qos()
        qos.history = HistoryPolicy.KEEP_ALL
        self._reader = node.create_reader(codec.TOPIC, codec.TYPE, qos, lambda: None)

    def take(self):
        return self._reader.take(10_000)


def test_fifty_nodes_share_a_participant_and_the_next_gets_another(middleware, own_domain_id):
    nodes = [middleware.create_node(own_domain_id, "/", f"node{i}") for i in range(51)]
    guids = [node.participant.guid for node in nodes]
    assert len(set(guids)) == 2 and len(set(guids[:50])) == 1
    # A place that becomes free is used again.
    nodes[7].close()
    assert middleware.create_node(own_domain_id, "/", "late").participant.guid == guids[0]


def test_domains_do_not_share(middleware, own_domain_id, domain_id):
    first = middleware.create_node(own_domain_id, "/", "one")
    second = middleware.create_node(domain_id, "/", "other")
    assert first.participant.guid != second.participant.guid


def test_the_number_of_domains_is_limited(middleware, own_domain_id, domain_id, monkeypatch):
    monkeypatch.setattr(domains, "MAX_JOINED", 1)
    middleware.create_node(own_domain_id, "/", "one")
    with pytest.raises(MiddlewareError, match="one more than the 1 that this agent may join"):
        middleware.create_node(domain_id, "/", "other")
    middleware.create_node(own_domain_id, "/", "other")


def test_changes_are_announced_at_most_ten_times_a_second_and_the_last_one_too(
    middleware, own_domain_id, monkeypatch
):
    clock = Clock(monkeypatch)
    listener = Listener(middleware, own_domain_id)
    node = middleware.create_node(own_domain_id, "/", "busy")
    writers = []
    for _ in range(1000):  # a change each millisecond
        writers.append(node.create_writer("rt/x", TYPE, QoSProfile()))
        if len(writers) > 5:
            writers.pop(0).close()
        clock.now += 0.001
        due = middleware.next_deadline()
        if due is not None and due <= clock.now:
            middleware.tick()
    assert 8 <= len(listener.take()) <= 10
    while (due := middleware.next_deadline()) is not None:
        clock.now = due
        middleware.tick()
    last = decode(listener.take()[-1])
    assert last is not None
    busy = [item for item in last[1] if item.name == "busy"]
    assert [item.writers for item in busy] == [[writer.guid for writer in writers]]
    clock.now += 3600
    middleware.tick()
    assert listener.take() == []  # no change, no announcement


def test_a_boards_entities_go_into_one_announcement(middleware, own_domain_id, monkeypatch):
    clock = Clock(monkeypatch)
    listener = Listener(middleware, own_domain_id)
    clock.now += 1
    middleware.tick()
    listener.take()
    clock.now += 1
    node = middleware.create_node(own_domain_id, "/", "board")
    for i in range(10):
        node.create_writer(f"rt/topic{i}", TYPE, QoSProfile())
        clock.now += 0.001
        middleware.tick()
    clock.now = middleware.next_deadline()
    middleware.tick()
    assert len(listener.take()) == 1
    assert middleware.next_deadline() is None


def test_an_announcement_without_room_is_repeated(middleware, own_domain_id, monkeypatch):
    clock = Clock(monkeypatch)
    middleware.create_node(own_domain_id, "/", "node")
    write = cyclone.write
    monkeypatch.setattr(cyclone, "write", lambda *_: False)
    clock.now = middleware.next_deadline()
    middleware.tick()
    assert middleware.next_deadline() is not None
    monkeypatch.setattr(cyclone, "write", write)
    clock.now = middleware.next_deadline()
    middleware.tick()
    assert middleware.next_deadline() is None


def test_a_node_that_leaves_is_no_longer_announced(middleware, own_domain_id, monkeypatch):
    clock = Clock(monkeypatch)
    listener = Listener(middleware, own_domain_id)
    node = middleware.create_node(own_domain_id, "/ns", "board")
    node.create_reader("rt/x", TYPE, QoSProfile(), lambda: None)
    names = []
    for change in (lambda: None, node.close):
        change()
        clock.now += 1
        middleware.tick()
        names.append([(item.namespace, item.name) for item in decode(listener.take()[-1])[1]])
    assert names == [[("/", "listener"), ("/ns", "board")], [("/", "listener")]]


@pytest.mark.parametrize(("distro", "size"), [("humble", 24), ("jazzy", 16)])
def test_the_distribution_decides_how_long_a_gid_is(own_domain_id, monkeypatch, distro, size):
    monkeypatch.setenv("ROS_DISTRO", distro)
    middleware = DdsMiddleware()
    try:
        clock = Clock(monkeypatch)
        listener = Listener(middleware, own_domain_id)
        clock.now += 1
        middleware.tick()
        sample = listener.take()[-1]
        assert sample[4 + size : 8 + size] == b"\1\0\0\0"  # one node follows the Gid
        assert decode(sample)[1][0].name == "listener"
    finally:
        middleware.close()


def test_a_localhost_profile_is_refused_where_the_domain_is_open(own_domain_id, monkeypatch):
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "SUBNET")
    middleware = DdsMiddleware()
    try:
        with pytest.raises(MiddlewareError, match="ROS_AUTOMATIC_DISCOVERY_RANGE=LOCALHOST"):
            middleware.create_node(own_domain_id, "/", "px4", localhost_only=True)
        assert middleware._domains == {}  # the check opened nothing
    finally:
        middleware.close()


def test_a_localhost_profile_is_honoured_where_nothing_leaves(middleware, own_domain_id):
    middleware.create_node(own_domain_id, "/", "px4", localhost_only=True)


def test_partitions_separate_topics(middleware, own_domain_id):
    node = middleware.create_node(own_domain_id, "/", "node")
    inboxes = {
        name: node.create_reader("rt/x", TYPE, QoSProfile(partitions=name), lambda: None)
        for name in ((), ("left",), ("right",), ("left", "right"))
    }
    writer = node.create_writer("rt/x", TYPE, QoSProfile(partitions=("left",)))
    writer.write(b"\0\1\0\0\0\0\0\0")
    receivers = {name for name, inbox in inboxes.items() if inbox.take(1)}
    assert receivers == {("left",), ("left", "right")}


def test_writing_without_dispatch_takes_bounded_memory(middleware, own_domain_id):
    node = middleware.create_node(own_domain_id, "/", "node")
    node.create_reader("rt/x", TYPE, QoSProfile(), lambda: None)
    writer = node.create_writer("rt/x", TYPE, QoSProfile())
    for _ in range(100):
        writer.write(b"\0\1\0\0\0\0\0\0")
    # The reader, and the readers of its topic.
    assert len(middleware.context.dispatcher.noted) <= 2


def test_a_broken_configuration_is_named(monkeypatch, own_domain_id):
    monkeypatch.setenv("CYCLONEDDS_URI", "<nix")
    middleware = open_middleware("dds")
    try:
        with pytest.raises(MiddlewareError, match="is CYCLONEDDS_URI right"):
            middleware.create_node(own_domain_id, "/", "node")
    finally:
        middleware.close()


def test_an_unknown_range_is_reported_at_once(monkeypatch):
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "blah")
    with pytest.raises(MiddlewareError, match="'BLAH' does not exist"):
        open_middleware("dds")
