"""Polling for conditions without notification, such as a log line or another thread's count."""

import time

from support.lines import SECONDS


def eventually(done, what="it takes too long", pause=0.002):
    """Poll until ``done()``. After SECONDS: AssertionError with ``what``, a text or a function."""
    deadline = time.monotonic() + SECONDS
    while not done():
        assert time.monotonic() < deadline, what() if callable(what) else what
        time.sleep(pause)  # a poll with a deadline: there is no notification
