"""When a poll ends by a deadline: with a timerfd, and on systems without one."""

import math
import select
import time

import pytest

from uros import poller
from uros.agent.agent import Agent
from uros.agent.server import Server
from uros.middleware.memory import MemoryMiddleware
from uros.poller import DeadlineTimer

SECONDS = 10.0


@pytest.fixture
def timer():
    timer = DeadlineTimer(time.monotonic)
    assert timer.fd >= 0
    yield timer
    timer.close()
    timer.close()
    assert timer.fd == -1


def is_readable(timer, seconds=0.0):
    return bool(select.select([timer.fd], [], [], seconds)[0])


@pytest.mark.parametrize("seconds", [0.03, 1e-9, 1e-12])
def test_it_is_readable_from_the_deadline_on(timer, seconds):
    now = time.monotonic()
    timer._monotonic = lambda: now  # so that as much is left as was asked for
    deadline = now + seconds if seconds > 1e-6 else math.nextafter(now, math.inf)
    assert timer.wait_until(deadline) is None
    assert timer.at == deadline
    assert is_readable(timer, SECONDS)
    assert time.monotonic() >= deadline
    timer.clear()
    assert timer.at == math.inf
    assert not is_readable(timer)
    timer.clear()


def test_an_earlier_deadline_takes_the_place_of_the_other(timer):
    now = time.monotonic()
    assert timer.wait_until(now + 3600) is None
    assert not is_readable(timer)
    assert timer.wait_until(now + 0.01) is None
    assert timer.at == now + 0.01
    assert is_readable(timer, SECONDS)


def test_a_deadline_that_has_passed_sets_no_timer(timer):
    assert timer.wait_until(time.monotonic()) == 0.0
    assert timer.at == math.inf


def test_a_deadline_beyond_what_the_system_can_count_is_looked_at_again(timer):
    assert timer.wait_until(1e300) is None
    assert timer.at == 1e300
    assert not is_readable(timer)


def test_without_timerfds_the_poll_gets_a_timeout(monkeypatch):
    monkeypatch.setattr("ctypes.CDLL", lambda name: object())
    timer = DeadlineTimer(lambda: 100.0)
    assert timer.fd == -1
    assert timer.wait_until(100.5) == 0.5
    assert timer.wait_until(99.0) == 0.0
    assert timer.at == math.inf
    timer.close()


def test_a_timer_that_cannot_be_set_leaves_a_timeout(timer):
    timer._set = lambda seconds: False
    assert 0 < timer.wait_until(time.monotonic() + 1) <= 1
    assert timer.at == math.inf


@pytest.mark.timeout(30)
@pytest.mark.parametrize("has_timerfd", [True, False])
def test_a_server_makes_its_calls_in_time_and_in_order(has_timerfd, monkeypatch):
    """Deadlines that come nearer, move away, have passed, and follow each other."""
    if not has_timerfd:
        monkeypatch.setattr(poller, "_timerfd", lambda: (-1, lambda seconds: False))
    agent = Agent(MemoryMiddleware())
    agent.liveliness.check = lambda: 3600.0
    server = Server(agent, [])
    begin = time.monotonic()
    made = []

    def make(name, seconds):
        def call():
            made.append((name, time.monotonic() - begin - seconds))

        return call

    def begin_calls():
        for name, seconds in (("late", 0.06), ("soon", 0.02), ("now", 0.0), ("next", 0.04)):
            server.wake_at(seconds, make(name, time.monotonic() - begin + seconds))
        server.wake_at(0.03, lambda: server.wake_at(0.05, server.stop))

    # In the second turn: the first one has set the timer to the check in an hour.
    server.soon(lambda: server.soon(begin_calls))
    server.run()
    assert [name for name, _ in made] == ["now", "soon", "next", "late"]
    assert all(late >= -0.001 for _, late in made), made
