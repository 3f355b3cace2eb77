import threading

import pytest

from uros.bag.storage import BagMessage
from uros.tools.bag.read_ahead import ReadAhead

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
