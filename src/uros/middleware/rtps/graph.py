"""The graph of a domain, with rate-limited changes for boards."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping

from ..discovery_info.codec import NodeEntities
from ..paced_call import PacedCall
from .domain import RtpsDomain
from .parameters import EndpointData


class RtpsGraph:
    """What is known of a domain.

    Attributes:
        paced: Calls ``on_change``.

    Args:
        domain: The domain.
        on_change: Called after changes.
        on_close: Called when it is closed.
        paced: Whether it is called from ``paced.tick`` alone; else at each change.
    """

    def __init__(
        self,
        domain: RtpsDomain,
        on_change: Callable[[], None],
        on_close: Callable[[RtpsGraph], None],
        paced: bool,
    ) -> None:
        self.paced = PacedCall(on_change)
        if paced:
            self.paced.changed()
        self._domain = domain
        self._on_close = on_close
        self._watcher = self.paced.changed if paced else on_change
        domain.watchers.append(self._watcher)

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

    def reread_discovery_info(self) -> None:
        """Do nothing: a reader of RTPS asks a writer again for a sample that does not come."""

    def close(self) -> None:
        """Stop watching; idempotent."""
        self.paced.due = None
        if self._watcher in self._domain.watchers:
            self._domain.watchers.remove(self._watcher)
            self._on_close(self)
