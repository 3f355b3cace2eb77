"""The graph of a domain, told in peace: a starting node makes dozens of changes in a moment."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import TYPE_CHECKING, Final

from .discovery import Discovery

if TYPE_CHECKING:
    from .middleware import DdsMiddleware
    from .participant import SharedParticipant

_SETTLE: Final = 0.1
# Boards get the whole graph at every change, some by a line of 11 kB a second.
_INTERVAL: Final = 1.0


class PacedDiscovery(Discovery):
    """Calls ``on_change`` from the middleware's ``tick``, once for all news of a second."""

    def __init__(
        self,
        middleware: DdsMiddleware,
        participant: SharedParticipant,
        on_change: Callable[[], None],
    ) -> None:
        self.due: float | None = None  # when to tell next
        self._told_at = 0.0
        self._asked: set[bytes] = set()
        self._tell = on_change
        super().__init__(middleware, participant, self._news)
        middleware.graphs.append(self)

    def _news(self) -> None:
        if self.due is None:
            self.due = max(time.monotonic() + _SETTLE, self._told_at + _INTERVAL)

    def tell(self) -> None:
        """Call ``on_change`` now."""
        self.due = None
        self._told_at = time.monotonic()
        unheard = self.unheard()
        if unheard - self._asked:
            self._asked = unheard
            self.ask_again()
        self._tell()

    def close(self) -> None:
        if self in self._middleware.graphs:
            self._middleware.graphs.remove(self)
        super().close()
