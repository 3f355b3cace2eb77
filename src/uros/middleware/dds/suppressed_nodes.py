"""Empties the discovery info of other participants of this process whose nodes would show twice.

With ``auto`` a board's services belong to a node of a participant of rclpy's, and the board's node
lists them as well, so readers would find them under two nodes. rclpy announces its node in any
case. But readers of ``ros_discovery_info`` keep the last message about a participant, from any
writer (the graph cache of rmw_dds_common). So this module writes that rclpy's participant has no
nodes: after each change, and several times after a new reader has matched, because that may get
rclpy's message after this one. (``dds_ignore_participant`` would act on this process alone.)
Readers of uros accept no messages about other participants;
:func:`uros.middleware.graph.living_nodes` leaves out such a node.
"""

from __future__ import annotations

import time
from typing import Final

from ..discovery_info import codec
from . import cyclone
from .context import DdsContext
from .dispatcher import ReaderListener
from .participant import SharedParticipant

# When it is written, in seconds after a change. Fast DDS may send a reader what it missed 3 s late.
_DELAYS: Final = (0.05, 0.3, 1.0, 3.5)


class SuppressedNodes:
    """Writes empty discovery info for participants of one domain.

    Attributes:
        due: When :meth:`tick` writes next (``time.monotonic``), or None.
    """

    def __init__(self, context: DdsContext, participant: SharedParticipant) -> None:
        self.due: float | None = None
        self._dispatcher = context.dispatcher
        self._participant = participant
        self._writers: dict[bytes, int] = {}  # by the suppressed participant's GUID
        self._times: list[float] = []  # when to write again
        context.schedule.add(self)

    def add(self, guid: bytes) -> None:
        """Suppress the nodes of a participant, which is new or has changed them."""
        if guid not in self._writers:
            entity = self._participant.create_writer(codec.TOPIC, codec.TYPE, codec.qos(), b"")
            self._writers[guid] = entity
            cyclone.wake_on(entity, cyclone.STATUS_PUBLICATION_MATCHED)
            listener = ReaderListener(self._dispatcher, entity, lambda: self._on_matched(listener))
        self._restart()

    def _on_matched(self, listener: ReaderListener) -> None:
        """Write the messages again, because a reader has matched or left."""
        listener.taken = True
        cyclone.reset(listener.entity, cyclone.STATUS_PUBLICATION_MATCHED)
        self._restart()

    def _restart(self) -> None:
        now = time.monotonic()
        self._times = [now + seconds for seconds in _DELAYS]
        self.due = self._times[0]

    def tick(self, now: float) -> None:
        """Write the empty messages."""
        for guid, writer in self._writers.items():
            cyclone.write(writer, codec.encode(guid, (), self._participant.gid_size))
        self._times = [at for at in self._times if at > now]
        self.due = self._times[0] if self._times else None
