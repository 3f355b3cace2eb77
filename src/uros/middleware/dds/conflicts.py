"""Topics of ours that somebody else on the network has with another type.

DDS does not connect such endpoints and says nothing: this does, whichever of
them came first. Cyclone's builtin topics list our own endpoints too.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from . import builtin
from .reader_listener import Watched

if TYPE_CHECKING:
    from .middleware import DdsMiddleware
    from .participant import SharedParticipant

_BATCH: Final = 256
# Attack: endpoints that come and go without end. Batches in one turn; others come between.
_BATCHES: Final = 4


class TypeWatch:
    """Reports the conflicts in one domain to ``middleware.on_type_conflict``."""

    def __init__(self, middleware: DdsMiddleware, participant: SharedParticipant) -> None:
        self._middleware = middleware
        self._domain = participant.domain
        # By GUID: topic, type, and whether it is ours; and by topic: the GUIDs.
        self._endpoints: dict[bytes, tuple[str, str, bool]] = {}
        self._topics: dict[str, set[bytes]] = {}
        for topic in (builtin.TOPIC_PUBLICATION, builtin.TOPIC_SUBSCRIPTION):
            self._read(builtin.create_reader(participant.entity, topic))

    def _read(self, entity: int) -> None:
        """Watch a reader; it ends with its participant."""

        def on_ready() -> None:
            watched.taken = True
            if self._take(entity):
                self._middleware.again(watched)

        watched = Watched(self._middleware, entity, on_ready)

    def _take(self, reader: int) -> bool:
        """Whether there may be more."""
        for _ in range(_BATCHES):
            news = builtin.take_types(reader, _BATCH)
            for guid, about in news:
                if about is None:
                    self._left(guid)
                elif guid not in self._endpoints:
                    self._came(guid, *about[:3])
            if len(news) < _BATCH:
                return False
        return True

    def _left(self, guid: bytes) -> None:
        gone = self._endpoints.pop(guid, None)
        if gone is not None:
            guids = self._topics[gone[0]]
            guids.discard(guid)
            if not guids:
                del self._topics[gone[0]]

    def _came(self, guid: bytes, participant: bytes, topic: str, type_name: str) -> None:
        ours = self._middleware.owns(self._domain, participant)
        self._endpoints[guid] = topic, type_name, ours
        guids = self._topics.setdefault(topic, set())
        report = self._middleware.on_type_conflict
        if report is not None:
            for other in guids:
                _, other_type, also_ours = self._endpoints[other]
                if other_type != type_name:
                    if ours:
                        report(topic, type_name, other_type)
                    elif also_ours:
                        report(topic, other_type, type_name)
        guids.add(guid)
