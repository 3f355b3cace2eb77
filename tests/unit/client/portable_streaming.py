"""Messages whose last field is read while they are sent. Also runs on MicroPython."""

from support.board import KEY, Blob, FakeAgent, FakeClock, number_bytes, pattern

from uros.client import AGENT_CONNECTED, Node
from uros.client.streaming import publish_stream, streaming
from uros.qos import QoSProfile, ReliabilityPolicy
from uros.wire import ids
from uros.wire.errors import EncodeError


class Image(Blob):
    """A message of a name of four octets and a sequence of octets, which is empty."""

    def __init__(self):
        super().__init__(b"name" + bytes(4))


class Camera:
    """A source of ``length`` octets, at most ``most`` at a time; it ends after ``ends``."""

    def __init__(self, length, most=100, ends=None):
        self.octets = pattern(length)
        self.at = 0
        self.most = most
        self.ends = length if ends is None else ends

    def readinto(self, view):
        count = min(len(view), self.most, self.ends - self.at)
        view[:count] = self.octets[self.at : self.at + count]
        self.at += count
        return count


class Bench:
    def __init__(self, mtu=512):
        self.clock = FakeClock()
        self.agent = FakeAgent(self.clock, mtu)
        self.node = Node("node", self.agent, key=KEY, clock=self.clock, limit=16384)
        self.node.connection.log = lambda text: None
        self.publisher = self.node.create_publisher(Image, "image")
        self.spin(300)
        assert self.node.state == AGENT_CONNECTED

    def spin(self, ms):
        end = self.clock.t + ms * 1000
        while self.clock.t < end:
            self.node.spin_once((end - self.clock.t) / 1000000)

    def arrived(self):
        return [octets for object_id, octets in self.agent.samples if object_id == 0x05]


def test_a_stream_of_any_length_arrives_whole() -> None:
    for length in (0, 1, 3, 480, 481, 500, 20000, 70000):
        bench = Bench()
        camera = Camera(length)
        assert publish_stream(bench.publisher, Image(), length, camera)
        bench.spin(3000)
        assert bench.arrived() == [b"name" + number_bytes(length) + camera.octets], length
        # The length in the first fragment is 0 over 64 kB, as in the C client.
        fragments = [datagram for datagram in bench.agent.sent if datagram[4] == ids.FRAGMENT]
        assert length < 70000 or fragments[0][10:12] == b"\0\0"
        assert not streaming(bench.publisher) and bench.node.connection.held() == 0


def test_chunks_of_any_size() -> None:
    bench = Bench(64)
    octets = pattern(3000)
    chunks = [octets[:1], b"", octets[1:700], octets[700:2999], octets[2999:]]
    assert publish_stream(bench.publisher, Image(), 3000, chunks)
    bench.spin(3000)
    assert bench.arrived()[0][8:] == octets


def test_no_more_is_read_than_the_window_holds() -> None:
    bench = Bench()
    bench.agent.silent = True
    camera = Camera(100000)
    assert publish_stream(bench.publisher, Image(), 100000, camera)
    bench.spin(100)
    assert camera.at <= 16 * 504
    assert not publish_stream(bench.publisher, Image(), 5, Camera(5))
    assert streaming(bench.publisher) and bench.publisher.dropped == 1


def test_other_samples_wait_for_its_end_and_come_in_order() -> None:
    bench = Bench()
    bench.agent.silent = True
    assert publish_stream(bench.publisher, Image(), 20000, Camera(20000))
    assert bench.publisher.publish(Image())
    bench.agent.silent = False
    bench.spin(2000)
    assert [len(octets) for octets in bench.arrived()] == [20008, 8]


def test_a_source_that_ends_early_ends_the_session() -> None:
    for ends in (0, 10, 9000):
        bench = Bench()
        publish_stream(bench.publisher, Image(), 10000, Camera(10000, 100, ends))
        bench.spin(50)
        assert "broke off" in bench.node.connection.reason
        bench.spin(3000)
        assert bench.node.state == AGENT_CONNECTED and bench.node.connection.connections == 2
        assert bench.arrived() == []
        assert publish_stream(bench.publisher, Image(), 600, Camera(600))
        bench.spin(500)
        assert [len(octets) for octets in bench.arrived()] == [608]


def test_unsuitable_publishers_and_messages_are_refused() -> None:
    bench = Bench()
    best_effort = QoSProfile(5, ReliabilityPolicy.BEST_EFFORT)
    loose = bench.node.create_publisher(Image, "other", best_effort)
    for publisher, message, kind in (
        (loose, Image(), EncodeError), (bench.publisher, Blob(b"1234"), ValueError),
    ):  # fmt: skip
        try:
            publish_stream(publisher, message, 5, Camera(5))
        except kind:
            continue
        raise AssertionError("not refused")
