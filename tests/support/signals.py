"""Signal dispositions for processes that tests start."""

from contextlib import contextmanager
from signal import SIG_DFL, SIG_IGN, SIGHUP, SIGINT, default_int_handler, signal


def default_signals():
    """Inside, SIGINT and SIGHUP have their default dispositions, also in processes started there.

    A run of the tests that was started by nohup, or by ``&`` in a script, ignores these signals,
    and each process that it starts inherits that.
    """
    return _dispositions({SIGINT: default_int_handler, SIGHUP: SIG_DFL})


def ignored_hangup():
    """Inside, SIGHUP is ignored as by nohup, also in processes started there."""
    return _dispositions({SIGHUP: SIG_IGN})


@contextmanager
def _dispositions(wanted):
    before = {number: signal(number, handler) for number, handler in wanted.items()}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal(number, handler)
