"""Probe readers for Fast DDS writers: when they exist, for how long, how many.

Writers of Cyclone stand for those of Fast DDS; tests/interop/test_late_match.py has real ones.
"""

import ctypes
import select
import time

import pytest

from uros.middleware.base import MiddlewareError
from uros.middleware.dds import (
    cyclone,
    discovery,
    late_writer_heartbeat,
    participant,
)
from uros.middleware.dds import middleware as module
from uros.middleware.dds.middleware import DdsMiddleware
from uros.middleware.user_data import PROBE_READER
from uros.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy

TYPE = "std_msgs::msg::dds_::String_"
OTHER_TYPE = "std_msgs::msg::dds_::Int32_"
KEPT = QoSProfile(durability=DurabilityPolicy.TRANSIENT_LOCAL)
LOSSY = QoSProfile(reliability=ReliabilityPolicy.BEST_EFFORT)
SAMPLE = bytes.fromhex("00010000" "02000000" "4100" "0000")  # fmt: skip
SECONDS = 10.0


class World:
    """A middleware that reads, another that writes, and the probe readers of the first."""

    def __init__(self, domain, monkeypatch):
        self.now = 1000.0
        for where in (module, participant, late_writer_heartbeat):
            monkeypatch.setattr(where, "time", self)
        monkeypatch.setattr(late_writer_heartbeat, "FAST_DDS", b"\x01\x10")
        self.probes = {}  # entity: (topic, type, QoS)
        self.probe_count = 0
        self._count_readers(monkeypatch)
        self.middleware, self.writing_middleware = DdsMiddleware(), DdsMiddleware()
        self.node = self.middleware.create_node(domain, "/", "reading")
        self.writing_node = self.writing_middleware.create_node(domain, "/", "writing")

    def _count_readers(self, monkeypatch):
        create = participant.SharedParticipant.create_reader
        delete = participant.SharedParticipant.delete_reader

        def created(shared_participant, topic, type_name, qos, data):
            entity = create(shared_participant, topic, type_name, qos, data)
            if data == PROBE_READER:
                self.probes[entity] = topic, type_name, qos
                self.probe_count += 1
            return entity

        def deleted(shared_participant, entity, *about):
            if entity in self.probes:
                assert self.probes.pop(entity) == about
            delete(shared_participant, entity, *about)

        monkeypatch.setattr(participant.SharedParticipant, "create_reader", created)
        monkeypatch.setattr(participant.SharedParticipant, "delete_reader", deleted)

    def monotonic(self):
        return self.now

    def reader(self, topic="rt/x", qos=None, type_name=TYPE):
        return self.node.create_reader(topic, type_name, qos or QoSProfile(), lambda: None)

    def writer(self, topic="rt/x", qos=None, type_name=TYPE):
        """Create a writer of the other middleware and discover it at once."""
        new_writer = self.writing_node.create_writer(topic, type_name, qos or QoSProfile())
        self.hear()
        return new_writer

    def hear(self):
        """Do what :meth:`dispatch` does after the waiting thread woke (see the first test)."""
        for domain in self.middleware._domains.values():
            if domain._late_writers is not None:
                domain._late_writers._on_ready()

    def due(self):
        return self.middleware.next_deadline()

    def go_on(self, seconds):
        """Advance the clock, and do what is due meanwhile."""
        end = self.now + seconds
        while (due := self.due()) is not None and due <= end:
            self.now = max(self.now, due)
            self.middleware.tick()
        self.now = end

    def settled(self):
        """Advance the clock until nothing is due any more."""
        for _ in range(1000):
            due = self.due()
            if due is None:
                return
            self.now = max(self.now, due)
            self.middleware.tick()
        raise AssertionError("something is always due")

    def close(self):
        self.middleware.close()
        self.writing_middleware.close()


@pytest.fixture
def world(own_domain_id, monkeypatch):
    new_world = World(own_domain_id, monkeypatch)
    yield new_world
    new_world.close()


def test_a_late_writer_matches_a_probe_reader_for_a_moment(world):
    world.reader()
    world.settled()
    world.writing_node.create_writer("rt/x", TYPE, QoSProfile())
    deadline = time.monotonic() + SECONDS
    while world.due() is None:
        assert time.monotonic() < deadline, "nobody heard of the writer"
        if select.select([world.middleware.fileno()], [], [], 0.1)[0]:
            world.middleware.dispatch()
    world.go_on(0.019)
    assert not world.probes
    world.go_on(0.002)
    assert list(world.probes.values()) == [("rt/x", TYPE, QoSProfile(depth=1))]
    world.go_on(0.28)
    assert world.probes
    world.go_on(0.03)
    assert not world.probes and world.due() is None


def test_no_node_lists_the_probe_reader(world):
    world.reader()
    world.settled()
    changes = []
    world.node.participant.changed = lambda: changes.append(1)
    world.writer()
    world.settled()
    assert world.probe_count == 1 and changes == []
    del world.node.participant.changed


def test_writers_that_need_no_heartbeat_get_no_probe_reader(world):
    world.reader("rt/lossy", LOSSY)
    world.reader("rt/met")
    for topic in ("rt/lossy", "rt/unread"):
        world.writer(topic)
    world.settled()
    assert world.probe_count == 0
    # A writer that existed before a reader is matched by the reader itself.
    world.writer("rt/earlier")
    world.reader("rt/earlier")
    world.settled()
    assert world.probe_count == 0


def test_a_writer_before_the_first_reader_gets_no_probe_reader(world):
    world.writer()
    world.reader()
    world.hear()
    domains = world.middleware._domains.values()
    assert [domain._late_writers is not None for domain in domains] == [True]
    world.settled()
    assert world.probe_count == 0


def test_a_reader_that_needs_no_heartbeat_does_not_count_beside_one_that_does(world):
    world.reader(qos=LOSSY)
    world.reader()
    world.writer(qos=LOSSY)
    world.settled()
    assert world.probe_count == 0


def test_any_number_of_writers_may_be_discovered_at_once(world, monkeypatch):
    monkeypatch.setattr(late_writer_heartbeat, "_BATCH", 2)
    for i in range(5):
        world.reader(f"rt/x{i}")
    for i in range(5):
        world.writing_node.create_writer(f"rt/x{i}", TYPE, QoSProfile())
    world.hear()
    world.settled()
    assert world.probe_count == 5


def test_writers_of_others_than_fast_dds_get_none(world, monkeypatch):
    monkeypatch.setattr(late_writer_heartbeat, "FAST_DDS", b"\x01\x0f")
    world.reader()
    world.writer()
    world.settled()
    assert world.probe_count == 0


@pytest.mark.parametrize(
    ("reader", "writer"),
    [
        (KEPT, QoSProfile()),
        (QoSProfile(), LOSSY),
        (QoSProfile(partitions=("a",)), QoSProfile(partitions=("b",))),
    ],
    ids=["durability", "reliability", "partition"],
)
def test_a_writer_that_matches_no_reader_is_checked_twice_and_then_dropped(world, reader, writer):
    world.reader(qos=reader)
    world.settled()
    before = world.now
    world.writer(qos=writer)
    world.settled()
    assert world.probe_count == 0 and world.now - before == pytest.approx(0.32)


def test_a_writer_of_another_type_gets_none(world):
    world.reader()
    world.writer(type_name=OTHER_TYPE)
    world.settled()
    assert world.probe_count == 0


def test_a_writer_that_matches_at_the_second_check_gets_one(world, monkeypatch):
    world.reader()
    real, looks = cyclone.peek_matched_writers, []
    monkeypatch.setattr(
        cyclone,
        "peek_matched_writers",
        lambda reader: real(reader) if looks else looks.append(reader) or set(),
    )
    world.writer()
    world.go_on(0.1)
    assert looks and not world.probes
    world.go_on(0.3)
    assert len(world.probes) == 1


def test_a_writer_that_leaves_before_its_check_is_dropped(world):
    world.reader()
    world.settled()
    world.writer().close()
    world.hear()
    assert world.due() is None


def test_the_probe_reader_is_transient_local_where_one_of_ours_is(world):
    """Otherwise the heartbeat would begin behind the kept samples; our reader would skip them."""
    world.reader()
    world.reader(qos=KEPT)
    world.reader()
    world.writer(qos=KEPT)
    world.go_on(0.1)
    assert [qos.transient_local for _, _, qos in world.probes.values()] == [True]
    # A transient local reader that is not connected does not count.
    world.settled()
    world.writer()
    world.go_on(0.1)
    assert [qos.transient_local for _, _, qos in world.probes.values()] == [False]


def test_the_probe_reader_matches_the_writers_of_our_reader(world):
    qos = QoSProfile(
        depth=100, deadline_ms=5000, ownership_exclusive=True, partitions=("a",), user_data=b"x"
    )
    world.reader(qos=qos)
    world.writer(qos=QoSProfile(deadline_ms=100, ownership_strength=3, partitions=("a",)))
    world.go_on(0.1)
    assert list(world.probes.values()) == [
        ("rt/x", TYPE, QoSProfile(depth=1, ownership_exclusive=True, partitions=("a",)))
    ]
    entity = next(iter(world.probes))
    assert len(cyclone.peek_matched_writers(entity)) == 1


def test_a_thousand_readers_and_many_writers_at_once_share_one_probe_reader(world):
    for _ in range(1000):
        world.reader()
    for _ in range(40):
        world.writer()
        world.now += 0.0004
    world.settled()
    assert world.probe_count == 1


def test_a_writer_that_appears_during_a_probe_gets_a_new_probe_reader_after_a_pause(world):
    world.reader()
    world.writer()
    world.go_on(0.03)
    first = set(world.probes)
    world.writer()
    world.go_on(0.26)
    assert set(world.probes) == first
    world.go_on(0.1)
    assert len(world.probes) == 1 and not first & set(world.probes)
    assert world.probe_count == 2


def test_writers_that_appear_and_leave_for_ever_cause_at_most_three_probe_readers_a_second(world):
    world.reader()
    for _ in range(300):  # three seconds
        world.writer().close()
        world.writer()
        world.go_on(0.01)
        assert len(world.probes) <= 1
    assert 9 <= world.probe_count <= 10


def test_the_number_of_topics_with_a_probe_reader_is_limited(world, monkeypatch):
    monkeypatch.setattr(late_writer_heartbeat, "MAX_READERS", 3)
    for i in range(10):
        world.reader(f"rt/x{i}")
    for i in range(10):
        world.writer(f"rt/x{i}")
    most = 0
    while (due := world.due()) is not None:
        world.now = max(world.now, due)
        before = set(world.probes)
        world.middleware.tick()
        assert len(before - set(world.probes)) <= 1  # one deletion, a millisecond, a tick
        most = max(most, len(world.probes))
    assert most == 3 and world.probe_count == 10


def test_writers_over_the_limit_wait_for_their_heartbeat(world, monkeypatch):
    monkeypatch.setattr(late_writer_heartbeat, "MAX_WRITERS", 5)
    for i in range(8):
        world.reader(f"rt/x{i}")
    for i in range(8):
        world.writer(f"rt/x{i}")
    world.settled()
    assert world.probe_count == 5
    world.writer("rt/x7")
    world.settled()
    assert world.probe_count == 6


def test_a_probe_reader_that_cannot_be_created_is_left_out(world, monkeypatch):
    world.reader()
    world.settled()

    refused = []

    def refuse(*about):
        refused.append(about)
        raise MiddlewareError("out of resources")

    with monkeypatch.context() as patch:
        patch.setattr(participant.SharedParticipant, "create_reader", refuse)
        world.writer()
        world.settled()
    assert len(refused) == 1
    world.writer()
    world.settled()
    assert world.probe_count == 1


def test_the_probe_reader_outlives_the_reader_that_it_was_created_for(world):
    reader = world.reader()
    world.writer()
    world.go_on(0.1)
    reader.close()
    world.node.close()
    world.settled()
    assert not world.probes


def test_our_readers_take_every_sample_once_during_a_probe(world):
    reader = world.reader()
    writer = world.writer()
    world.go_on(0.1)
    assert world.probes
    for _ in range(5):
        assert writer.write(SAMPLE)
    assert reader.take(100) == [SAMPLE] * 5


def test_a_check_does_not_reset_the_status_that_wakes_the_waiting_thread(world):
    """See ``watch_local``: code that resets it must check for samples of others."""
    reader = world.reader()
    world.writing_node.create_writer("rt/x", TYPE, QoSProfile())
    status = ctypes.c_uint32()
    for _ in range(2):
        assert len(cyclone.peek_matched_writers(reader.entity)) == 1
    cyclone._take_status(reader.entity, ctypes.byref(status), cyclone.STATUS_SUBSCRIPTION_MATCHED)
    assert status.value == cyclone.STATUS_SUBSCRIPTION_MATCHED
    # This call resets it.
    world.writing_node.create_writer("rt/x", TYPE, QoSProfile())
    assert len(cyclone.matched_writers(reader.entity)) == 2
    cyclone._take_status(reader.entity, ctypes.byref(status), cyclone.STATUS_SUBSCRIPTION_MATCHED)
    assert status.value == 0


def test_discovery_does_not_list_probe_readers(own_domain_id):
    dds = DdsMiddleware()
    node = dds.create_node(own_domain_id, "/", "looking")
    for data in (PROBE_READER, b""):
        node.participant.create_reader("rt/b", TYPE, QoSProfile(), data)
    graph = discovery.GraphDiscovery(dds.context, node.participant, lambda: None)
    deadline = time.monotonic() + SECONDS
    while not [end for end in graph.endpoints.values() if end.topic == "rt/b"]:
        assert time.monotonic() < deadline
        if select.select([dds.fileno()], [], [], 0.1)[0]:
            dds.dispatch()
    user_data = [end.qos.user_data for end in graph.endpoints.values() if end.topic == "rt/b"]
    assert user_data == [b""]
    graph.close()
    dds.close()
