"""Polling before sleeping: when it begins, how long it lasts, and when it rests."""

import pytest

from uros.poller import BUSY_PAUSE, BUSY_WINDOW, BusyPoll


class Line:
    """A poller on a clock of its own: one poll without waiting takes a microsecond."""

    def __init__(self):
        self.now = 0.0
        self.answer_at = None  # when something will be ready
        self.timeouts = []
        self.busy_poll = BusyPoll(self.poll, lambda: self.now)

    def poll(self, timeout):
        self.timeouts.append(timeout)
        if timeout == 0:
            self.now += 1e-6
        elif self.answer_at is not None:
            self.now = max(self.now, self.answer_at)
        if self.answer_at is not None and self.now >= self.answer_at:
            return [self.ready]
        if timeout:
            self.now += timeout
        return []

    def ready(self):
        pass

    def turn(self, answer_after, timeout=None, expects=True):
        """Deliver a sample that is answered so much later; return the timeouts of the polls."""
        self.timeouts, self.answer_at = [], self.now + answer_after
        if expects:
            self.busy_poll.expect_answer()
        assert self.busy_poll.poll(timeout) == [self.ready]
        return self.timeouts


@pytest.fixture
def line():
    return Line()


SOON, LATE = BUSY_WINDOW / 2, BUSY_WINDOW * 3


def test_without_a_delivery_it_sleeps_at_once(line):
    assert line.turn(SOON, 1.5, expects=False) == [1.5]


def test_an_answer_in_time_is_found_without_sleeping(line):
    timeouts = line.turn(SOON)
    assert set(timeouts) == {0}
    assert line.now == pytest.approx(SOON, abs=2e-6)


def test_a_delivery_is_polled_for_once(line):
    line.turn(SOON)
    assert line.turn(SOON, 2.0, expects=False) == [2.0]


def test_no_answer_in_time_it_sleeps_for_the_rest(line):
    timeouts = line.turn(LATE, 1.0)
    assert timeouts[-1] == pytest.approx(1.0 - BUSY_WINDOW)
    assert len(timeouts) - 1 <= BUSY_WINDOW / 1e-6 + 2
    assert line.turn(LATE, expects=False) == [None]


def test_after_an_answer_that_was_late_it_pauses_then_tries_once(line):
    line.turn(LATE)
    for _ in range(BUSY_PAUSE):
        assert line.turn(LATE) == [None]
    assert 0 in line.turn(LATE)
    assert line.turn(LATE) == [None]


def test_some_late_answers_among_many_do_not_end_it(line):
    for round_number in range(100):
        timeouts = line.turn(LATE if round_number % 10 == 9 else SOON)
        assert timeouts[0] == 0, round_number


def test_late_answers_to_every_second_delivery_end_it(line):
    polled = sum(line.turn(LATE if number % 2 else SOON)[0] == 0 for number in range(100))
    assert polled < 10


@pytest.mark.parametrize("timeout", [0, BUSY_WINDOW / 2])
def test_a_timer_that_is_due_is_not_delayed(line, timeout):
    line.busy_poll.expect_answer()
    assert line.busy_poll.poll(timeout) == []
    assert line.timeouts == [timeout]
