"""The graph of a domain with rate-limited changes: a starting node makes dozens in a moment."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Mapping
from typing import Final

from ..discovery_info.codec import NodeEntities
from .domain import RtpsDomain
from .parameters import EndpointData

# Seconds from the first change to the call, and between two calls. Boards get the whole graph at
# every change, some on a line of 11 kB a second.
_SETTLE: Final = 0.1
_INTERVAL: Final = 1.0


class RtpsGraph:
    """What is known of a domain; it calls ``on_change`` at most once a second.

    Attributes:
        due: When :meth:`tick` calls ``on_change`` (``time.monotonic``), or None.

    Args:
        domain: The domain.
        on_change: Called after changes, from :meth:`tick`.
        on_close: Called when it is closed.
    """

    def __init__(
        self,
        domain: RtpsDomain,
        on_change: Callable[[], None],
        on_close: Callable[[RtpsGraph], None],
    ) -> None:
        self.due: float | None = time.monotonic() + _SETTLE
        self._domain = domain
        self._on_change = on_change
        self._on_close = on_close
        self._called_at = 0.0
        domain.watchers.append(self._changed)

    @property
    def participants(self) -> Mapping[bytes, bytes]:
        """USER_DATA of each participant, by its GUID."""
        return self._domain.participants()

    @property
    def endpoints(self) -> Mapping[bytes, EndpointData]:
        """The endpoints by their GUIDs."""
        return self._domain.endpoints()

    @property
    def announced(self) -> Mapping[bytes, Iterable[NodeEntities]]:
        """The nodes of each participant, by its GUID; it may not be discovered yet."""
        info = self._domain.info
        return {} if info is None else info.announced()

    def _changed(self) -> None:
        if self.due is None:
            self.due = max(time.monotonic() + _SETTLE, self._called_at + _INTERVAL)

    def tick(self, now: float) -> None:
        """Call ``on_change``."""
        self.due = None
        self._called_at = now
        self._on_change()

    def close(self) -> None:
        """Stop watching; idempotent."""
        self.due = None
        if self._changed in self._domain.watchers:
            self._domain.watchers.remove(self._changed)
            self._on_close(self)
