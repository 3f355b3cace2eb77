"""Waiting for what nothing tells of, such as a line in a log or a count in another thread."""

import time

from support.lines import SECONDS


def eventually(done, what="it takes too long", pause=0.002):
    """Until ``done()`` says so; ``what`` is said where it never does, and may be a function."""
    deadline = time.monotonic() + SECONDS
    while not done():
        assert time.monotonic() < deadline, what() if callable(what) else what
        time.sleep(pause)  # a poll with a deadline: nothing tells
