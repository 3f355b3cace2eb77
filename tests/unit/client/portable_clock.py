"""Ticks, and the clock synchronized with the agent. Also runs on MicroPython."""

from support.board import FakeClock

from uros import ticks
from uros.client.clock import Clock
from uros.ticks import TIME_MASK, ticks_diff


class Stamp:
    high = low = nanosec = 0

    @property
    def sec(self):
        return self.high << 16 | self.low


def test_ticks_have_30_bits_and_advance() -> None:
    for read, unit in ((ticks.ticks_ms, 1), (ticks.ticks_us, 1000)):
        before = read()
        ticks.sleep_ms(5)
        after = read()
        assert 0 <= before <= TIME_MASK and 0 <= after <= TIME_MASK
        # Ports that count ticks of a millisecond sleep up to one less, and read up to one less.
        assert 3 * unit <= ticks_diff(after, before) < 2000 * unit
    clock = Clock()
    assert ticks_diff(clock.ms(), ticks.ticks_ms()) <= 0
    assert ticks_diff(clock.us(), ticks.ticks_us()) <= 0


def test_time_counts_from_the_start_until_it_is_set() -> None:
    clock = FakeClock()
    assert not clock.synchronized and clock.now() == (0, 0)
    clock.sleep(2500)
    assert clock.now() == (2, 500000000)
    clock.set(1700000000, 999999000)
    assert clock.synchronized and clock.now() == (1700000000, 999999000)


def test_nothing_is_stamped_before_the_time_is_known() -> None:
    clock = FakeClock()
    stamp = Stamp()
    clock.sleep(2500)
    assert not clock.stamp(stamp) and (stamp.sec, stamp.nanosec) == (0, 0)
    clock.set(1700000000, 5000)
    assert clock.stamp(stamp) and (stamp.sec, stamp.nanosec) == (1700000000, 5000)


def test_stamps_across_seconds() -> None:
    clock = FakeClock()
    clock.set(1700000000, 999998999)  # to the microsecond
    stamp = Stamp()
    stamps = []
    for _ in range(4):
        clock.stamp(stamp)
        stamps.append((stamp.sec, stamp.nanosec))
        clock.t += 1
    assert stamps == [
        (1700000000, 999998000), (1700000000, 999999000), (1700000001, 0), (1700000001, 1000),
    ]  # fmt: skip
    clock.t += 3999999
    clock.stamp(stamp)
    assert (stamp.sec, stamp.nanosec) == (1700000005, 1000)


def test_time_is_right_across_the_wrap_of_ticks() -> None:
    clock = FakeClock((1 << 30) // 1000 - 500)
    clock.set(100, 0)
    for i in range(50):
        clock.sleep(60000)
        assert clock.now() == (100 + 60 * (i + 1), 0)


def test_small_corrections_backwards_run_at_half_speed() -> None:
    clock = FakeClock()
    clock.set(100, 0)
    clock.set(99, 999000000)  # a millisecond less
    last = (100, 0)
    for i in range(4):
        clock.t += 500
        now = clock.now()
        assert now == (100, 250000 * (i + 1)), now
        assert now > last
        last = now
    clock.t += 500
    assert clock.now() == (100, 1500000)


def test_a_correction_replaces_a_correction_in_progress() -> None:
    clock = FakeClock()
    clock.set(100, 0)
    clock.set(99, 500000000)
    clock.t += 100000  # 50 ms of the half second are corrected
    clock.set(99, 600000000)  # the same again
    clock.t += 1000000
    assert clock.now() == (100, 600000000) and clock.t
    clock.set(101, 0)  # forward at once; the rest of the correction is dropped
    assert clock.now() == (101, 0)
    clock.t += 1000
    assert clock.now() == (101, 1000000)


def test_a_step_forwards_or_over_a_second_ends_a_correction_in_progress() -> None:
    for step_us in (5000, 7000000, -7000000):
        clock = FakeClock()
        clock.set(1700000000, 0)
        clock.set(1699999999, 500000000)  # half a second, taken back at half speed
        now = 1700000000 * 1000000 + step_us
        clock.set(now // 1000000, now % 1000000 * 1000)
        clock.sleep(1000)
        now += 1000000
        assert clock.now() == (now // 1000000, now % 1000000 * 1000), step_us


def test_nanoseconds_may_be_a_second_or_more() -> None:
    for nanoseconds in (999999000, 1000000000, 1000001000, 3000000000, 3999999000):
        clock = FakeClock()
        clock.set(1700000000, nanoseconds)
        seconds = 1700000000 + nanoseconds // 1000000000
        assert clock.now() == (seconds, nanoseconds % 1000000000)


def test_seconds_stay_within_the_range_of_a_stamp() -> None:
    clock = FakeClock()
    for seconds, shown in ((0x7FFFFFFF, 0x7FFFFFFF), (0x80000000, 0), (0xFFFFFFFF, 0x7FFFFFFF)):
        clock.set(seconds, 999999000)
        assert clock.now() == (shown, 999999000)
    clock.sleep(2)  # over the end
    assert clock.now()[0] == 0


def test_large_steps_are_made_at_once() -> None:
    clock = FakeClock()
    for seconds in (1700000000, 900000000, 1700000001, 1699999999, 2100000000):
        clock.set(seconds, 5000)
        assert clock.now() == (seconds, 5000)
