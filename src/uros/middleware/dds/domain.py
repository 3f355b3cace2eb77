"""One DDS domain: the participants shared by its nodes, and what watches the domain for all."""

from __future__ import annotations

from collections.abc import Callable

from ..discovery_info.gid_size import GidSizeSelector
from .context import DdsContext
from .discovery import GraphDiscovery, ParticipantDiscovery
from .late_writer_heartbeat import LateWriterHeartbeats
from .paced_discovery import PacedDiscovery
from .participant import MAX_NODES, SharedParticipant
from .type_conflict_detector import TypeConflictDetector


class DdsDomain:
    """A domain that is open (``cyclone.open_domain``).

    Attributes:
        number: The domain.
        participants: Its participants of ours, in order of creation.

    Args:
        context: What the parts of the middleware share.
        number: The domain.
        gid_size: Octets of a Gid that ROS_DISTRO asks for, or None.
    """

    def __init__(self, context: DdsContext, number: int, gid_size: int | None) -> None:
        self.number = number
        self.participants: list[SharedParticipant] = []
        self._context = context
        self._gid_size = GidSizeSelector(number, gid_size, self._on_gid_size, context.notice)
        self._peers: ParticipantDiscovery | None = None
        self._late_writers: LateWriterHeartbeats | None = None

    def participant(self) -> SharedParticipant:
        """Return a participant with room for one more node."""
        for participant in self.participants:
            if len(participant.nodes) < MAX_NODES:
                return participant
        participant = SharedParticipant(self.number, self._gid_size.size)
        self.participants.append(participant)
        self._context.schedule.add(participant)
        if self._peers is None:
            self._peers = ParticipantDiscovery(self._context, participant, self._on_peers)
        if len(self.participants) == 1 and self._context.middleware.on_type_conflict is not None:
            TypeConflictDetector(self._context, participant, self.owns)
        return participant

    def _first_participant(self) -> SharedParticipant:
        return self.participants[0] if self.participants else self.participant()

    def graph(self, on_change: Callable[[], None], paced: bool) -> GraphDiscovery:
        """Watch the graph until the result is closed."""
        kind = PacedDiscovery if paced else GraphDiscovery
        return kind(self._context, self._first_participant(), on_change)

    def owns(self, participant: bytes) -> bool:
        """Return whether the participant of a GUID is one of ours."""
        return any(ours.guid == participant for ours in self.participants)

    def expect_late_writers(self, participant: SharedParticipant) -> None:
        """Watch for writers that need a probe reader, from before the first reliable reader on."""
        if self._late_writers is None:
            self._late_writers = LateWriterHeartbeats(self._context, participant)

    def _on_peers(self) -> None:
        if self._peers is not None:
            self._gid_size.update(self._peers.participants, self._peers.gid_sizes)

    def _on_gid_size(self, size: int) -> None:
        for participant in self.participants:
            participant.gid_size = size
            participant.changed()

    def close(self) -> None:
        """Delete the participants with all that they contain."""
        for participant in self.participants:
            participant.close()
