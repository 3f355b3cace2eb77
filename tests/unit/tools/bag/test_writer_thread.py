import threading

import pytest

from uros.bag.errors import BagError
from uros.bag.metadata import TopicMetadata
from uros.tools.bag.message_cache import MessageCache, Recorded
from uros.tools.bag.writer_thread import WriterThread

TOPIC = TopicMetadata("/x", "std_msgs/msg/String")
FULL = "x.mcap: No space left on device"


class Bag:
    """A BagWriter that notes what is asked of it, and fails where it is told to."""

    def __init__(self, fails_at=None, fails_to_close=False):
        self.calls = []
        self.flushed = threading.Event()
        self._fails_at = fails_at
        self._fails_to_close = fails_to_close

    def add_topic(self, topic):
        self.calls.append(("topic", topic.name))
        return 7

    def write(self, number, cdr, received_ns, sent_ns):
        if received_ns == self._fails_at:
            raise BagError(FULL)
        self.calls.append((number, cdr, received_ns, sent_ns))

    def flush(self):
        self.calls.append("flush")
        self.flushed.set()

    def split(self):
        self.calls.append("split")

    def close(self):
        self.calls.append("close")
        if self._fails_to_close:
            raise BagError(FULL)


def message(number):
    return Recorded(TOPIC, b"cdr", number, number + 1)


def running(bag, clock=lambda: 0.0):
    cache = MessageCache(1 << 20)
    cache.add_topic(TOPIC)
    return cache, WriterThread(bag, cache, clock)


def test_what_is_in_the_cache_is_written_and_the_bag_closed():
    bag = Bag()
    cache, thread = running(bag)
    cache.add(message(1))
    cache.add(message(2))
    thread.close()
    thread.close()
    assert bag.calls == [
        ("topic", "/x"), (7, b"cdr", 1, 2), (7, b"cdr", 2, 3), "flush", "close",
    ]  # fmt: skip
    assert (thread.written, thread.octets, thread.lost, thread.error) == (2, 6, 0, None)
    assert not thread.is_alive


def test_it_flushes_while_it_records():
    now = [0.0]

    def clock():
        now[0] += 1.0
        return now[0]

    bag = Bag()
    cache, thread = running(bag, clock)
    cache.add(message(1))
    assert bag.flushed.wait(30)
    assert "close" not in bag.calls
    thread.close()


@pytest.mark.parametrize("fails_to_close", [False, True])
def test_a_full_disk_ends_it_and_what_is_lost_is_counted(fails_to_close):
    bag = Bag(fails_at=2, fails_to_close=fails_to_close)
    cache = MessageCache(1 << 20)
    cache.add_topic(TOPIC)
    for number in range(5):
        cache.add(message(number))
    thread = WriterThread(bag, cache)
    thread._thread.join(30)
    assert not thread.is_alive
    assert str(thread.error) == FULL
    assert (thread.written, thread.lost) == (0, 5)  # those that were not flushed too
    assert bag.calls[-1] == "close"
    cache.add(message(9))
    assert cache.dropped == 1
    thread.close()


def test_a_split_comes_before_the_next_messages():
    bag = Bag()
    cache, thread = running(bag)
    thread.split()
    thread.close()
    assert "split" in bag.calls
