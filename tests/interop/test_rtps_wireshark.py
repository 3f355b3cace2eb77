"""Wireshark's dissector reads what RTPS in Python exchanges with rclpy and with Cyclone."""

import pytest
from interop.test_rtps_qos import DataPlane
from interop.test_rtps_sizes import TYPE, publish, received, sample, subscribed_writer, write
from support.peer import SCRIPT, RosPeer
from support.rtps_capture import RtpsCapture
from support.tshark import matching

from uros.middleware import open_middleware
from uros.middleware.base import Service
from uros.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy

pytestmark = pytest.mark.timeout(300)

BEST_EFFORT = QoSProfile(reliability=ReliabilityPolicy.BEST_EFFORT)
TRANSIENT_LOCAL = QoSProfile(durability=DurabilityPolicy.TRANSIENT_LOCAL)
ROS_SERVICE = "std_srvs/srv/Trigger"
REQUEST = b"\0\1\0\0\0\0\0\0"
REPLY = b"\0\1\0\0\1\0\0\0" + (4).to_bytes(4, "little") + b"yes\0"
SIZES = (20, 30_000, 300_000)


def service(name):
    kind = "std_srvs::srv::dds_::Trigger"
    return Service(f"rq/{name}Request", kind + "_Request_", f"rr/{name}Reply", kind + "_Response_")


@pytest.fixture
def capture(monkeypatch):
    return RtpsCapture(monkeypatch, drop_every=9)  # so there are repetitions too


@pytest.fixture
def plane(capture, domain):
    made = DataPlane(domain)
    yield made
    made.close()


@pytest.fixture
def peer(ros_python, domain):
    with RosPeer(ros_python, domain, SCRIPT.with_name("service_peer.py")) as running:
        yield running


class Caller:
    """A service client and the replies to it."""

    def __init__(self, node, name):
        self.replies = []
        self.requester = node.create_requester(service(name), QoSProfile(), self.take)

    def take(self):
        self.replies += self.requester.take(10)

    def call(self, plane):
        """Call the service until it replies; requests before the match are lost."""

        def is_answered():
            if not self.replies:
                self.requester.request(REQUEST)
            return self.replies

        plane.until(is_answered)


class Server:
    """A service that answers every request."""

    def __init__(self, node, name):
        self.replier = node.create_replier(service(name), QoSProfile(), self.answer)

    def answer(self):
        for client, sequence, _request in self.replier.take(10):
            assert self.replier.reply(client, sequence, REPLY)


class Inbox:
    """A reader and its samples."""

    def __init__(self, node, topic, qos):
        self.samples = []
        self.reader = node.create_reader(topic, TYPE, qos, self.take)

    def take(self):
        self.samples += self.reader.take(100)


def check(capture, path, kinds):
    """Have tshark read the datagrams: all are RTPS, of these submessages too, none malformed."""
    capture.write(path)
    assert matching(path, "rtps && _ws.malformed") == []
    assert len(matching(path, "rtps")) == len(capture.datagrams)
    for kind in kinds:
        assert matching(path, f"rtps.sm.id == {kind}"), f"no submessage of kind {kind:#x}"


DATA, DATA_FRAG, GAP, HEARTBEAT, ACKNACK, NACK_FRAG = 0x15, 0x16, 0x08, 0x07, 0x06, 0x12


def test_nothing_is_malformed_with_rclpy(capture, plane, peer, tmp_path):
    with plane.lock:
        inbox = Inbox(plane.node, "rt/in", QoSProfile())
        writer = plane.node.create_writer("rt/map", TYPE, TRANSIENT_LOCAL)
        server = Server(plane.node, "ours")
        other_client = Caller(plane.node, "ours")
        caller = Caller(plane.node, "theirs")
    write(plane, writer, sample(0, 100))
    publish(peer, "/in", [sample(1, size) for size in SIZES])
    plane.until(lambda: len(inbox.samples) == len(SIZES))
    for name, qos in (("reliable", QoSProfile()), ("best_effort", BEST_EFFORT)):
        out = subscribed_writer(plane, peer, f"/{name}", qos, name)
        for size in SIZES:
            write(plane, out, sample(2, size))
        if name == "reliable":
            assert [len(received(peer, f"/{name}")) for _ in SIZES] == list(SIZES)
    peer.do("subscribe", topic="/map", type="std_msgs/msg/String", durability="transient_local")
    assert peer.message("/map") == sample(0, 100)
    peer.do("serve", name="/theirs", type=ROS_SERVICE)
    caller.call(plane)
    answer = peer.do("call", name="/ours", type=ROS_SERVICE, cdr=REQUEST.hex(), times=3)
    assert len(answer["replies"]) == 3 and server and other_client
    plane.close()
    check(capture, tmp_path / "rclpy.pcap", (DATA, DATA_FRAG, HEARTBEAT, ACKNACK, NACK_FRAG))


def exchange(source, sink, number):
    """Send samples of all sizes and of two forms of QoS, and call a service."""
    with sink.lock:
        reliable = Inbox(sink.node, f"rt/reliable{number}", QoSProfile())
        best_effort = Inbox(sink.node, f"rt/best_effort{number}", BEST_EFFORT)
        server = Server(sink.node, f"service{number}")
    with source.lock:
        writer = source.node.create_writer(f"rt/reliable{number}", TYPE, QoSProfile())
        lossy = source.node.create_writer(f"rt/best_effort{number}", TYPE, BEST_EFFORT)
        caller = Caller(source.node, f"service{number}")
    for each in (writer, lossy):
        source.until(lambda each=each: each.matched())
        for size in SIZES:
            write(source, each, sample(1, size))
    sink.until(lambda: [len(item) for item in reliable.samples] == list(SIZES), 60)
    caller.call(source)
    assert server and best_effort


@pytest.mark.slow
def test_nothing_is_malformed_with_cyclone(capture, plane, domain, tmp_path):
    cyclone = DataPlane(domain, open_middleware("dds"))
    try:
        exchange(plane, cyclone, 1)
        exchange(cyclone, plane, 2)
    finally:
        cyclone.close()
    plane.close()
    check(capture, tmp_path / "cyclone.pcap", (DATA, DATA_FRAG, HEARTBEAT, ACKNACK, NACK_FRAG))
