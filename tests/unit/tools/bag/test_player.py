import pytest
from hypothesis import given
from hypothesis import strategies as st

from uros.bag.storage import BagMessage
from uros.middleware.base import MiddlewareError
from uros.tools.bag.play_clock import PlayClock
from uros.tools.bag.player import ClockTicks, Output, Player

MS = 1_000_000
CDR = b"\0\1\0\0x"


class Source:
    """A queue of messages in place of the thread that reads them."""

    def __init__(self, *times, topic="/x"):
        self.waiting = [BagMessage(topic, CDR + bytes([n]), at, at) for n, at in enumerate(times)]
        self.ended = True

    @property
    def finished(self):
        return self.ended and not self.waiting

    def first(self):
        return self.waiting[0] if self.waiting else None

    def take(self):
        return self.waiting.pop(0)


class Writer:
    """A writer that notes what it writes, and has no room if told so."""

    def __init__(self):
        self.written = []
        self.room = True

    def write(self, cdr):
        if self.room:
            self.written.append(cdr[-1])
        return self.room


class Stage:
    """A player with a clock that the test moves."""

    def __init__(self, *times, rate=1.0, paused=False, topic="/x"):
        self.now = 0
        self.source = Source(*times, topic=topic)
        self.clock = PlayClock(0, rate, 0, paused)
        self.writer = Writer()
        self.output = Output(self.writer)
        self.before = []
        self.player = Player(
            self.source, self.clock, {"/x": self.output}, self.before.append, lambda: self.now
        )

    def at(self, now):
        self.now = now
        return self.player.turn()


def test_each_message_is_published_when_it_is_due():
    stage = Stage(0, 10 * MS, 30 * MS)
    assert stage.at(0) == 10 * MS and stage.writer.written == [0]
    assert stage.at(9 * MS) == 10 * MS and stage.writer.written == [0]
    assert stage.at(11 * MS) == 30 * MS and stage.writer.written == [0, 1]
    stage.at(30 * MS)
    assert stage.writer.written == [0, 1, 2] and stage.player.finished
    assert [message.received_ns for message in stage.before] == [0, 10 * MS, 30 * MS]


def test_late_messages_keep_their_order_and_the_next_ones_their_time():
    stage = Stage(0, 1 * MS, 2 * MS, 100 * MS, rate=2.0)
    assert stage.at(40 * MS) == 50 * MS
    assert stage.writer.written == [0, 1, 2]


def test_many_messages_at_once_leave_the_network_its_turn():
    stage = Stage(*[0] * 100)
    assert stage.at(0) == 0 and len(stage.writer.written) == 64
    stage.at(0)
    assert len(stage.writer.written) == 100


def test_a_topic_that_is_not_played_is_passed_over():
    stage = Stage(0, 0, topic="/other")
    stage.at(0)
    assert stage.player.finished and stage.before == []


def test_a_message_that_was_not_read_yet_is_looked_for_soon():
    stage = Stage()
    stage.source.ended = False
    assert 0 < stage.at(5 * MS) - 5 * MS <= 2 * MS
    assert not stage.player.finished


def test_a_step_publishes_the_next_message_while_paused():
    stage = Stage(0, 50 * MS, 60 * MS, paused=True)
    assert stage.at(1000 * MS) is None
    assert stage.player.step() and stage.player.step()
    assert stage.writer.written == [0, 1]
    assert stage.clock.time(2000 * MS) == 50 * MS
    stage.clock.resume(2000 * MS)
    assert not stage.player.step()
    assert stage.at(2000 * MS) == 2010 * MS
    stage.at(2010 * MS)
    stage.clock.pause(2010 * MS)
    assert not stage.player.step()


def test_a_writer_without_room_is_waited_for_and_then_passed_over():
    stage = Stage(0, 1 * MS, 2 * MS, 3 * MS)
    stage.writer.room = False
    assert stage.at(0) == 1 * MS
    assert stage.at(99 * MS) == 100 * MS and stage.output.dropped == 0
    stage.at(100 * MS)
    assert stage.player.finished and stage.output.dropped == 4


def test_a_writer_that_has_room_again_loses_nothing_more():
    stage = Stage(0, 1 * MS, 2 * MS)
    stage.writer.room = False
    stage.at(0)
    stage.writer.room = True
    stage.at(2 * MS)
    assert stage.writer.written == [0, 1, 2] and stage.output.dropped == 0
    assert stage.output.published == 3


@pytest.mark.parametrize("cdr", [b"", b"\0\1\0"])
def test_a_message_without_header_is_dropped(cdr):
    output = Output(Writer())
    assert output.publish(cdr, 0)
    assert (output.published, output.dropped) == (0, 1)


def test_a_message_that_the_network_refuses_is_dropped():
    class Refusing:
        def write(self, cdr):
            raise MiddlewareError("no")

    output = Output(Refusing())
    assert output.publish(CDR, 0)
    assert output.dropped == 1


@given(st.lists(st.integers(0, 10**9), max_size=30), st.floats(0.1, 10))
def test_the_order_is_that_of_the_bag(times, rate):
    stage = Stage(*sorted(times), rate=rate)
    while not stage.player.finished:
        stage.at(stage.at(stage.now))
    assert stage.writer.written == list(range(len(times)))


# --- /clock -------------------------------------------------------------------------------------


def test_the_clock_is_published_at_its_rate():
    told = []
    ticks = ClockTicks(40, told.append, 0)
    clock = PlayClock(1000 * MS, 2.0, 0)
    assert ticks.turn(clock, 0) == 25 * MS
    assert ticks.turn(clock, 24 * MS) == 25 * MS
    assert ticks.turn(clock, 26 * MS) == 50 * MS
    assert told == [1000 * MS, 1052 * MS]


def test_the_clock_is_published_while_it_stands_still_and_missed_times_are_left_out():
    told = []
    ticks = ClockTicks(10, told.append, 0)
    clock = PlayClock(7, 1.0, 0, paused=True)
    ticks.turn(clock, 0)
    assert ticks.turn(clock, 555 * MS) == 600 * MS
    assert told == [7, 7]
