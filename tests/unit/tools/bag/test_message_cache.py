import threading

from uros.bag.metadata import TopicMetadata
from uros.tools.bag import message_cache
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


# --- topics whose definition is asked for -------------------------------------------------------

HELD = TopicMetadata("/held", "my_msgs/msg/X")


def held(number, octets=0):
    return Recorded(HELD, bytes(octets), number, number)


def test_messages_of_a_topic_are_held_until_the_topic_is_handed_over():
    cache = MessageCache(MB)
    cache.add_topic(TOPIC)
    cache.hold(HELD)
    for entry in (held(1), message(2), held(3)):
        cache.add(entry)
    assert cache.take(0.0)[0] == [TOPIC, message(2)]
    cache.add_topic(HELD)
    cache.add(held(4))
    assert cache.take(0.0)[0] == [HELD, held(1), held(3), held(4)]


def test_what_is_held_takes_room_of_the_cache():
    cache = MessageCache(3000)
    cache.hold(HELD)
    cache.add(held(1, 1000))
    cache.take(0.0)
    cache.take(0.0)
    cache.add(message(2, 1000))
    cache.add(message(3, 1000))
    cache.add(held(4, 1000))
    assert cache.dropped == 2
    assert times(cache.take(0.0)[0]) == [2]
    cache.add_topic(HELD)
    assert times(cache.take(0.0)[0]) == [1]
    cache.take(0.0)
    for number in (5, 6):
        cache.add(held(number, 1000))
    assert cache.dropped == 2 and times(cache.take(0.0)[0]) == [5, 6]


def test_without_a_cache_messages_are_held_within_a_limit(monkeypatch):
    """They do not wait for those before them: that would end the search for the definition."""
    monkeypatch.setattr(message_cache, "_MOST_HELD", 3000)
    cache = MessageCache(0)
    cache.hold(HELD)
    for number in range(4):
        cache.add(held(number, 1000))
    assert cache.dropped == 2
    cache.close()
    assert cache.take(0.0) == ([HELD, held(0, 1000), held(1, 1000)], True)


def test_a_closed_cache_hands_over_what_was_held():
    cache = MessageCache(MB)
    cache.hold(HELD)
    cache.add(held(1))
    cache.close()
    cache.close()
    assert cache.take(60.0) == ([HELD, held(1)], True)


def test_a_snapshot_waits_for_the_topics_of_its_messages():
    cache = MessageCache(MB, ring=True)
    cache.hold(HELD)
    cache.add(held(1))
    assert cache.snapshot() == 1 and cache.take(0.0)[0] == []
    cache.add_topic(HELD)
    assert cache.take(0.0)[0] == [HELD, held(1)]
