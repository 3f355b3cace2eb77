"""Samples that a writer holds back until a flush, observed from another process."""

import queue
import subprocess
import sys
import threading
import time

import pytest

from uros.middleware.dds import cyclone
from uros.middleware.dds.middleware import DdsMiddleware
from uros.qos import QoSProfile, ReliabilityPolicy

TYPE = "std_msgs::msg::dds_::UInt8_"
SECONDS = 20.0

# Prints the topic and the number of each sample that it receives.
LISTENER = """
import select, sys
from uros.middleware.dds.middleware import DdsMiddleware
from uros.qos import QoSProfile, ReliabilityPolicy
middleware = DdsMiddleware()
node = middleware.create_node(int(sys.argv[1]), "/", "listener")
readers = {}
qos = QoSProfile(100, ReliabilityPolicy.BEST_EFFORT)
for topic in ("rt/held", "rt/marker"):
    readers[topic] = node.create_reader(topic, sys.argv[2], qos, lambda: None)
print("ready", flush=True)
while True:
    for topic, reader in readers.items():
        for sample in reader.take(100):
            print(topic, sample[4], flush=True)
    if select.select([middleware.fileno(), sys.stdin], [], [])[0] == [sys.stdin]:
        break
    middleware.dispatch()
middleware.close()
"""


class Listener:
    def __init__(self, domain):
        self._process = subprocess.Popen(
            [sys.executable, "-c", LISTENER, str(domain), TYPE],
            stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, bufsize=1,
        )  # fmt: skip
        self._lines = queue.Queue()
        self._thread = threading.Thread(target=self._read, daemon=True)
        self._thread.start()
        assert self.line() == "ready"

    def _read(self):
        for line in self._process.stdout:
            self._lines.put(line.strip())

    def line(self, seconds=SECONDS):
        """Return the next line, or None if none arrives in that time."""
        try:
            return self._lines.get(timeout=seconds)
        except queue.Empty:
            return None

    def close(self):
        self._process.stdin.close()
        self._process.wait(SECONDS)
        self._thread.join(SECONDS)
        self._process.stdout.close()


@pytest.fixture
def listener(own_domain_id):
    process = Listener(own_domain_id)
    yield process
    process.close()


@pytest.fixture
def middleware():
    dds = DdsMiddleware()
    dds.batching = True
    yield dds
    dds.close()


def sample(number):
    return b"\x00\x01\x00\x00" + bytes([number])


def greet(middleware, writer, listener, topic):
    """Write until the listener has found the writer."""
    deadline = time.monotonic() + SECONDS
    while True:
        writer.write(sample(255))
        middleware.flush()
        if listener.line(0.1) == f"{topic} 255":
            break
        assert time.monotonic() < deadline
    while listener.line(0.3) is not None:
        pass


def test_samples_wait_for_flush_and_are_sent_whole_and_in_order(
    middleware, listener, own_domain_id
):
    node = middleware.create_node(own_domain_id, "/", "writer")
    batched = node.create_writer("rt/held", TYPE, QoSProfile(100, ReliabilityPolicy.BEST_EFFORT))
    greet(middleware, batched, listener, "rt/held")
    middleware.batching = False
    marker = node.create_writer("rt/marker", TYPE, QoSProfile())
    greet(middleware, marker, listener, "rt/marker")
    for number in range(10):
        assert batched.write(sample(number))
    marker.write(sample(7))
    assert listener.line() == "rt/marker 7"  # overtook the samples that are held back
    middleware.flush()
    assert [listener.line() for _ in range(10)] == [f"rt/held {n}" for n in range(10)]


def test_closing_a_writer_sends_the_samples_that_it_held_back(middleware, listener, own_domain_id):
    node = middleware.create_node(own_domain_id, "/", "writer")
    batched = node.create_writer("rt/held", TYPE, QoSProfile(100, ReliabilityPolicy.BEST_EFFORT))
    greet(middleware, batched, listener, "rt/held")
    batched.write(sample(1))
    batched.close()
    assert listener.line() == "rt/held 1"
    middleware.flush()  # of a writer that is closed


def test_writers_hold_nothing_back_without_batching(monkeypatch, own_domain_id):
    flushed = []
    monkeypatch.setattr(cyclone, "flush", flushed.append)
    dds = DdsMiddleware()
    node = dds.create_node(own_domain_id, "/", "writer")
    writer = node.create_writer("rt/held", TYPE, QoSProfile())
    writer.write(sample(1))
    assert dds.context.unsent == set()
    writer.close()
    dds.close()
    assert flushed == []
