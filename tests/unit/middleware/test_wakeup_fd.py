import os
import select
import threading

import pytest

from uros.middleware.wakeup_fd import WakeupFd


@pytest.fixture(params=["eventfd", "socketpair"])
def wake(request, monkeypatch):
    if request.param == "socketpair":
        monkeypatch.delattr(os, "eventfd", raising=False)
    elif not hasattr(os, "eventfd"):
        pytest.skip("not on this platform: eventfd")
    one = WakeupFd()
    yield one
    one.close()


def readable(wake):
    return bool(select.select([wake.fileno()], [], [], 0)[0])


def test_set_makes_it_readable_and_clear_unreadable(wake):
    assert not readable(wake)
    wake.set()
    assert readable(wake)
    wake.clear()
    assert not readable(wake)


def test_many_sets_are_one_and_clearing_nothing_is_nothing(wake):
    for _ in range(100_000):  # more than a socket buffer takes
        wake.set()
    while readable(wake):
        wake.clear()
    wake.clear()
    assert not readable(wake)


def test_another_thread_wakes(wake):
    thread = threading.Thread(target=wake.set)
    thread.start()
    assert select.select([wake.fileno()], [], [], 10)[0]
    thread.join()


def test_after_the_end_setting_is_nothing(wake):
    wake.close()
    wake.close()
    wake.set()
