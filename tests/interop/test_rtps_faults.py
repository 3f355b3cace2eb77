"""RTPS in Python and real rclpy nodes on a bad network: loss, doubling, reordering, ends and stops.

The faults are those of our own sockets, by a seeded generator, and signals to the peer's process.
"""

import contextlib
import random
import signal
import sys
import time

import pytest
from interop.test_ros2_middleware import HERE, TRIGGER, TRIGGER_TYPES, running, text_of
from interop.test_rtps_qos import DataPlane
from support.peer import RosPeer

from uros.interfaces import load
from uros.interfaces.codec import from_cdr, to_cdr
from uros.middleware.base import Service
from uros.middleware.rtps import participant, remote, spdp
from uros.qos import DurabilityPolicy, HistoryPolicy, QoSProfile
from uros.wire import ids

pytestmark = pytest.mark.timeout(180)

TYPE = "std_msgs::msg::dds_::Int32_"
HEAD = b"\0\1\0\0"
BASIC = "test_msgs/srv/BasicTypes"
BASIC_TYPES = (
    "test_msgs::srv::dds_::BasicTypes_Request_",
    "test_msgs::srv::dds_::BasicTypes_Response_",
)
Basic = load(BASIC)
RATE = 0.3


def sample(number):
    return HEAD + number.to_bytes(4, "little")


def service(name, request_type, reply_type):
    return Service(f"rq{name}Request", request_type, f"rr{name}Reply", reply_type)


class RoughSockets:
    """The sockets of a domain: datagrams get lost, doubled, or behind the next one."""

    def __init__(self, sockets, seed):
        self._sockets = sockets
        self._random = random.Random(seed)
        self._sent = []  # the one that is sent behind the next one
        self._received = []

    def __getattr__(self, name):
        return getattr(self._sockets, name)

    def _rough(self, item, waiting):
        """The items to hand on now."""
        draw = self._random.random
        items = [] if draw() < RATE else [item] * (1 + (draw() < RATE))
        if not waiting and draw() < RATE:
            waiting += items
            return []
        items += waiting
        waiting.clear()
        return items

    def send(self, datagram, place):
        return all(
            [self._sockets.send(*item) for item in self._rough((datagram, place), self._sent)]
        )

    def receive(self, fileno):
        for view, source in self._sockets.receive(fileno):
            for octets, origin in self._rough((bytes(view), source), self._received):
                yield memoryview(octets), origin


@pytest.fixture(scope="module")
def peer(ros_python, domain):
    with RosPeer(ros_python, domain, HERE / "service_peer.py") as running:
        yield running


@pytest.fixture
def leases(request, monkeypatch):
    """Short leases for tests that ask for them: ours, and those that we believe."""
    if getattr(request, "param", None) == "ours":
        monkeypatch.setattr(participant, "LEASE_MS", 3000)
        monkeypatch.setattr(spdp, "_PERIOD", 1.0)
    elif getattr(request, "param", None) == "peer":
        monkeypatch.setattr(remote, "MAX_LEASE_MS", 4500)
    return getattr(request, "param", None)


@pytest.fixture
def plane(domain, leases):
    made = DataPlane(domain)
    yield made
    made.close()


def make_rough(plane, domain, seed):
    with plane.lock:
        joined = plane._middleware._domains[domain]
        joined._sockets = RoughSockets(joined._sockets, seed)


class Inbox:
    def __init__(self, plane, topic, qos):
        self.samples = []
        with plane.lock:
            self.reader = plane.node.create_reader(f"rt{topic}", TYPE, qos, self.take)

    def take(self):
        self.samples += self.reader.take(1000)


def keep_all(durability=DurabilityPolicy.VOLATILE):
    return QoSProfile(history=HistoryPolicy.KEEP_ALL, durability=durability)


def publish(plane, writer, numbers, pause=0.0):
    for number in numbers:
        with plane.lock:
            assert writer.write(sample(number))
        time.sleep(pause)


def received(peer, topic, count, seconds=20.0):
    return [peer.message(topic, seconds) for _ in range(count)]


@contextlib.contextmanager
def stopped(peer):
    """The peer's process gets SIGSTOP, and in the end SIGCONT."""
    peer._process.send_signal(signal.SIGSTOP)
    try:
        yield
    finally:
        peer._process.send_signal(signal.SIGCONT)


# --- the link -------------------------------------------------------------------------------------


def test_reliable_topics_both_ways_over_a_rough_link(plane, peer, domain):
    make_rough(plane, domain, 1)
    peer.do("subscribe", topic="/rough_out", type="std_msgs/msg/Int32", depth=300)
    with plane.lock:
        writer = plane.node.create_writer("rt/rough_out", TYPE, keep_all())
    inbox = Inbox(plane, "/rough_in", keep_all(DurabilityPolicy.TRANSIENT_LOCAL))
    plane.until(writer.matched)
    publish(plane, writer, range(200), 0.001)
    done = peer.do(
        "publish", topic="/rough_in", type="std_msgs/msg/Int32", depth=300,
        durability="transient_local", cdr=[sample(number).hex() for number in range(200)],
    )  # fmt: skip
    assert done["subscribers"]
    assert received(peer, "/rough_out", 200) == [sample(number) for number in range(200)]
    plane.until(lambda: len(inbox.samples) >= 200, 30.0)
    assert inbox.samples == [sample(number) for number in range(200)]
    peer.listen(0.3)
    assert not peer.messages["/rough_out"]


def sum_request(number):
    return to_cdr(Basic.Request(int64_value=number, int32_value=1, string_value="+1"))


def test_fifty_calls_each_way_over_a_rough_link(plane, peer, domain):
    """None is lost, doubled, or out of order; those from before the match may be lost."""
    peer.do("add", name="/rough/peer", type=BASIC, depth=100)
    qos = QoSProfile(depth=100)
    replies, served = [], []
    with plane.lock:
        requester = plane.node.create_requester(
            service("/rough/peer", *BASIC_TYPES), qos, lambda: replies.extend(requester.take(100))
        )

        def serve():
            for guid, sequence, cdr in replier.take(100):
                request = from_cdr(Basic.Request, cdr)
                served.append(request.int64_value)
                response = Basic.Response(int64_value=request.int64_value + request.int32_value)
                assert replier.reply(guid, sequence, to_cdr(response))

        replier = plane.node.create_replier(service("/rough/ours", *BASIC_TYPES), qos, serve)

    def call(number):
        with plane.lock:
            return requester.request(sum_request(number))

    for _ in range(50):
        call(-1)
        with contextlib.suppress(AssertionError):
            plane.until(lambda: replies, 0.2)
            break
    peer.do("call", name="/rough/ours", type=BASIC, cdr=sum_request(-1).hex(), seconds=30)
    peer.do("added", name="/rough/peer")
    replies.clear()
    served.clear()
    make_rough(plane, domain, 2)
    sequences = [call(number) for number in range(50)]
    plane.until(lambda: len(replies) >= 50, 60.0)
    assert [sequence for sequence, _ in replies] == sequences
    results = [from_cdr(Basic.Response, cdr).int64_value for _, cdr in replies]
    assert results == list(range(1, 51))
    assert peer.do("added", name="/rough/peer")["added"] == list(range(50))
    answer = peer.do(
        "call_at_once", name="/rough/ours", type=BASIC, depth=100, seconds=60,
        cdr=[sum_request(number).hex() for number in range(50)],
    )  # fmt: skip
    results = [
        from_cdr(Basic.Response, bytes.fromhex(cdr)).int64_value for cdr in answer["replies"]
    ]
    assert results == list(range(1, 51)) and served == list(range(50))


# --- peers that end and stop ----------------------------------------------------------------------


def test_a_server_that_is_killed_and_started_again_while_a_board_calls_it(ros_python, domain):
    name = "/killed/trigger"
    with running(sys.executable, domain, "rtps") as agent, contextlib.ExitStack() as peers:
        board = agent.board(0x61000021)
        requester = board.service(ids.KIND_REQUESTER, "caller", name, *TRIGGER_TYPES)
        board.read(requester)

        def start(text):
            made = peers.enter_context(RosPeer(ros_python, domain, HERE / "service_peer.py"))
            made.do("serve", name=name, type=TRIGGER, text=text)
            return made

        def call():
            """The text of an answer; None where none comes in time."""
            board.write(requester, b"\0")
            if not board.wait_sample(requester, 0.3):
                return None
            return text_of(board.sample(requester)[4:])

        def call_until(text):
            for _ in range(200):
                answer = call()
                if answer is not None and answer.startswith(text):
                    return
            raise AssertionError(f"no answer {text!r}")

        first = start("first {}")
        call_until("first")
        first._process.send_signal(signal.SIGKILL)
        first._process.wait()
        assert [call() for _ in range(3)][-1] is None
        start("second {}")
        call_until("second")
        while board.wait_sample(requester, 0.5):  # answers to the calls before
            answer = text_of(board.sample(requester)[4:])
        numbers = []
        for _ in range(20):
            answer = call()
            assert answer is not None and answer.startswith("second")
            numbers.append(int(answer.split()[1]))
        assert numbers == list(range(numbers[0], numbers[0] + 20))
        board.close()


def test_a_peer_that_is_stopped_for_some_seconds_gets_all_samples(plane, peer):
    peer.do("subscribe", topic="/stopped", type="std_msgs/msg/Int32", depth=300)
    with plane.lock:
        writer = plane.node.create_writer("rt/stopped", TYPE, keep_all())
    plane.until(writer.matched)
    publish(plane, writer, range(10))
    assert received(peer, "/stopped", 10) == [sample(number) for number in range(10)]
    with stopped(peer):
        publish(plane, writer, range(10, 110), 0.02)
    assert received(peer, "/stopped", 100) == [sample(number) for number in range(10, 110)]
    assert writer.matched() == 1


def exchanges(plane, peer, writer, inbox, topics, first):
    """Wait until samples written now arrive at both ends, as matches may be under way."""
    out, back = topics
    inbox.samples.clear()
    for number in range(first, first + 200):
        publish(plane, writer, [number])
        peer.do("publish", topic=back, type="std_msgs/msg/Int32", cdr=[sample(number).hex()])
        peer.listen(0.05)
        with plane.lock:
            if inbox.samples and any(
                int.from_bytes(item[4:8], "little") >= first for item in peer.messages[out]
            ):
                return
    raise AssertionError("nothing arrives any more")


@pytest.mark.parametrize("leases", ["peer", "ours"], indirect=True)
def test_topics_work_again_when_one_side_has_forgotten_the_other(leases, plane, peer):
    """A stop that is longer than the lease of one side: the other one keeps what it knows."""
    topics = f"/forgotten_{leases}_out", f"/forgotten_{leases}_back"
    peer.do("subscribe", topic=topics[0], type="std_msgs/msg/Int32", depth=300)
    with plane.lock:
        writer = plane.node.create_writer(f"rt{topics[0]}", TYPE, QoSProfile())
    inbox = Inbox(plane, topics[1], QoSProfile())
    plane.until(writer.matched)
    exchanges(plane, peer, writer, inbox, topics, 0)
    if leases == "peer":
        with stopped(peer):
            plane.until(lambda: not writer.matched(), 10.0)
    else:
        with plane.lock:
            time.sleep(5.0)
    exchanges(plane, peer, writer, inbox, topics, 1000)


def test_a_farewell_for_one_participant_alone_ends_our_endpoints_there(plane, peer, domain):
    """As the one at the end of a lease, which may find another participant at that place."""
    with plane.lock:
        plane.node.create_writer("rt/farewell", TYPE, QoSProfile())
    assert peer.do("topic", topic="/farewell")["infos"]
    with plane.lock:  # no turn of ours: nothing but the farewell is sent
        joined = plane._middleware._domains[domain]
        participant = joined.participant
        farewells = [
            item
            for remote in participant.remotes.values()
            for item in participant._announcer.give_up(remote)
        ]
        assert farewells
        participant._outbox.datagrams += farewells
        joined.flush()
        assert peer.do("unused", topic="/farewell", seconds=10)["unused"]
