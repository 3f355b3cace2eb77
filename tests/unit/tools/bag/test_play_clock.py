from hypothesis import given
from hypothesis import strategies as st

from uros.tools.bag.play_clock import PlayClock

S = 10**9


def test_the_time_of_a_message_is_due_at_the_rate():
    clock = PlayClock(100 * S, 2.0, 5 * S)
    assert clock.due(100 * S) == 5 * S
    assert clock.due(110 * S) == 10 * S
    assert clock.time(10 * S) == 110 * S


def test_a_paused_clock_stands_still():
    clock = PlayClock(100 * S, 1.0, 0)
    clock.pause(3 * S)
    assert clock.paused and clock.due(200 * S) is None
    assert clock.time(50 * S) == 103 * S
    clock.pause(60 * S)
    clock.resume(60 * S)
    clock.resume(60 * S)
    assert clock.due(104 * S) == 61 * S


def test_it_may_be_paused_from_the_beginning():
    clock = PlayClock(7, 1.0, 0, paused=True)
    assert clock.time(99 * S) == 7
    clock.resume(100 * S)
    assert clock.due(7 + S) == 101 * S


def test_another_rate_holds_from_now_on():
    clock = PlayClock(0, 1.0, 0)
    assert clock.set_rate(0.5, 10 * S)
    assert clock.time(10 * S) == 10 * S
    assert clock.due(11 * S) == 12 * S
    for wrong in (0.0, -0.1, float("nan"), float("inf")):
        assert not clock.set_rate(wrong, 11 * S)
    assert clock.rate == 0.5


def test_a_jump():
    clock = PlayClock(0, 1.0, 0)
    clock.jump(500 * S, 10 * S)
    assert clock.due(501 * S) == 11 * S


@given(st.integers(0, 2 * 10**18), st.floats(0.01, 100), st.integers(0, 3600 * S))
def test_there_is_no_drift(start, rate, passed):
    """What is due after an hour is due at its own time, whatever was due before it."""
    clock = PlayClock(start, rate, 0)
    due = clock.due(start + passed)
    assert abs(clock.time(due) - (start + passed)) <= max(1, rate)
