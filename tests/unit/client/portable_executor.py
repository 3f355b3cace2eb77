"""The executor and its timers. Also runs on MicroPython."""

import sys

from support.board import FakeClock
from support.portable import SINGLE_FLOATS

from uros.client.executor import ALWAYS, ON_NEW_DATA, Executor, Timer
from uros.client.guard_condition import LATENCY_MS, GuardCondition
from uros.client.triggers import trigger_all, trigger_always, trigger_any, trigger_one
from uros.ticks import ticks_diff


class Handle:
    """A handle that is ready if ``ready``, and logs its calls."""

    def __init__(self, name, log, ready=False, invocation=ON_NEW_DATA, then=None):
        self.name = name
        self.log = log
        self.ready = ready
        self.invocation = invocation
        self.then = then

    def is_ready(self, now):
        return self.ready

    def next_deadline(self):
        return None

    def overfull(self):
        return False

    def execute(self, new):
        self.log.append(self.name if new else self.name + "-")
        if self.then:
            self.then()


def quiet(executor, call):
    """Return the result of ``call()`` and the exceptions of callbacks."""
    errors = []
    executor.report = errors.append
    return call(), errors


def bench(*names, **more):
    executor = Executor(**more)
    log = []
    handles = [Handle(name, log) for name in names]
    for handle in handles:
        executor.add(handle)
    return executor, handles, log


def test_ready_handles_run_in_the_order_added() -> None:
    executor, handles, log = bench("a", "b", "c", "d")
    assert executor.execute(0) == 0 and log == []
    for i in (3, 0, 2):
        handles[i].ready = True
    assert executor.execute(0) == 3
    assert log == ["a", "c", "d"]


def test_always_handles_run_in_every_round_that_begins() -> None:
    executor, handles, log = bench("a", "b", "c")
    handles[2].invocation = ALWAYS
    assert executor.execute(0) == 0
    handles[1].ready = True
    assert executor.execute(0) == 2
    assert log == ["b", "c-"]
    handles[2].ready = True
    executor.execute(0)
    assert log == ["b", "c-", "b", "c"]


def test_triggers() -> None:
    cases = (
        (trigger_any, ("", "a", "b", "ab"), (0, 1, 1, 2)),
        (trigger_all, ("", "a", "b", "ab"), (0, 0, 0, 2)),
        (trigger_always, ("", "a", "b", "ab"), (0, 1, 1, 2)),
    )
    for trigger, rounds, counts in cases:
        for names, count in zip(rounds, counts):
            executor, handles, _ = bench("a", "b")
            executor.trigger = trigger
            for handle in handles:
                handle.ready = handle.name in names
            assert executor.execute(0) == count, (trigger, names)


def test_trigger_all_needs_timers_and_subscriptions() -> None:
    clock = FakeClock(1000)
    executor, handles, log = bench("sub")
    executor.add(Timer(0.1, lambda: log.append("timer"), clock))
    executor.trigger = trigger_all
    for sample, at, ran in (
        (True, 1050, []),  # the timer is not due
        (False, 1100, []),  # the timer is due, and there is no sample
        (True, 1130, ["sub", "timer"]),
        (True, 1150, []),
        (True, 1200, ["sub", "timer"]),
    ):
        handles[0].ready = sample
        clock.t = at * 1000
        del log[:]
        assert executor.execute(clock.ms()) == len(ran)
        assert log == ran, (at, log)


def test_trigger_one_begins_with_its_handle_alone() -> None:
    executor, handles, log = bench("a", "b")
    executor.trigger = trigger_one(handles[1])
    handles[0].ready = True
    assert executor.execute(0) == 0
    handles[1].ready = True
    assert executor.execute(0) == 2 and log == ["a", "b"]
    executor.remove(handles[1])
    assert executor.execute(0) == 0


def test_trigger_always_runs_always_handles() -> None:
    executor, handles, log = bench("a", "b")
    executor.trigger = trigger_always
    handles[1].invocation = ALWAYS
    assert executor.execute(0) == 1 and log == ["b-"]


def test_a_trigger_of_the_program() -> None:
    executor, handles, log = bench("a", "b")
    asked = []

    def trigger(handles, ready):
        asked.append(([handle.name for handle in handles], list(ready)))
        return len(asked) > 1

    executor.trigger = trigger
    handles[0].ready = True
    assert executor.execute(0) == 0 and executor.execute(0) == 1
    assert asked == [(["a", "b"], [True, False])] * 2


def test_a_callback_that_raises_is_reported_and_the_round_continues() -> None:
    executor, handles, log = bench("a", "b")

    def fail():
        raise KeyError("mine")

    handles[0].then = fail
    for handle in handles:
        handle.ready = True
    count, errors = quiet(executor, lambda: executor.execute(0))
    assert count == 2 and executor.failed == 1 and log == ["a", "b"]
    assert len(errors) == 1 and isinstance(errors[0], KeyError)


def test_max_handles_limits_the_handles() -> None:
    executor, handles, log = bench("a", "b", max_handles=2)
    try:
        executor.add(Handle("c", log))
    except ValueError as error:
        assert "2 handles" in str(error)
    else:
        raise AssertionError("not refused")
    assert executor.handles == handles
    executor.remove(handles[0])
    executor.remove(handles[0])
    executor.add(handles[0])


def test_callbacks_may_add_and_remove_handles() -> None:
    executor, handles, log = bench("a", "b", "c")
    extra = Handle("d", log, True)

    def change():
        executor.remove(handles[1])
        executor.add(extra)

    handles[0].then = change
    for handle in handles:
        handle.ready = True
    assert executor.execute(0) == 2 and log == ["a", "c"]
    handles[0].then = None
    assert executor.execute(0) == 3 and log == ["a", "c", "a", "c", "d"]


def test_a_handle_ready_during_a_round_runs_in_the_next() -> None:
    executor, handles, log = bench("a", "b")
    handles[0].ready = True

    def more():
        handles[1].ready = True

    handles[0].then = more
    assert executor.execute(0) == 1 and log == ["a"]
    handles[0].ready = False
    assert executor.execute(0) == 1 and log == ["a", "b"]


def test_a_handle_no_longer_ready_is_not_called() -> None:
    executor, handles, log = bench("a", "b")
    handles[0].ready = handles[1].ready = True

    def gone():
        handles[1].ready = False

    handles[0].then = gone
    assert executor.execute(0) == 1 and log == ["a"]
    handles[1].invocation = ALWAYS
    handles[1].ready = True
    assert executor.execute(0) == 2 and log == ["a", "a", "b-"]


def test_a_round_within_a_round() -> None:
    """A callback that spins, as spin_until_future_complete does."""
    executor, handles, log = bench("a", "b", "c")
    for handle in handles:
        handle.ready = True

    def within():
        handles[0].ready = False
        handles[0].then = None
        executor.execute(0)
        for handle in handles:
            handle.ready = False
        extra = Handle("d", log, True)
        executor.add(extra)

    handles[0].then = within
    assert executor.execute(0) == 1
    assert log == ["a", "b", "c"]
    assert executor.execute(0) == 1 and log[3:] == ["d"]


def test_a_trigger_that_raises_is_reported_and_begins_no_round() -> None:
    executor, handles, log = bench("a")
    handles[0].ready = True
    executor.trigger = lambda handles, ready: ready[7]
    count, errors = quiet(executor, lambda: executor.execute(0))
    assert count == 0 and log == [] and isinstance(errors[0], IndexError)
    assert executor.failed == 1
    executor.trigger = trigger_any
    assert executor.execute(0) == 1


def test_a_report_that_raises_does_not_stop_the_round() -> None:
    executor, handles, log = bench("a", "b")
    for handle in handles:
        handle.ready = True
        handle.then = lambda: 1 // 0

    def report(error):
        raise MemoryError

    executor.report = report
    assert executor.execute(0) == 2 and executor.failed == 2 and log == ["a", "b"]


def test_between_is_called_after_each_callback() -> None:
    executor, handles, log = bench("a", "b")
    executor.between = lambda: log.append("+")
    handles[0].ready = handles[1].ready = True
    executor.execute(0)
    assert log == ["a", "+", "b", "+"]


def test_overfull_if_one_handle_is() -> None:
    executor, handles, log = bench("a", "b")
    assert not executor.overfull()
    handles[1].overfull = lambda: True
    assert executor.overfull()


def test_a_guard_condition_calls_back_once_for_several_triggers() -> None:
    clock = FakeClock()
    executor = Executor()
    calls = []
    guard = GuardCondition(lambda: calls.append(clock.t), clock)
    executor.add(guard)
    assert executor.execute(clock.ms()) == 0
    assert executor.wait(clock.ms()) == LATENCY_MS
    guard.trigger()
    guard.trigger()
    assert executor.wait(clock.ms()) == 0
    assert executor.execute(clock.ms()) == 1 == len(calls)
    assert executor.execute(clock.ms()) == 0
    guard.callback = lambda: calls.append(guard.trigger())
    guard.trigger()  # its callback triggers it again, for the next round
    assert executor.execute(clock.ms()) == 1
    assert executor.execute(clock.ms()) == 1
    assert len(calls) == 3


# --- timers -----------------------------------------------------------------------------------


class Ticking:
    """An executor with one timer; ``times`` are its calls, in microseconds since the start."""

    def __init__(self, period, start_ms=1000, takes_ms=0):
        self.clock = FakeClock(start_ms)
        self.start = self.clock.t
        self.takes_ms = takes_ms
        self.times = []
        self.executor = Executor()
        self.timer = Timer(period, self.called, self.clock)
        self.executor.add(self.timer)

    def called(self):
        self.times.append(self.clock.t - self.start)
        self.clock.sleep(self.takes_ms)

    def run(self, ms):
        end = self.clock.t + ms * 1000
        while self.clock.t < end:
            wait = self.executor.wait(self.clock.ms(), (end - self.clock.t) // 1000)
            self.clock.sleep(wait)
            if not self.executor.execute(self.clock.ms()) and not wait:
                break


def test_the_nth_call_is_n_periods_after_the_start() -> None:
    for start in (1000, (1 << 30) - 5000):
        for period, count in ((0.001, 9999), (0.02, 500), (1.0, 10), (0.0333333, 300)):
            ticking = Ticking(period, start)
            ticking.run(10000)
            times = ticking.times
            assert len(times) >= count, (period, len(times))
            for n in range(len(times)):
                off = times[n] - (n + 1) * period * 1000000
                assert -1000 <= off <= 1000, (period, n, off)
            assert ticking.timer.missed == 0


def test_long_callbacks_do_not_make_a_timer_drift() -> None:
    ticking = Ticking(0.1, takes_ms=60)
    ticking.run(10050)
    assert ticking.times == [(n + 1) * 100000 for n in range(100)]


def test_missed_periods_are_skipped_and_counted() -> None:
    ticking = Ticking(0.1)
    ticking.run(250)
    ticking.clock.sleep(1000)
    ticking.run(500)
    assert ticking.times == [100000, 200000, 1250000] + [1300000 + 100000 * n for n in range(5)]
    assert ticking.timer.missed == 9
    ticking = Ticking(0.1, takes_ms=250)  # longer than its period
    ticking.run(2000)
    assert ticking.times == [100000 + 300000 * n for n in range(len(ticking.times))] or [
        b - a for a, b in zip(ticking.times, ticking.times[1:])
    ] == [250000] * (len(ticking.times) - 1)
    assert ticking.timer.missed >= len(ticking.times)


def test_a_million_periods_do_not_drift() -> None:
    """The period is no whole number of milliseconds nor of microseconds."""
    count = 1000000 if sys.implementation.name == "cpython" else 60000
    rounding = 33333 / 2**24 if SINGLE_FLOATS else 0
    clock = FakeClock()
    start = clock.t
    timer = Timer(1 / 30, lambda: None, clock)
    at = clock.ms()
    for n in range(1, count + 1):
        at = timer.next_deadline()
        clock.t += ticks_diff(at, clock.ms()) * 1000
        assert timer.is_ready(at)
        timer.execute(True)
        if n % 9999 == 0 or n == count:
            off = clock.t - start - n * 33333333 // 1000
            # Where floats have 32 bits, the period itself is rounded to 24 bits.
            assert -1000 - rounding * n <= off <= rounding * n, (n, off)
    assert timer.missed == 0


def test_periods_are_exact_after_many_missed_ones() -> None:
    ticking = Ticking(1 / 30)
    ticking.clock.sleep(100000)
    ticking.run(1000)
    first = ticking.times[1]
    n = (first * 1000 + 500000) // 33333333
    assert abs(first - n * 33333333 // 1000) <= 1000, (first, n)
    assert ticking.timer.missed == n - 2


def test_a_timer_created_canceled_starts_at_its_reset() -> None:
    clock = FakeClock()
    calls = []
    timer = Timer(0.1, lambda: calls.append(clock.t), clock, False)
    executor = Executor()
    executor.add(timer)
    assert timer.is_canceled() and timer.time_until_next_call() is None
    assert executor.wait(clock.ms()) == 60000
    clock.sleep(250)
    assert executor.execute(clock.ms()) == 0
    timer.reset()
    assert timer.time_until_next_call() == 100000000
    clock.sleep(100)
    assert executor.execute(clock.ms()) == 1 and calls == [clock.t]


def test_queries_of_a_timer() -> None:
    clock = FakeClock()
    timer = Timer(0.25, print, clock)
    assert timer.timer_period_ns == 250000000 and not timer.is_ready()
    assert timer.time_until_next_call() == 250000000 and timer.time_since_last_call() == 0
    clock.sleep(300)
    assert timer.is_ready() and timer.time_until_next_call() == -50000000
    assert timer.time_since_last_call() == 300000000
    timer.callback = lambda: None
    timer.execute(True)
    assert timer.time_until_next_call() == 200000000 and timer.time_since_last_call() == 0


def test_a_new_period_applies_after_the_next_call() -> None:
    ticking = Ticking(0.1)
    ticking.run(250)
    ticking.timer.timer_period_ns = 40000000
    assert ticking.timer.timer_period_ns == 40000000
    ticking.run(150)
    assert ticking.times == [100000, 200000, 300000, 340000, 380000]
    for ns in (0, 999999, 500000000000000):
        try:
            ticking.timer.timer_period_ns = ns
        except ValueError as error:
            assert str(ns) in str(error)
        else:
            raise AssertionError(ns)


def test_a_canceled_timer_is_silent_until_it_is_reset() -> None:
    ticking = Ticking(0.1)
    ticking.run(250)
    ticking.timer.cancel()
    assert ticking.timer.is_canceled() and ticking.timer.next_deadline() is None
    ticking.run(1000)
    assert len(ticking.times) == 2
    ticking.timer.reset()
    assert not ticking.timer.is_canceled()
    ticking.run(310)
    assert len(ticking.times) == 5 and ticking.timer.missed == 0


def test_reset_restarts_the_period() -> None:
    ticking = Ticking(0.1)
    ticking.run(90)
    ticking.timer.reset()
    ticking.run(90)
    assert ticking.times == []
    ticking.run(30)
    assert ticking.times == [190000]


def test_a_timer_canceled_or_reset_in_the_same_round_is_not_called() -> None:
    for name in ("cancel", "reset"):
        clock = FakeClock()
        executor = Executor()
        calls = []
        first = Timer(0.1, lambda: getattr(second, name)(), clock)  # noqa: B023
        second = Timer(0.1, lambda: calls.append(1), clock)  # noqa: B023
        executor.add(first)
        executor.add(second)
        clock.sleep(100)
        executor.execute(clock.ms())
        assert calls == [] and second.missed == 0, name


def test_a_timer_that_cancels_itself() -> None:
    ticking = Ticking(0.1)
    ticking.timer.callback = lambda: (ticking.times.append(0), ticking.timer.cancel())
    ticking.run(1000)
    assert ticking.times == [0]


def test_a_timer_whose_callback_raises_goes_on() -> None:
    ticking = Ticking(0.1)
    ticking.timer.callback = lambda: ticking.times.append(0) or 1 // 0
    _, errors = quiet(ticking.executor, lambda: ticking.run(550))
    assert len(ticking.times) == 5 == ticking.executor.failed == len(errors)


def test_periods_out_of_range_are_refused() -> None:
    for period in (0, -1, 0.0004, 500001):
        try:
            Timer(period, print, FakeClock())
        except ValueError as error:
            assert str(period) in str(error)
        else:
            raise AssertionError(period)


def test_wait_returns_the_time_until_the_next_timer() -> None:
    clock = FakeClock()
    executor = Executor()
    assert executor.wait(clock.ms()) == 60000
    assert executor.wait(clock.ms(), 7) == 7
    timers = [Timer(period, print, clock) for period in (0.3, 0.1, 0.2)]
    for timer in timers:
        executor.add(timer)
    assert executor.wait(clock.ms()) == 100
    timers[1].cancel()
    assert executor.wait(clock.ms()) == 200
    clock.sleep(250)
    assert executor.wait(clock.ms()) == 0


def test_wait_is_never_negative() -> None:
    executor, _, _ = bench("a")
    for longest in (0, -1, -5000):
        assert executor.wait(0, longest) == 0
    assert executor.wait(0, 1) == 1


def test_the_longest_period_and_the_shortest() -> None:
    clock = FakeClock()
    for period in (0.001, 262144.0 if SINGLE_FLOATS else 499999.999):
        assert Timer(period, print, clock).timer_period_ns == int(period * 1000 + 0.5) * 1000000
    for period in (0.0009, 500001.0 if SINGLE_FLOATS else 500000.0, 500001.0):
        try:
            Timer(period, print, clock)
        except ValueError:
            continue
        raise AssertionError(period)


def test_a_due_timer_held_back_by_the_trigger_does_not_shorten_the_wait() -> None:
    clock = FakeClock()
    executor, handles, log = bench("a")
    calls = []
    executor.add(Timer(0.1, lambda: calls.append(1), clock))
    executor.trigger = trigger_all
    clock.sleep(100)
    assert executor.wait(clock.ms()) == 0
    assert executor.execute(clock.ms()) == 0
    assert executor.wait(clock.ms()) == 100  # until another handle is ready
    assert executor.wait(clock.ms(), 7) == 7
    handles[0].ready = True
    assert executor.wait(clock.ms()) == 0
    assert executor.execute(clock.ms()) == 2 and calls == [1]
    handles[0].ready = False
    assert executor.wait(clock.ms()) == 100
