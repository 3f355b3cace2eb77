"""``ros_discovery_info`` of a domain: what we announce there, and what others do."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from typing import Final

from ..discovery_info import codec
from ..discovery_info.gid_size import GidSizeSelector
from ..discovery_info.intake import MAX_UNREAD, RATE, Intake
from .endpoints import EndpointOwner, RtpsReader, RtpsWriter

# A board creates its entities within a few milliseconds: one message for all. Seconds.
_SETTLE: Final = 0.02
# At least; each message tells of all nodes, and those of many follow as fast as another uros parses
# them.
_INTERVAL: Final = 0.1


class RtpsDiscoveryInfo:
    """The writer and the reader of the topic, and what they announce and know.

    Attributes:
        nodes: Our nodes; after a change call :meth:`changed`.
        intake: The nodes of other participants.

    Args:
        owner: The domain.
        guid: The GUID of our participant.
        number: The domain's number, for notices.
        gid_size: Octets of a Gid that ROS_DISTRO asks for, or None.
        participants: Returns USER_DATA of the participants known, by GUID.
        is_there: Returns whether the participant of a writer's GUID is there.
        notice: Called with a line for the user.
        on_change: Called after each change of the nodes, ours or others'.
    """

    def __init__(
        self,
        owner: EndpointOwner,
        guid: bytes,
        number: int,
        gid_size: int | None,
        participants: Callable[[], Mapping[bytes, bytes]],
        is_there: Callable[[bytes], bool],
        notice: Callable[[str], None],
        on_change: Callable[[], None],
    ) -> None:
        self.nodes: list[codec.NodeEntities] = []
        self.intake = Intake(number, notice)
        self._owner = owner
        self._guid = guid
        self._participants = participants
        self._is_there = is_there
        self._on_change = on_change
        self._gid_size = GidSizeSelector(number, gid_size, lambda size: self.changed(), notice)
        self._write_at: float | None = None
        self._write_next = 0.0  # at the earliest
        self._writer = RtpsWriter(owner, codec.TOPIC, codec.TYPE, codec.qos())
        self._read_again_at: float | None = None
        self._reader: RtpsReader | None = self._create_reader()

    def announced(self) -> Mapping[bytes, list[codec.NodeEntities]]:
        """Return the nodes of each participant, ours included, by its GUID."""
        return {**self.intake.nodes, self._guid: self.nodes}

    def changed(self) -> None:
        """Schedule a message: nodes or endpoints were created or closed."""
        if self._write_at is None:
            self._write_at = max(time.monotonic() + _SETTLE, self._write_next)
        self._on_change()

    def select_gid_size(self) -> None:
        """Select the size of a Gid anew: other participants, or their messages, have changed."""
        self._gid_size.update(self._participants(), self.intake.gid_sizes)

    def next_deadline(self) -> float | None:
        """Return when :meth:`tick` has work (``time.monotonic``), or None."""
        deadlines = [self._write_at, self._read_again_at]
        return min((at for at in deadlines if at is not None), default=None)

    def tick(self, now: float) -> None:
        """Write what has changed, and read again after a pause."""
        if self._write_at is not None and self._write_at <= now:
            sample = codec.encode(self._guid, self.nodes, self._gid_size.size)
            self._write_next = now + max(_INTERVAL, len(sample) / RATE)
            self._write_at = None if self._writer.write(sample) else self._write_next
        if self._read_again_at is not None and self._read_again_at <= now:
            self._read_again_at = None
            self._reader = self._create_reader()

    def _create_reader(self) -> RtpsReader:
        qos = codec.qos()
        # The topic has no key: with a depth of 1 participants would displace each other's samples.
        qos.depth = MAX_UNREAD
        return RtpsReader(self._owner, codec.TOPIC, codec.TYPE, qos, self._on_ready)

    def _on_ready(self) -> None:
        """Read within the limits of the intake."""
        reader = self._reader
        if reader is None:
            return
        now = time.monotonic()
        turn = self.intake.read(lambda: self._take(reader), now)
        if turn.has_more:
            reader.again()
        if turn.pause is not None:
            self._reader = None
            self._read_again_at = now + turn.pause
            reader.close()
        if turn.is_changed:
            self.select_gid_size()
            self._on_change()

    def _take(self, reader: RtpsReader) -> tuple[bytes | None, bytes] | None:
        """Take a sample of another participant, which may have left since it came."""
        while samples := reader.take_samples(1):
            (sample,) = samples
            if sample.writer != self._writer.guid:
                writer = sample.writer if self._is_there(sample.writer) else None
                return writer, sample.payload or b""
        return None
