"""The graph of a domain, with rate-limited changes."""

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
        on_change: Called after changes, from ``paced.tick``.
        on_close: Called when it is closed.
    """

    def __init__(
        self,
        domain: RtpsDomain,
        on_change: Callable[[], None],
        on_close: Callable[[RtpsGraph], None],
    ) -> None:
        self.paced = PacedCall(on_change)
        self.paced.changed()
        self._domain = domain
        self._on_close = on_close
        domain.watchers.append(self.paced.changed)

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

    def close(self) -> None:
        """Stop watching; idempotent."""
        self.paced.due = None
        if self.paced.changed in self._domain.watchers:
            self._domain.watchers.remove(self.paced.changed)
            self._on_close(self)
