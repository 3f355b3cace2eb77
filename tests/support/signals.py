"""Signal dispositions of processes that tests start."""

from contextlib import contextmanager
from signal import SIG_DFL, SIG_IGN, SIGHUP, SIGINT, SIGTERM, default_int_handler, signal


def default_signals():
    """A context in which SIGINT, SIGHUP and SIGTERM have the default dispositions.

    A test run that was started by nohup, or by ``&`` in a script, ignores the first two, and each
    child process inherits that. Some commands that tests ran in this process leave a handler of
    SIGTERM, which is for the rest of a process.
    """
    return _dispositions({SIGINT: default_int_handler, SIGHUP: SIG_DFL, SIGTERM: SIG_DFL})


def ignored_hangup():
    """A context in which SIGHUP is ignored as under nohup, also in child processes."""
    return _dispositions({SIGHUP: SIG_IGN})


@contextmanager
def _dispositions(wanted):
    before = {number: signal(number, handler) for number, handler in wanted.items()}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal(number, handler)
