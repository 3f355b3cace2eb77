"""The end of a command that runs other processes: by signals, and without being interrupted."""

from __future__ import annotations

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType, TracebackType
from typing import Any

from ..host.stop_signals import SIGNALS


class StopSignals:
    """A flag that Ctrl-C, SIGTERM and SIGHUP set for the duration of a block.

    For commands that must end their work in order: nothing is interrupted.

    Attributes:
        stopped: Whether one of them came.
    """

    def __init__(self) -> None:
        self.stopped = False
        self._before: dict[int, Any] = {}

    def _stop(self, number: int, frame: FrameType | None) -> None:
        self.stopped = True

    def __enter__(self) -> StopSignals:
        for number in SIGNALS:
            # Ctrl-C also where it is ignored, as in a script's background: `kill -INT` ends it.
            if number == signal.SIGINT or signal.getsignal(number) != signal.SIG_IGN:
                self._before[number] = signal.signal(number, self._stop)
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        for number, handler in self._before.items():
            signal.signal(number, handler)


@contextmanager
def uninterrupted() -> Iterator[None]:
    """Ignore Ctrl-C, SIGTERM and SIGHUP for the duration of a block that ends soon by itself.

    Users who press Ctrl-C twice would leave processes and folders otherwise.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = [signal.signal(number, signal.SIG_IGN) for number in SIGNALS]
    try:
        yield
    finally:
        for number, handler in zip(SIGNALS, before, strict=True):
            signal.signal(number, handler)
