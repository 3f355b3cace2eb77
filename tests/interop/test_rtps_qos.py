"""QoS policies of time between writers on RTPS in Python and a real rclpy subscription."""

import select
import threading
import time

import pytest

from uros.middleware.rtps.middleware import RtpsMiddleware
from uros.qos import DurabilityPolicy, LivelinessPolicy, QoSProfile

pytestmark = pytest.mark.timeout(180)

TYPE = "std_msgs::msg::dds_::Int32_"
LEASE_MS = 2000
SAMPLE = b"\0\1\0\0\1\0\0\0"


class DataPlane:
    """A middleware with one node, and the thread that serves it."""

    def __init__(self, domain, middleware=None):
        self.lock = threading.Lock()
        self.notices = []
        self._middleware = middleware or RtpsMiddleware()
        self._middleware.on_notice = self.notices.append
        self.node = self._middleware.create_node(domain, "/", "rtps")
        self._runs = True
        self._thread = threading.Thread(target=self._serve)
        self._thread.start()

    def _serve(self):
        while self._runs:
            select.select([self._middleware.fileno()], [], [], 0.02)
            with self.lock:
                self._middleware.dispatch()
                deadline = self._middleware.next_deadline()
                if deadline is not None and deadline <= time.monotonic():
                    self._middleware.tick()

    def stop(self):
        """Send nothing more, not even a farewell."""
        self._runs = False
        self._thread.join()

    def write(self, writer):
        with self.lock:
            assert writer.write(SAMPLE)

    def until(self, done, seconds=15.0):
        deadline = time.monotonic() + seconds
        while True:
            with self.lock:
                if done():
                    return
            assert time.monotonic() < deadline, "it does not happen"
            time.sleep(0.01)

    def close(self):
        self.stop()
        self._middleware.close()


@pytest.fixture
def plane(domain):
    made = DataPlane(domain)
    yield made
    made.close()


def create_writer(plane, topic, **qos):
    with plane.lock:
        return plane.node.create_writer(f"rt{topic}", TYPE, QoSProfile(**qos))


def alive(alive, not_alive):
    return {"event": "liveliness", "alive": alive, "not_alive": not_alive}


def subscribe(peer, topic, **qos):
    peer.do("subscribe", topic=topic, type="std_msgs/msg/Int32", **qos)


def test_a_writer_is_alive_for_many_leases_until_its_participant_falls_silent(plane, peer):
    topic = "/alive_automatic"
    writer = create_writer(plane, topic, liveliness_lease_ms=LEASE_MS)
    subscribe(peer, topic, liveliness_lease_duration=LEASE_MS)
    plane.until(writer.matched)
    assert peer.event(topic) == alive(1, 0)
    peer.listen(3 * LEASE_MS / 1000)
    assert not peer.events[topic]
    plane.stop()
    assert peer.event(topic) == alive(0, 1)


def test_a_writer_that_is_deleted_is_not_alive(plane, peer):
    topic = "/alive_deleted"
    writer = create_writer(plane, topic, liveliness_lease_ms=LEASE_MS)
    subscribe(peer, topic, liveliness_lease_duration=LEASE_MS)
    assert peer.event(topic) == alive(1, 0)
    with plane.lock:
        writer.close()
    assert peer.event(topic) == alive(0, 0)


def test_a_writer_with_manual_liveliness_is_alive_while_it_writes(plane, peer):
    topic = "/alive_manual"
    writer = create_writer(
        plane, topic, liveliness=LivelinessPolicy.MANUAL_BY_TOPIC, liveliness_lease_ms=LEASE_MS
    )
    subscribe(
        peer, topic, liveliness="manual_by_topic", liveliness_lease_duration=LEASE_MS
    )  # fmt: skip
    plane.until(writer.matched)
    plane.write(writer)
    assert peer.event(topic) == alive(1, 0)
    for _ in range(15):
        plane.write(writer)
        peer.listen(LEASE_MS / 1000 / 5)
    assert not peer.events[topic]
    assert peer.event(topic) == alive(0, 1)
    plane.write(writer)
    assert peer.event(topic) == alive(1, 0)


@pytest.mark.parametrize(
    ("offered", "requested", "policy", "name"),
    [
        ({"deadline_ms": 2000}, {"deadline": 1000}, "DEADLINE", "deadline"),
        ({}, {"deadline": 1000}, "DEADLINE", "deadline"),
        (
            {"liveliness_lease_ms": 2000},
            {"liveliness_lease_duration": 1000},
            "LIVELINESS",
            "liveliness lease",
        ),
        (
            {"liveliness_lease_ms": 1000},
            {"liveliness": "manual_by_topic", "liveliness_lease_duration": 1000},
            "LIVELINESS",
            "liveliness",
        ),
    ],
    ids=["deadline", "no deadline", "lease", "liveliness"],
)
def test_both_sides_name_what_does_not_match(plane, peer, offered, requested, policy, name):
    topic = "/mismatch_" + "_".join([*offered, *requested])
    create_writer(plane, topic, **offered)
    subscribe(peer, topic, **requested)
    assert peer.event(topic) == {"event": "incompatible", "policy": policy}
    plane.until(lambda: plane.notices)
    assert f": {name} (" in plane.notices[0]


def test_a_late_subscription_gets_no_sample_whose_lifespan_is_over(plane, peer):
    topic = "/lifespan"
    latched = DurabilityPolicy.TRANSIENT_LOCAL
    short = create_writer(plane, topic, durability=latched, lifespan_ms=500)
    lasting = create_writer(plane, topic, durability=latched, lifespan_ms=3_600_000)
    plane.write(short)
    plane.write(lasting)
    peer.listen(1.0)
    subscribe(peer, topic, durability="transient_local")
    plane.until(lambda: short.matched() and lasting.matched())
    assert peer.message(topic) == SAMPLE
    plane.write(short)
    assert peer.message(topic) == SAMPLE
    peer.listen(1.0)
    assert not peer.messages[topic]


def create_reader(plane, topic, **qos):
    with plane.lock:
        return plane.node.create_reader(f"rt{topic}", TYPE, QoSProfile(**qos), lambda: None)


def publish(peer, topic, **qos):
    arguments = {"topic": topic, "type": "std_msgs/msg/Int32", "cdr": [SAMPLE.hex()]}
    return peer.do("publish", **arguments, **qos)["subscribers"]


def test_a_sample_of_a_real_publisher_is_not_taken_after_its_lifespan(plane, peer):
    topic = "/taken_late"
    reader = create_reader(plane, topic)
    assert publish(peer, topic, lifespan=500)
    plane.until(lambda: reader.arrived(1))
    (proxy,) = reader.local.state.writers.values()
    assert proxy.lifespan == 0.5
    over = time.monotonic() + 0.5
    plane.until(lambda: time.monotonic() > over)
    with plane.lock:
        assert not reader.take(1)


@pytest.mark.parametrize(
    ("requested", "offered", "name"),
    [
        ({"deadline_ms": 1000}, {"deadline": 2000}, "deadline"),
        ({"liveliness_lease_ms": 1000}, {"liveliness_lease_duration": 2000}, "liveliness lease"),
        (
            {"liveliness": LivelinessPolicy.MANUAL_BY_TOPIC, "liveliness_lease_ms": 1000},
            {"liveliness_lease_duration": 1000},
            "liveliness",
        ),
    ],
    ids=["deadline", "lease", "liveliness"],
)
def test_a_real_publisher_that_offers_less_is_not_matched_and_named(
    plane, peer, requested, offered, name
):
    topic = "/less_" + "_".join([*requested, *offered])
    reader = create_reader(plane, topic, **requested)
    assert not publish(peer, topic, seconds=1, **offered)
    plane.until(lambda: plane.notices)
    assert f": {name} (" in plane.notices[0] and not reader.local.state.writers


def test_a_missed_deadline_is_reported(plane, peer):
    topic = "/deadline"
    writer = create_writer(plane, topic, deadline_ms=1000)
    subscribe(peer, topic, deadline=1000)
    plane.until(writer.matched)
    plane.write(writer)
    assert peer.message(topic)
    assert peer.event(topic)["event"] == "deadline"
