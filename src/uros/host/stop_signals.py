"""The signals that stop a program: Ctrl-C, SIGTERM and SIGHUP."""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any, Final


class Terminated(SystemExit):
    """SIGTERM or SIGHUP came. The exit status is the one that a shell reports for the signal."""


def stop(number: int, frame: object = None) -> None:
    """Raise KeyboardInterrupt for SIGINT, and :class:`Terminated` for any other signal."""
    raise KeyboardInterrupt if number == signal.SIGINT else Terminated(128 + number)


# What Python does at each of them. Windows has no SIGHUP.
_DEFAULTS: Final[dict[int, Any]] = {
    signal.SIGINT: signal.default_int_handler,
    signal.SIGTERM: signal.SIG_DFL,
    getattr(signal, "SIGHUP", signal.SIGTERM): signal.SIG_DFL,
}
SIGNALS: Final = tuple(_DEFAULTS)


@contextmanager
def stop_signals(handler: Callable[[int, object], None] = stop) -> Iterator[bool]:
    """Handle the signals that stop a program, within the block.

    By default SIGTERM and SIGHUP end the process at once: processes and folders are left, and
    nobody on the network hears a farewell. The block has no effect on signals that are ignored, as
    SIGHUP is under nohup, or for which the program has a handler of its own, nor outside the main
    thread.

    Args:
        handler: Called with the signal's number and the frame.

    Yields:
        Whether there is any such signal.
    """
    before = {}
    if threading.current_thread() is threading.main_thread():
        found = {number: signal.getsignal(number) for number in _DEFAULTS}
        before = {key: value for key, value in found.items() if value in (_DEFAULTS[key], stop)}
    for number in before:
        signal.signal(number, handler)
    try:
        yield bool(before)
    finally:
        for number, earlier in before.items():
            signal.signal(number, earlier)
