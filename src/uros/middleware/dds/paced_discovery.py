"""The graph of a domain, with rate-limited changes."""

from __future__ import annotations

from collections.abc import Callable

from ..graph import with_missed_discovery_info
from ..paced_call import PacedCall
from .context import DdsContext
from .discovery import GraphDiscovery
from .participant import SharedParticipant


class PacedDiscovery(GraphDiscovery):
    """Calls ``on_change`` at most once a second, from the middleware's ``tick``."""

    def __init__(
        self,
        context: DdsContext,
        participant: SharedParticipant,
        on_change: Callable[[], None],
    ) -> None:
        self._reread_for: set[bytes] = set()
        self._on_paced_change = on_change
        self._paced = PacedCall(self._report)
        super().__init__(context, participant, self._paced.changed)
        context.schedule.add(self._paced)

    def _report(self) -> None:
        """Call ``on_change``, and read discovery info again if a sample was missed."""
        missed = with_missed_discovery_info(self)
        if missed - self._reread_for:
            self._reread_for = missed
            self.reread_discovery_info()
        self._on_paced_change()

    def close(self) -> None:
        """Stop reading; idempotent."""
        self._paced.due = None
        self._context.schedule.remove(self._paced)
        super().close()
