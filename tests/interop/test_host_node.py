"""A host node of uros, which joins by DDS directly, and a real rclpy node, in both directions."""

import queue
import threading
from contextlib import contextmanager

import pytest
from support.middleware import host_node
from support.nodes import MESSAGES, Int32, String

from uros.interfaces.codec import from_cdr, to_cdr
from uros.qos import QoSProfile, ReliabilityPolicy

pytestmark = pytest.mark.timeout(120)


@contextmanager
def spinning(node):
    """Spin the node in a thread until the end of the block; nothing else uses it meanwhile."""
    end = threading.Event()
    failed = []

    def run():
        try:
            while not end.is_set():
                node.spin_once(0.05)
            node.destroy_node()
        except BaseException as error:
            failed.append(error)

    thread = threading.Thread(target=run)
    thread.start()
    try:
        yield node
    finally:
        end.set()
        thread.join()
    assert not failed, failed


@pytest.mark.parametrize("type", MESSAGES, ids=lambda type: type.__name__)
def test_rclpy_hears_what_a_host_publishes(peer, domain, type):
    sent = MESSAGES[type]
    topic = f"/from_host/{type.__name__.lower()}"
    node = host_node("host_talker", domain)
    publisher = node.create_publisher(type, topic)
    node.create_timer(0.02, lambda: publisher.publish(sent[publisher.published % len(sent)]))
    with spinning(node):
        peer.do("subscribe", topic=topic, type=type._TYPE)
        received = [from_cdr(type, peer.message(topic)) for _ in range(2 * len(sent) + 1)]
    first = sent.index(received[0])
    assert received == [sent[(first + i) % len(sent)] for i in range(len(received))]
    peer.do("unsubscribe", topic=topic)


@pytest.mark.parametrize("reliability", ["reliable", "best_effort"])
@pytest.mark.parametrize("type", MESSAGES, ids=lambda type: type.__name__)
def test_a_host_hears_what_rclpy_publishes(peer, domain, type, reliability):
    sent = MESSAGES[type]
    topic = f"/to_host/{type.__name__.lower()}_{reliability}"
    messages = queue.Queue()
    node = host_node("host_listener", domain)
    qos = QoSProfile(10, ReliabilityPolicy.RELIABLE)
    if reliability == "best_effort":
        qos.reliability = ReliabilityPolicy.BEST_EFFORT
    node.create_subscription(type, topic, messages.put, qos)

    def publish(*messages):
        cdr = [to_cdr(message).hex() for message in messages]
        answer = peer.do("publish", topic=topic, type=type._TYPE, cdr=cdr, reliability=reliability)
        # The host may have a probe reader too; see middleware/dds/late_writer_heartbeat.py.
        assert answer["subscribers"] >= 1

    with spinning(node):
        # rclpy discovers the reader before the reader discovers rclpy: samples in between are lost.
        for _ in range(50):
            publish(sent[0])
            try:
                assert messages.get(timeout=0.1) == sent[0]
                break
            except queue.Empty:
                pass
        publish(*sent[1:])
        received = []
        while len(received) < len(sent) - 1:
            message = messages.get(timeout=15)
            if message != sent[0]:
                received.append(message)
    assert received == sent[1:]


def test_rclpy_sees_the_node_with_its_endpoints_until_it_is_destroyed(peer, domain):
    node = host_node("weather", domain, namespace="/on_host")
    node.create_publisher(Int32, "count")
    node.create_publisher(String, "~/text")
    node.create_subscription(Int32, "/heard", print)
    topics = {"/on_host/count": Int32._TYPE, "/on_host/weather/text": String._TYPE}
    with spinning(node):
        answer = peer.do("node", namespace="/on_host", name="weather", publishers=topics)
        assert answer["publishers"] is not None, answer
        assert answer["publishers"].items() == {t: [k] for t, k in topics.items()}.items()
        infos = peer.do("topic", topic="/heard", of="subscriptions")["infos"]
        assert [(i["type"], i["reliability"]) for i in infos] == [(Int32._TYPE, "RELIABLE")]
    gone = peer.do("gone", namespace="/on_host", name="weather", seconds=5)
    assert gone["gone"], gone
    for topic in (*topics, "/heard"):
        assert peer.do("unused", topic=topic, seconds=5)["unused"], topic


def test_a_node_that_never_spins_is_seen_and_heard(peer, domain):
    """A program that publishes and never calls spin is in the graph, and its samples arrive."""
    node = host_node("mute", domain)
    publisher = node.create_publisher(Int32, "/never_spun")
    peer.do("subscribe", topic="/never_spun", type=Int32._TYPE)
    while not peer.messages["/never_spun"]:
        publisher.publish(Int32(data=5))
        peer.do("node", namespace="/none", name="none", publishers={}, seconds=0.1)
    assert from_cdr(Int32, peer.message("/never_spun")) == Int32(data=5)
    publisher.publish(Int32(data=6))
    topics = {"/never_spun": Int32._TYPE}
    assert peer.do("node", namespace="/", name="mute", publishers=topics)["publishers"]
    node.destroy_node()
    assert peer.do("gone", namespace="/", name="mute", seconds=5)["gone"]
