"""Gives a connection turns while its program does something else."""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import Final

# Seconds between turns. Discovery takes three to five of them; participants wait seconds for an
# answer.
_PERIOD: Final = 0.05


class BackgroundTurns:
    """A thread that calls ``turn`` every 50 ms, until :meth:`stop`.

    Args:
        turn: What to call. It is called again after an error.
        failed: Called with the first error of several in a row.
    """

    def __init__(self, turn: Callable[[], None], failed: Callable[[Exception], None]) -> None:
        self._turn = turn
        self._failed = failed
        self._stopped = threading.Event()
        threading.Thread(target=self._run, name="uros background turns", daemon=True).start()

    def _run(self) -> None:
        has_failed = False
        while not self._stopped.wait(_PERIOD):
            try:
                self._turn()
                has_failed = False
            except Exception as error:  # the node must stay in sight of others
                if not has_failed:
                    has_failed = True
                    self._failed(error)

    def stop(self) -> None:
        """Have the thread end, which may be in a turn now. Idempotent."""
        self._stopped.set()
