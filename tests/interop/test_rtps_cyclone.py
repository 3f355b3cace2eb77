"""Nodes on RTPS in Python and nodes on Cyclone DDS 11, both ways, in every form of QoS."""

import pytest
from interop.test_rtps_qos import DataPlane
from interop.test_rtps_sizes import sample, write
from interop.test_rtps_wireshark import Caller, Inbox, Server

from uros.middleware import open_middleware
from uros.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy

pytestmark = pytest.mark.timeout(180)

TYPE = "std_msgs::msg::dds_::String_"
DURABILITIES = (DurabilityPolicy.VOLATILE, DurabilityPolicy.TRANSIENT_LOCAL)
CALLS = 200


@pytest.fixture(params=["from-cyclone", "to-cyclone"])
def ends(request, domain):
    """The end that writes and calls, and the other."""
    rtps, cyclone = DataPlane(domain), DataPlane(domain, open_middleware("dds"))
    yield (cyclone, rtps) if request.param == "from-cyclone" else (rtps, cyclone)
    rtps.close()
    cyclone.close()


def create_writer(plane, topic, qos):
    with plane.lock:
        return plane.node.create_writer(topic, TYPE, qos)


def create_inbox(plane, topic, qos):
    with plane.lock:
        return Inbox(plane.node, topic, qos)


def qos(reliability, durability):
    return QoSProfile(reliability=reliability, durability=durability, depth=100)


GREETING = sample(0, 24)


def greet(source, sink, writer, inbox):
    """Write until the reader has discovered the writer: what is written before is lost."""

    def has_come():
        write(source, writer, GREETING)
        return inbox.samples

    source.until(writer.matched)
    sink.until(has_come)


@pytest.mark.parametrize("durability", DURABILITIES, ids=("volatile", "transient-local"))
@pytest.mark.parametrize("size", [100, 65_536, 4_000_000])
def test_reliable_samples_arrive_once_and_in_order(ends, durability, size):
    source, sink = ends
    profile = qos(ReliabilityPolicy.RELIABLE, durability)
    inbox = create_inbox(sink, "rt/reliable", profile)
    writer = create_writer(source, "rt/reliable", profile)
    greet(source, sink, writer, inbox)
    sent = [sample(number, size) for number in range(2 if size > 100_000 else 50)]
    for item in sent:
        write(source, writer, item)
    sink.until(lambda: inbox.samples[-1] == sent[-1], 90)
    assert [item for item in inbox.samples if item != GREETING] == sent


@pytest.mark.parametrize("durability", DURABILITIES, ids=("volatile", "transient-local"))
@pytest.mark.parametrize("size", [100, 65_536])
def test_best_effort_samples_arrive_whole(ends, durability, size):
    source, sink = ends
    profile = qos(ReliabilityPolicy.BEST_EFFORT, durability)
    inbox = create_inbox(sink, "rt/best_effort", profile)
    writer = create_writer(source, "rt/best_effort", profile)
    greet(source, sink, writer, inbox)
    for number in range(1, 21):
        item = sample(number, size)
        write(source, writer, item)
        sink.until(lambda item=item: item in inbox.samples)
    assert {len(item) for item in inbox.samples} == {len(GREETING), size}


def test_a_late_reader_gets_what_was_written_before_if_it_is_transient_local(ends):
    source, sink = ends
    profile = qos(ReliabilityPolicy.RELIABLE, DurabilityPolicy.TRANSIENT_LOCAL)
    writer = create_writer(source, "rt/map", profile)
    sent = [sample(number, 40_000) for number in range(5)]
    for item in sent:
        write(source, writer, item)
    late = create_inbox(sink, "rt/map", profile)
    volatile = create_inbox(sink, "rt/map", QoSProfile(depth=100))
    sink.until(lambda: late.samples == sent)
    source.until(lambda: writer.matched() == 2)
    new = sample(5, 100)
    write(source, writer, new)
    sink.until(lambda: late.samples[-1] == new and volatile.samples)
    assert volatile.samples == [new]


def test_a_service_answers_each_call_once(ends):
    source, sink = ends
    with sink.lock:
        server = Server(sink.node, "answer")
    with source.lock:
        caller = Caller(source.node, "answer")
    caller.call(source)
    for _ in range(CALLS):
        with source.lock:
            number = caller.requester.request(b"\0\1\0\0\0\0\0\0")
        source.until(lambda number=number: number in dict(caller.replies))
    numbers = [number for number, _ in caller.replies]
    assert len(numbers) == len(set(numbers)) and server
