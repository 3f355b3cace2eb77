"""Makes Fast DDS writers send another heartbeat if Cyclone has missed the first.

A Fast DDS writer sends a heartbeat, which says which of its samples are available, when it matches
a reader, and then every three seconds. When a program starts, it often matches our readers before
Cyclone has discovered its writers, and Cyclone drops what an unknown writer sends. If the program
has published by then, Cyclone cannot tell whether it may deliver the samples that follow, and holds
them back until the next heartbeat, for up to three seconds. Cyclone's own request for a heartbeat
(a preemptive ACKNACK) does not help: Fast DDS takes it for an acknowledgement and postpones its
heartbeat.

A new reader is matched at once, and the heartbeat for it counts for all readers of the writer. So
whenever a Fast DDS writer is discovered that matches one of our readers, a *probe reader* that
matches it too is created, and deleted after 0.3 s. It belongs to no node, and no samples are taken
from it.

Three kinds of readers need no probe reader. Best-effort readers do not wait for a heartbeat. A
reader of ours that is created after the writer is discovered causes a heartbeat itself. Readers of
services take no samples of Fast DDS writers (:mod:`.service_peers`).
"""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import Final

from cyclonedds import _clayer

from ...qos import QoSProfile
from ..base import MiddlewareError
from ..guid import FAST_DDS
from ..user_data import PROBE_READER
from . import builtin, cyclone
from .context import DdsContext, TopicReader
from .dispatcher import ReaderListener
from .participant import SharedParticipant

# How many discovered writers are taken from Cyclone at a time.
_BATCH: Final = 256
# How many batches are taken at a time, so that writers that are created and deleted without end do
# not hold up the data plane. The rest is taken when the data plane dispatches again.
_BATCHES: Final = 4
# Seconds from the discovery of a writer to its check. A program creates its writers within a few
# milliseconds, so one probe reader serves all of its writers of a topic.
_SETTLE: Final = 0.02
# Seconds until a writer without a match is checked once more: Cyclone announces a writer just
# before it matches the writer with readers.
_SECOND_CHECK: Final = 0.3
# Seconds for which a probe reader exists. This is enough for some round trips of a slow network. A
# publisher of rclpy counts the probe reader as a subscription, so it must not exist longer.
_LIFE: Final = 0.3
# The most probe readers at a time, because writers may be created and deleted without end on all
# topics that we read. One topic has one probe reader at a time for each type and QoS, so three a
# second.
MAX_READERS: Final = 64
# The most writers that wait for their check; others are not probed.
MAX_WRITERS: Final = 1024
# The most probe readers that one tick deletes. Cyclone takes a millisecond for each, and the data
# plane must go on meanwhile.
_DELETED: Final = 1
# The most writers that one tick checks.
_CHECKED: Final = 16
# The most readers that one check asks for their matched writers; each takes some microseconds.
_ASKED: Final = 64


@dataclass
class _LateWriter:
    """A writer that was just discovered.

    Attributes:
        due: When to check it (``time.monotonic``).
        checked: Whether a check has found no reader of ours that matches it.
    """

    topic: str
    discovered_at: float
    due: float
    checked: bool = False


@dataclass
class _ProbeReader:
    """A probe reader, what it was created from, and when."""

    entity: int
    participant: SharedParticipant
    topic: str
    type_name: str
    qos: QoSProfile
    created_at: float

    @property
    def until(self) -> float:
        """When to delete it (``time.monotonic``)."""
        return self.created_at + _LIFE

    def delete(self) -> None:
        """Delete the reader."""
        self.participant.delete_reader(self.entity, self.topic, self.type_name, self.qos)


class LateWriterHeartbeats:
    """Probes the late writers of one domain.

    It is created before the domain's first reliable reader, and ends with the participant whose
    discovery it reads.

    Attributes:
        due: When :meth:`tick` has something to do (``time.monotonic``), or None.
    """

    def __init__(self, context: DdsContext, participant: SharedParticipant) -> None:
        self.due: float | None = None
        self._context = context
        self._domain = participant.domain
        self._writers: dict[int, _LateWriter] = {}  # by their instance handles
        self._probes: dict[tuple[str, str, QoSProfile], _ProbeReader] = {}
        self._entity = builtin.create_reader(participant.entity, builtin.TOPIC_PUBLICATION)
        while self._take():
            pass  # these need no probe reader: our readers are created after them
        self._listener = ReaderListener(context.dispatcher, self._entity, self._on_ready)
        context.schedule.add(self)

    def _take(self) -> list[tuple[bytes, str | None, int]]:
        """Take (GUID, topic or None if it left, instance handle) of up to _BATCH writers."""
        writers = _clayer.ddspy_take_endpoint(
            self._entity,
            _BATCH,
            lambda key, _participant, _handle, topic, _type, _qos, info, _id: (
                key,
                topic if info.valid_data else None,
                info.instance_handle,
            ),
            lambda _pointer: None,
        )
        return [] if isinstance(writers, int) else writers

    def _on_ready(self) -> None:
        self._listener.taken = True
        now = time.monotonic()
        for _ in range(_BATCHES):
            changes = self._take()
            for guid, topic, handle in changes:
                if topic is None:
                    self._writers.pop(handle, None)
                elif (
                    guid.startswith(FAST_DDS)
                    and len(self._writers) < MAX_WRITERS
                    and any(reader.needs_heartbeat for reader in self._readers(topic))
                ):
                    self._writers[handle] = _LateWriter(topic, now, now + _SETTLE)
            if len(changes) < _BATCH:
                break
        else:
            self._context.dispatcher.requeue(self._listener)
        self._plan()

    def _readers(self, topic: str) -> list[TopicReader]:
        """Return our readers of a topic."""
        key = self._domain, topic
        # This only reads the table: a list that acquire() creates is removed by release().
        readers = self._context.readers.acquire(key)
        self._context.readers.release(key)
        return readers

    def tick(self, now: float) -> None:
        """Create the probe readers that are due, and delete those that have expired."""
        expired = [key for key, probe in self._probes.items() if probe.until <= now]
        for key in expired[:_DELETED]:
            self._probes.pop(key).delete()
        due = [handle for handle, writer in self._writers.items() if writer.due <= now]
        for handle in due[:_CHECKED]:
            if self._is_done(handle, self._writers[handle], now):
                del self._writers[handle]
        self._plan()

    def _plan(self) -> None:
        times = [probe.until for probe in self._probes.values()]
        times += [writer.due for writer in self._writers.values()]
        self.due = min(times, default=None)

    def _is_done(self, handle: int, writer: _LateWriter, now: float) -> bool:
        """Make a writer match a probe reader; return False to try again at its new ``due``."""
        reader = self._matching_reader(handle, writer.topic)
        if reader is None:
            if writer.checked:
                return True
            writer.checked = True
            writer.due = now + _SECOND_CHECK
            return False
        qos = _probe_qos(reader.qos)
        key = writer.topic, reader.type_name, qos
        existing = self._probes.get(key)
        if existing is not None:
            if existing.created_at > writer.discovered_at:
                return True  # that probe reader is new to the writer, so it causes the heartbeat
            writer.due = existing.until
            return False
        if len(self._probes) >= MAX_READERS:
            writer.due = min(probe.until for probe in self._probes.values())
            return False
        try:
            entity = reader.participant.create_reader(*key, PROBE_READER)
        except MiddlewareError:
            return True  # the samples are delivered after the writer's next heartbeat
        self._probes[key] = _ProbeReader(entity, reader.participant, *key, now)
        return True

    def _matching_reader(self, handle: int, topic: str) -> TopicReader | None:
        """Return a reliable reader of ours that matches the writer, or None.

        A transient-local reader is preferred. The heartbeat for a volatile reader begins after the
        samples that were written before, and all readers would take these for unavailable.
        """
        reliable = [reader for reader in self._readers(topic) if reader.needs_heartbeat]
        reliable.sort(key=lambda reader: not reader.qos.transient_local)
        for reader in reliable[:_ASKED]:
            if handle in cyclone.peek_matched_writers(reader.entity):
                return reader
        return None


def _probe_qos(qos: QoSProfile) -> QoSProfile:
    """Return a profile that matches the same writers, and keeps one sample."""
    return QoSProfile(
        depth=1,
        durability=qos.durability,
        ownership_exclusive=qos.ownership_exclusive,
        ownership_strength=qos.ownership_strength,
        partitions=qos.partitions,
    )
