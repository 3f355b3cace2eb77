"""Feeds :class:`~uros.middleware.type_conflicts.TypeConflicts` from Cyclone's builtin topics.

These list our own endpoints too.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

from ..type_conflicts import TypeConflicts
from . import builtin
from .context import DdsContext
from .dispatcher import ReaderListener
from .participant import SharedParticipant

_BATCH: Final = 256
# How many batches are taken at a time, so that endpoints that are created and deleted without end
# do not hold up the data plane. The rest is taken when the data plane dispatches again.
_BATCHES: Final = 4


class TypeConflictDetector:
    """Reports the conflicts in one domain to ``Middleware.on_type_conflict``.

    It ends with its participant.

    Args:
        context: What the parts of the middleware share.
        participant: The participant whose discovery is read.
        owns: Returns whether the participant of a GUID is one of ours.
    """

    def __init__(
        self,
        context: DdsContext,
        participant: SharedParticipant,
        owns: Callable[[bytes], bool],
    ) -> None:
        self._dispatcher = context.dispatcher
        self._owns = owns

        def report(topic: str, own_type: str, other_type: str) -> None:
            if context.middleware.on_type_conflict is not None:
                context.middleware.on_type_conflict(topic, own_type, other_type)

        self._conflicts = TypeConflicts(report)
        for topic in (builtin.TOPIC_PUBLICATION, builtin.TOPIC_SUBSCRIPTION):
            self._listen(builtin.create_reader(participant.entity, topic))

    def _listen(self, entity: int) -> None:
        def on_ready() -> None:
            listener.taken = True
            if self._take(entity):
                self._dispatcher.requeue(listener)

        listener = ReaderListener(self._dispatcher, entity, on_ready)

    def _take(self, reader: int) -> bool:
        """Take some endpoints; return whether there may be more."""
        for _ in range(_BATCHES):
            changes = builtin.take_types(reader, _BATCH)
            for guid, endpoint in changes:
                if endpoint is None:
                    self._conflicts.remove(guid)
                else:
                    participant, topic, type_name, _ = endpoint
                    self._conflicts.add(guid, topic, type_name, self._owns(participant))
            if len(changes) < _BATCH:
                return False
        return True
