"""Any sequence of corrections: time goes back only for steps of a second or more."""

from hypothesis import given
from hypothesis import strategies as st
from support.board import FakeClock

from uros.client.clock import STEP_US


class Stamp:
    high = low = nanosec = 0

    @property
    def us(self):
        return (self.high << 16 | self.low) * 1_000_000 + self.nanosec // 1000


# Events: microseconds that pass, and the offset of the agent's time in microseconds.
passing = st.integers(0, 400_000_000)
small = st.integers(-STEP_US + 1, 5_000_000)
any_step = st.integers(-(10**12), 10**12)


@given(st.lists(st.tuples(passing, st.one_of(st.none(), small)), max_size=60))
def test_time_never_goes_back_by_answers_that_differ_by_less_than_a_second(events):
    clock = FakeClock()
    clock.set(1_700_000_000, 0)
    stamp = Stamp()
    last = clock.now()
    for passed, off in events:
        clock.t += passed
        before = clock.now()
        assert last <= before
        # A correction backwards slows down and never stops.
        assert passed < 2 or before > last
        last = before
        if off is not None:
            at = before[0] * 1_000_000 + before[1] // 1000 + off
            clock.set(at // 1_000_000, at % 1_000_000 * 1000)
            now = clock.now()
            assert now >= last
            assert now == last if off < 0 else now[0] * 1_000_000 + now[1] // 1000 == at
            last = now
        clock.stamp(stamp)
        assert stamp.us == last[0] * 1_000_000 + last[1] // 1000


@given(st.lists(st.tuples(passing, any_step), max_size=30))
def test_time_goes_back_only_by_a_second_or_more_and_then_all_at_once(events):
    clock = FakeClock()
    clock.set(1_700_000_000, 0)
    last = 1_700_000_000 * 1_000_000
    for passed, off in events:
        clock.t += passed
        seconds, nanoseconds = clock.now()
        before = seconds * 1_000_000 + nanoseconds // 1000
        assert before >= last
        at = max(before + off, 0)
        clock.set(at // 1_000_000, at % 1_000_000 * 1000)
        seconds, nanoseconds = clock.now()
        last = seconds * 1_000_000 + nanoseconds // 1000
        if at < before and at - before > -STEP_US:
            assert last == before
        else:
            assert last == at


@given(st.integers(1, STEP_US - 1), st.lists(st.integers(1, 300_000), min_size=1, max_size=50))
def test_a_correction_backwards_is_made_at_half_speed_and_no_further(ahead, steps):
    clock = FakeClock()
    clock.set(1_700_000_000, 0)
    start = clock.t
    clock.set(1_700_000_000 - 1, 1_000_000_000 - ahead * 1000)
    for step in steps:
        clock.t += step
        seconds, nanoseconds = clock.now()
        time_us = (seconds - 1_700_000_000) * 1_000_000 + nanoseconds // 1000
        passed = clock.t - start
        right = passed - ahead
        assert right <= time_us <= passed
        assert time_us <= max(right, (passed + len(steps) + 1) // 2 + 1)
