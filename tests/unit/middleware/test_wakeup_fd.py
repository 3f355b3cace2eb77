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
    wakeup_fd = WakeupFd()
    yield wakeup_fd
    wakeup_fd.close()


def readable(wake):
    return bool(select.select([wake.fileno()], [], [], 0)[0])


def test_set_makes_it_readable_and_clear_unreadable(wake):
    assert not readable(wake)
    wake.set()
    assert readable(wake)
    wake.clear()
    assert not readable(wake)


def test_repeated_set_and_clear_are_idempotent(wake):
    for _ in range(100_000):  # more than a socket buffer takes
        wake.set()
    while readable(wake):
        wake.clear()
    wake.clear()
    assert not readable(wake)


def test_another_thread_sets_the_descriptor(wake):
    thread = threading.Thread(target=wake.set)
    thread.start()
    assert select.select([wake.fileno()], [], [], 10)[0]
    thread.join()


def test_set_after_close_does_nothing(wake):
    wake.close()
    wake.close()
    wake.set()
