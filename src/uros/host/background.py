"""Gives a connection turns while its program does something else."""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import Final

# Seconds between turns. Discovery takes three to five of them; participants wait seconds for an
# answer.
_PERIOD: Final = 0.05


class BackgroundTurns:
    """A thread that calls ``turn`` all the time, until :meth:`stop`."""

    def __init__(self, turn: Callable[[], None]) -> None:
        self._turn = turn
        self._stopped = threading.Event()
        threading.Thread(target=self._run, name="uros background turns", daemon=True).start()

    def _run(self) -> None:
        while not self._stopped.wait(_PERIOD):
            self._turn()

    def stop(self) -> None:
        """Have the thread end, which may be in a turn now. Idempotent."""
        self._stopped.set()
