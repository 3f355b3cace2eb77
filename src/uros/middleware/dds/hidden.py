"""Participants of this process that are not ours, and whose nodes are not to be in the graph.

With ``auto`` a board's services stand in a participant of rclpy's, under a node of their own there,
and the board's node lists them too: everybody would find them under two nodes. rclpy announces that
node whatever we do. But who reads ``ros_discovery_info`` keeps the last word about a participant,
whoever it came from (rmw_dds_common's graph cache). So we say of rclpy's participant that it has no
nodes: after each change, and when a new reader has met us, some more times, as its reader may hear
rclpy after us. Readers of uros believe nobody about others; they pass over a hidden node whose
endpoints stand under the board's as well.
"""

from __future__ import annotations

import time
from typing import TYPE_CHECKING, Final

from . import announce, cyclone
from .reader_listener import Watched

if TYPE_CHECKING:
    from .middleware import DdsMiddleware
    from .participant import SharedParticipant

# When it is said, in seconds after a change. Fast DDS may tell a reader 3 s late what it missed.
_TIMES: Final = (0.05, 0.3, 1.0, 3.5)


class HiddenNodes:
    """Does that for one domain. ``due`` is when :meth:`tick` has something to do."""

    def __init__(self, middleware: DdsMiddleware, participant: SharedParticipant) -> None:
        self.due: float | None = None
        self._middleware = middleware
        self._participant = participant
        self._writers: dict[bytes, int] = {}  # by the participant's GUID
        self._left: list[float] = []  # when it is said again

    def add(self, guid: bytes) -> None:
        """The nodes of that participant have changed, or it is new."""
        if guid not in self._writers:
            entity = self._participant.create_writer(
                announce.TOPIC, announce.TYPE, announce.qos(), b""
            )
            self._writers[guid] = entity
            cyclone.wake_on(entity, cyclone.STATUS_PUBLICATION_MATCHED)
            watched = Watched(self._middleware, entity, lambda: self._matched(watched))
        self._again()

    def _matched(self, watched: Watched) -> None:
        """A reader came or left."""
        watched.taken = True
        cyclone.reset(watched.entity, cyclone.STATUS_PUBLICATION_MATCHED)
        self._again()

    def _again(self) -> None:
        now = time.monotonic()
        self._left = [now + seconds for seconds in _TIMES]
        self.due = self._left[0]

    def tick(self, now: float) -> None:
        """Say it."""
        for guid, writer in self._writers.items():
            cyclone.write(writer, announce.encode(guid, (), self._participant.gid_size))
        self._left = [at for at in self._left if at > now]
        self.due = self._left[0] if self._left else None
