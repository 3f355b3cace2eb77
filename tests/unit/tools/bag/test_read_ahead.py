import threading

import pytest
from hypothesis import given
from hypothesis import strategies as st

from uros.bag.storage import BagMessage
from uros.tools.bag.read_ahead import ReadAhead, by_time_sent

SECONDS = 30


def message(number, octets=1):
    return BagMessage("/x", bytes(octets), number, number)


class Bag:
    """Messages of a bag, with how many were read."""

    def __init__(self, *messages, error=None):
        self.read = 0
        self.changed = threading.Condition()
        self.closed = threading.Event()
        self._messages = messages
        self._error = error

    def messages(self):
        try:
            for each in self._messages:
                with self.changed:
                    self.read += 1
                    self.changed.notify_all()
                yield each
            if self._error:
                raise self._error
        finally:
            self.closed.set()

    def wait_for(self, count):
        with self.changed:
            assert self.changed.wait_for(lambda: self.read >= count, SECONDS)


def wait_until(condition):
    ready = threading.Event()
    while not condition():
        ready.wait(0.001)


def test_messages_come_out_in_order():
    bag = Bag(*map(message, range(5)))
    ahead = ReadAhead(bag.messages(), 100)
    wait_until(lambda: ahead.is_filled)
    assert [ahead.take().received_ns for _ in range(5)] == [0, 1, 2, 3, 4]
    assert ahead.first() is None and ahead.finished
    ahead.close()


def test_it_reads_no_more_than_it_may_and_goes_on_when_half_is_taken():
    bag = Bag(*map(message, range(100)))
    ahead = ReadAhead(bag.messages(), 10)
    wait_until(lambda: ahead.is_filled)
    assert bag.read == 11  # one waits outside
    for _ in range(4):
        ahead.take()
    assert bag.read == 11 and ahead.is_filled
    ahead.take()
    bag.wait_for(16)
    ahead.close()


def test_large_messages_are_bounded_by_their_octets():
    bag = Bag(*(message(number, 1000) for number in range(10)))
    ahead = ReadAhead(bag.messages(), 1000, max_octets=1500)
    wait_until(lambda: ahead.is_filled)
    assert bag.read == 3
    taken = [ahead.take().received_ns]
    while not ahead.finished:
        if ahead.first() is not None:
            taken.append(ahead.take().received_ns)
    assert taken == list(range(10))
    ahead.close()


def test_an_error_comes_after_the_messages_before_it():
    bag = Bag(message(0), error=ValueError("cut short"))
    ahead = ReadAhead(bag.messages(), 10)
    wait_until(lambda: ahead.is_filled)
    assert not ahead.finished
    ahead.take()
    assert ahead.finished and str(ahead.error) == "cut short"
    ahead.close()


@pytest.mark.parametrize("limit", [1, 10])
def test_close_ends_the_thread_and_the_reader(limit):
    bag = Bag(*map(message, range(100)))
    ahead = ReadAhead(bag.messages(), limit)
    bag.wait_for(1)
    ahead.close()
    ahead.close()
    assert bag.closed.is_set() and ahead.finished


# --- the order in which messages were sent -------------------------------------------------------


def sent_at(*times, octets=1):
    """Yield messages that were received in this order and sent at these times."""
    for number, sent in enumerate(times):
        yield BagMessage("/x", bytes([number]) * octets, 1000 + number, sent)


def numbers(messages):
    return [each.cdr[0] for each in messages]


def test_messages_come_out_as_they_were_sent_with_that_time():
    found = list(by_time_sent(sent_at(30, 10, 20, 10), 9))
    assert [(each.cdr[0], each.received_ns) for each in found] == [
        (1, 10), (3, 10), (2, 20), (0, 30),
    ]  # fmt: skip
    (unknown,) = by_time_sent(sent_at(0), 9)  # such as of a publisher without a clock
    assert unknown.received_ns == 1000


def test_a_message_that_many_have_overtaken_comes_late():
    assert numbers(by_time_sent(sent_at(20, 30, 40, 10), 1)) == [0, 1, 3, 2]
    assert numbers(by_time_sent(sent_at(20, 30, 40, 10, octets=50), 9, 60)) == [0, 1, 3, 2]


@given(st.lists(st.integers(1, 99), max_size=30), st.integers(1, 30))
def test_each_message_comes_out_once_and_in_order_if_enough_are_compared(times, limit):
    found = [each.sent_ns for each in by_time_sent(sent_at(*times), limit)]
    assert sorted(found) == sorted(times)
    if limit >= len(times):
        assert found == sorted(times)


def test_the_bag_is_closed_with_the_messages():
    bag = Bag(message(1), message(2))
    ordered = by_time_sent(bag.messages(), 1)
    next(ordered)
    ordered.close()
    assert bag.closed.is_set()
