"""Samples of all sizes between RTPS in Python and rclpy, with receive buffers of 208 kB.

That is the size that Linux gives a socket, and the largest that a process may ask for, unless the
machine is configured otherwise.
"""

import socket

import pytest
from interop.test_rtps_qos import DataPlane

from uros.middleware.rtps import ip_sockets
from uros.qos import QoSProfile, ReliabilityPolicy

pytestmark = pytest.mark.timeout(300)

BUFFER = 212_992
TYPE = "std_msgs::msg::dds_::String_"
ROS_TYPE = "std_msgs/msg/String"
RELIABLE = QoSProfile(depth=10)
BEST_EFFORT = QoSProfile(reliability=ReliabilityPolicy.BEST_EFFORT, depth=100)
SECONDS = 90.0


def sample(number, size):
    """A string as CDR, of so many octets in all, that differs everywhere from other samples."""
    text = (f"{number:07} " * (size // 8)).encode()[: size - 9] + b"\0"
    return b"\0\1\0\0" + len(text).to_bytes(4, "little") + text


GREETING = sample(9_999_999, 24)


@pytest.fixture(scope="module")
def plane(domain):
    buffers = []

    def limit(sock, option, _octets):
        if option == socket.SO_RCVBUF:
            sock.setsockopt(socket.SOL_SOCKET, option, BUFFER // 2)  # Linux doubles it
            buffers.append(sock.getsockopt(socket.SOL_SOCKET, option))

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(ip_sockets, "_enlarge", limit)
        plane = DataPlane(domain)
    assert buffers and set(buffers) == {BUFFER}
    yield plane
    plane.close()


class Inbox:
    """A reader on RTPS and its samples."""

    def __init__(self, plane, topic, qos):
        self.samples = []
        with plane.lock:
            self.reader = plane.node.create_reader("rt" + topic, TYPE, qos, self.take)

    def take(self):
        self.samples += self.reader.take(100)

    @property
    def lost(self):
        return sum(proxy.lost for proxy in self.reader.local.state.writers.values())


def publish(peer, topic, samples, reliability="reliable"):
    answer = peer.do(
        "publish", topic=topic, type=ROS_TYPE, cdr=[item.hex() for item in samples],
        reliability=reliability, seconds=SECONDS,
    )  # fmt: skip
    assert answer["subscribers"]


def subscribed_writer(plane, peer, topic, qos, reliability="reliable"):
    """A writer on RTPS and the peer's subscription, which know each other."""
    peer.do("subscribe", topic=topic, type=ROS_TYPE, reliability=reliability)
    with plane.lock:
        writer = plane.node.create_writer("rt" + topic, TYPE, qos)
    while not peer.messages[topic]:
        write(plane, writer, GREETING)
        peer.do("graph")  # its answer comes behind the messages that have arrived
    return writer


def received(peer, topic):
    """The next sample of a subscription that is no greeting."""
    octets = GREETING
    while octets == GREETING:
        octets = peer.message(topic, SECONDS)
    return octets


def write(plane, writer, octets):
    with plane.lock:
        assert writer.write(octets)


def test_reliable_samples_of_4_mb_come_whole_from_rclpy(plane, peer):
    inbox = Inbox(plane, "/large_in", RELIABLE)
    sent = [sample(number, 4_000_000) for number in range(3)]
    publish(peer, "/large_in", sent)
    plane.until(lambda: len(inbox.samples) == 3, SECONDS)
    assert inbox.samples == sent


def test_reliable_samples_of_4_mb_reach_rclpy_whole(plane, peer):
    writer = subscribed_writer(plane, peer, "/large_out", RELIABLE)
    for number in range(3):
        write(plane, writer, sample(number, 4_000_000))
    for number in range(3):
        assert received(peer, "/large_out") == sample(number, 4_000_000)


def test_best_effort_samples_of_64_kb_come_whole_from_rclpy(plane, peer):
    inbox = Inbox(plane, "/medium_in", BEST_EFFORT)
    sent = [sample(number, 65_536) for number in range(20)]
    for count, item in enumerate(sent, 1):
        publish(peer, "/medium_in", [item], "best_effort")
        plane.until(lambda count=count: len(inbox.samples) == count)
    assert inbox.samples == sent and inbox.lost == 0


def test_best_effort_samples_of_64_kb_reach_rclpy_whole(plane, peer):
    writer = subscribed_writer(plane, peer, "/medium_out", BEST_EFFORT, "best_effort")
    for number in range(20):
        write(plane, writer, sample(number, 65_536))
        assert received(peer, "/medium_out") == sample(number, 65_536)


def test_larger_best_effort_samples_from_rclpy_arrive_whole_or_count_as_lost(plane, peer):
    inbox = Inbox(plane, "/lossy_in", BEST_EFFORT)
    publish(peer, "/lossy_in", [sample(0, 100)], "best_effort")
    plane.until(lambda: inbox.samples)
    sent = [sample(number, 1_000_000) for number in range(1, 6)]
    with plane.lock:  # nobody reads: a buffer of 208 kB cannot hold them
        publish(peer, "/lossy_in", sent, "best_effort")
    end = sample(6, 100)
    publish(peer, "/lossy_in", [end], "best_effort")
    plane.until(lambda: inbox.samples[-1] == end)
    arrived = inbox.samples[1:-1]
    assert set(arrived) <= set(sent)
    assert inbox.lost == len(sent) - len(arrived) > 0


def test_larger_best_effort_samples_to_rclpy_arrive_whole_or_not_at_all(plane, peer):
    writer = subscribed_writer(plane, peer, "/lossy_out", BEST_EFFORT, "best_effort")
    sent = [sample(number, 1_000_000) for number in range(1, 6)]
    for item in sent:
        write(plane, writer, item)
    end = sample(6, 100)
    arrived = []
    while not arrived or arrived[-1] != end:
        write(plane, writer, end)  # the next one, if this is lost
        arrived.append(received(peer, "/lossy_out"))
    assert set(arrived) <= {*sent, end}
