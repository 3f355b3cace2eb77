"""What wakes the data plane for samples of others: none is left in its reader without a call."""

import select
import time

from uros.middleware.dds.middleware import DdsMiddleware
from uros.qos import DurabilityPolicy, QoSProfile

TYPE = "std_msgs::msg::dds_::String_"
SAMPLE = bytes.fromhex("00010000" "02000000" "4100" "0000")  # fmt: skip
SECONDS = 10.0


def taking_reader(node, topic, received):
    """A reader whose samples are appended to ``received``."""
    reader = node.create_reader(topic, TYPE, QoSProfile(), lambda: received.extend(reader.take(9)))
    return reader


def take_one(middleware, received):
    """Dispatch as a server does until a sample is received."""
    deadline = time.monotonic() + SECONDS
    while not received:
        left = deadline - time.monotonic()
        assert left > 0, "on_ready was not called"
        if select.select([middleware.fileno()], [], [], left)[0]:
            middleware.dispatch()


def test_a_sample_between_the_match_and_its_dispatch_is_reported(own_domain_id):
    """It wakes nobody by itself: the reader waits for matches alone until then."""
    reading, writing = DdsMiddleware(), DdsMiddleware()
    received = []
    taking_reader(reading.create_node(own_domain_id, "/", "reading"), "rt/x", received)
    node = writing.create_node(own_domain_id, "/", "writing")
    # In one process the endpoints match, and the sample arrives, before these calls return.
    assert node.create_writer("rt/x", TYPE, QoSProfile()).write(SAMPLE)
    take_one(reading, received)
    assert received == [SAMPLE]
    writing.close()
    reading.close()


def test_a_reader_is_not_called_for_a_writer_without_samples(own_domain_id):
    """Not even one that it matches while it is created."""
    reading, writing = DdsMiddleware(), DdsMiddleware()
    calls, received = [], []
    node = reading.create_node(own_domain_id, "/", "reading")
    writing_node = writing.create_node(own_domain_id, "/", "writing")
    kept = QoSProfile(durability=DurabilityPolicy.TRANSIENT_LOCAL)
    writer = writing_node.create_writer("rt/x", TYPE, kept)
    for _ in range(50):
        node.create_reader("rt/x", TYPE, QoSProfile(), lambda: calls.append(1))
        reader = taking_reader(node, "rt/y", received)
        other = writing_node.create_writer("rt/y", TYPE, kept)
        assert other.write(SAMPLE)
        take_one(reading, received)
        received.clear()
        other.close()
        reader.close()
    assert calls == []
    assert writer.write(SAMPLE)
    take_one(reading, calls)
    writing.close()
    reading.close()
