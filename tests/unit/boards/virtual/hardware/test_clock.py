"""A board's crystal against true time."""

import os
import sys
import time

import pytest

from uros.boards.virtual.hardware.clock import RTC_START_NS, BoardClock, ManualClock

DAY_US = 86_400 * 10**6


class Host:
    def __init__(self):
        self.ns = 12345
        self.slept = []

    def sleep(self, seconds):
        self.slept.append(seconds)


def test_the_crystal_drifts_by_50_ppm():
    host = Host()
    clock = BoardClock(host_ns=lambda: host.ns, host_sleep=host.sleep)
    assert clock.ticks_us() == clock.world_us() == 0
    host.ns += DAY_US * 1000
    assert clock.world_us() == DAY_US
    assert clock.ticks_us() == DAY_US + 4_320_000
    assert clock.epoch_ns() == RTC_START_NS + (DAY_US + 4_320_000) * 1000


@pytest.mark.skipif(sys.platform != "linux", reason="not on this platform: another host clock")
@pytest.mark.parametrize("speed", [1.0, 2.5])
def test_another_process_can_compute_the_ticks(speed):
    clock = BoardClock(speed=speed)
    clock.restart()
    power_on, restarted, factor, rate = clock.ticks_formula()
    before = clock.ticks_us()
    since = time.clock_gettime_ns(time.CLOCK_MONOTONIC) - power_on
    ticks = (int(since * factor) * rate // 10**9 - restarted) // 1000
    assert before <= ticks <= clock.ticks_us()


def test_a_clock_that_is_not_the_hosts_has_no_formula():
    assert ManualClock().ticks_formula() is None


def test_sleeps_are_timed_by_the_crystal():
    host = Host()
    clock = BoardClock(host_ns=lambda: host.ns, host_sleep=host.sleep)
    clock.sleep_us(10**6)
    clock.sleep_us(0)
    clock.sleep_us(-5)
    clock.sleep_world_us(10**6)
    assert host.slept == [pytest.approx(1 / 1.00005, abs=1e-12), 1.0]


@pytest.mark.parametrize("drift", [-50.0, 0.0, 50.0])
@pytest.mark.parametrize("us", [1, 3, 700, 1000, 20_000, 100_000])
def test_a_sleep_on_a_manual_clock_is_exact(drift, us):
    clock = ManualClock(drift)
    for n in range(1, 20):
        clock.sleep_us(us)
        assert n * us <= clock.ticks_us() <= n * us + 1


def test_the_rtc_starts_in_2000():
    assert time.gmtime(BoardClock().epoch_ns() / 1e9)[:6] == (2000, 1, 1, 0, 0, 0)


def test_the_rtc_can_be_set_and_survives_a_restart():
    clock = ManualClock()
    clock.advance(500)
    clock.set_epoch_ns(10**18)
    clock.restart()
    assert clock.ticks_us() == 0
    clock.advance(1000)
    assert (clock.ticks_us(), clock.world_us()) == (1000, 1500)
    assert clock.epoch_ns() == 10**18 + 10**6


def test_waiting_for_descriptors():
    reader, writer = os.pipe()
    try:
        for clock in (ManualClock(), BoardClock()):
            assert clock.select([reader], 0) == []
            os.write(writer, b"x")
            assert clock.select([reader], 10) == [reader]
            os.read(reader, 1)
        clock = ManualClock()
        assert clock.select([reader], 10) == []
        assert clock.world_us() == 10**7
        with pytest.raises(RuntimeError):
            clock.select([reader], None)
    finally:
        os.close(reader)
        os.close(writer)
