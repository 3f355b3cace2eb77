"""Topics of ours that somebody else on the network has with another type.

DDS does not connect such endpoints and says nothing: this does, whichever of
them came first. Cyclone's builtin topics list our own endpoints too.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Final

from . import cyclone
from .endpoints import DdsReader

if TYPE_CHECKING:
    from .middleware import DdsMiddleware
    from .participant import SharedParticipant

_BATCH: Final = 256


class TypeWatch:
    """Reports the conflicts in one domain to ``middleware.on_type_conflict``."""

    def __init__(self, middleware: DdsMiddleware, participant: SharedParticipant) -> None:
        self._middleware = middleware
        self._domain = participant.domain
        # By GUID: topic, type, and whether it is ours; and by topic: the GUIDs.
        self._endpoints: dict[bytes, tuple[str, str, bool]] = {}
        self._topics: dict[str, set[bytes]] = {}
        for topic in (cyclone.BUILTIN_TOPIC_PUBLICATION, cyclone.BUILTIN_TOPIC_SUBSCRIPTION):
            _BuiltinReader(
                middleware, cyclone.create_builtin_reader(participant.entity, topic), self._take
            )

    def _take(self, reader: int) -> None:
        while True:
            news = cyclone.take_types(reader, _BATCH)
            for guid, about in news:
                if about is None:
                    self._left(guid)
                elif guid not in self._endpoints:
                    self._came(guid, *about)
            if len(news) < _BATCH:
                return

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


class _BuiltinReader(DdsReader):
    """A reader that no node announces; it ends with its participant."""

    __slots__ = ()

    def __init__(
        self, middleware: DdsMiddleware, entity: int, take: Callable[[int], None]
    ) -> None:
        def on_ready() -> None:
            self.taken = True
            take(entity)

        self.on_ready = on_ready
        self.taken = True
        self.paused = False
        self.local_only = False
        self.entity = entity
        self.guid = b""
        self._close = None
        self.key = middleware.watch(self)
