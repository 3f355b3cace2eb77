"""The graph of a domain with rate-limited changes: a starting node makes dozens in a moment."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Final

from .context import DdsContext
from .discovery import GraphDiscovery
from .participant import SharedParticipant

# Seconds from the first change to the call, and between two calls. Boards get the whole graph at
# every change, some on a line of 11 kB a second.
_SETTLE: Final = 0.1
_INTERVAL: Final = 1.0


class PacedDiscovery(GraphDiscovery):
    """Calls ``on_change`` at most once a second, from the middleware's ``tick``.

    Attributes:
        due: When ``on_change`` is called next (``time.monotonic``), or None.
    """

    def __init__(
        self,
        context: DdsContext,
        participant: SharedParticipant,
        on_change: Callable[[], None],
    ) -> None:
        self.due: float | None = None
        self._called_at = 0.0
        self._reread_for: set[bytes] = set()
        self._on_paced_change = on_change
        super().__init__(context, participant, self._changed)
        context.schedule.add(self)

    def _changed(self) -> None:
        if self.due is None:
            self.due = max(time.monotonic() + _SETTLE, self._called_at + _INTERVAL)

    def tick(self, now: float) -> None:
        """Call ``on_change``, and read discovery info again if a sample was missed."""
        self.due = None
        self._called_at = time.monotonic()
        missed = self.with_missed_discovery_info()
        if missed - self._reread_for:
            self._reread_for = missed
            self.reread_discovery_info()
        self._on_paced_change()

    def close(self) -> None:
        """Stop reading; idempotent."""
        self.due = None
        self._context.schedule.remove(self)
        super().close()
