import threading

from uros.bag.metadata import TopicMetadata
from uros.tools.bag.message_cache import MessageCache, Recorded

TOPIC = TopicMetadata("/x", "std_msgs/msg/String")
MB = 1 << 20


def message(number, octets=0):
    return Recorded(TOPIC, bytes(octets), number, number)


def times(entries):
    return [entry.received_ns for entry in entries if isinstance(entry, Recorded)]


def test_topics_and_messages_come_out_in_order():
    cache = MessageCache(MB)
    cache.add_topic(TOPIC)
    cache.add(message(1))
    cache.add(message(2))
    taken, closed = cache.take(0.0)
    assert taken[0] is TOPIC and times(taken) == [1, 2] and not closed
    assert cache.take(0.0) == ([], False)


def test_a_full_cache_drops_and_counts():
    cache = MessageCache(3000)
    for number in range(5):
        cache.add(message(number, 1000))
    assert cache.dropped == 3
    assert times(cache.take(0.0)[0]) == [0, 1]


def test_what_is_being_written_counts_until_the_next_take():
    cache = MessageCache(3000)
    for number in range(2):
        cache.add(message(number, 1000))
    cache.take(0.0)
    cache.add(message(2, 1000))
    assert cache.dropped == 1
    cache.take(0.0)
    cache.add(message(3, 1000))
    assert times(cache.take(0.0)[0]) == [3]


def test_a_half_full_cache_is_taken_at_once():
    cache = MessageCache(3000)
    taken = []
    thread = threading.Thread(target=lambda: taken.append(cache.take(60.0)))
    thread.start()
    for number in range(2):
        cache.add(message(number, 1000))
    thread.join(30)
    assert taken and times(taken[0][0])


def test_without_a_cache_each_message_waits_until_the_one_before_is_taken():
    cache = MessageCache(0)
    cache.add(message(1))
    added = threading.Event()

    def add():
        cache.add(message(2))
        added.set()

    threading.Thread(target=add, daemon=True).start()
    assert not added.wait(0.05)
    assert times(cache.take(60.0)[0]) == [1]
    assert added.wait(30)
    assert times(cache.take(60.0)[0]) == [2]
    assert cache.dropped == 0


def test_a_ring_keeps_the_last_messages_until_a_snapshot():
    cache = MessageCache(3000, ring=True)
    for number in range(10):
        cache.add(message(number, 1000))
    assert cache.take(0.0) == ([], False)
    assert cache.snapshot() == 2
    assert times(cache.take(0.0)[0]) == [8, 9]
    assert cache.snapshot() == 0 and cache.dropped == 0


def test_a_ring_keeps_one_message_that_is_larger():
    cache = MessageCache(10, ring=True)
    cache.add(message(1, 1000))
    assert cache.snapshot() == 1


def test_no_snapshot_without_a_ring():
    assert MessageCache(MB).snapshot() == 0


def test_a_closed_cache_hands_over_what_waits_and_drops_the_rest():
    cache = MessageCache(MB)
    cache.add(message(1))
    cache.close()
    cache.add(message(2))
    taken, closed = cache.take(60.0)
    assert times(taken) == [1] and closed and cache.dropped == 1
