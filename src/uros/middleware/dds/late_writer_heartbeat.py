"""Makes a Fast DDS writer send a heartbeat when Cyclone has discovered it too late for its first.

A Fast DDS writer says which of its samples are available (a heartbeat) when it matches a reader,
and then every three seconds. A program that starts often matches our readers before Cyclone has
discovered its writers, and Cyclone drops what an unknown writer sends. Where the program has
published already, Cyclone cannot tell whether it may deliver the samples that follow, and keeps
them back for up to three seconds. Cyclone's own request (a preemptive ACKNACK) does not help: Fast
DDS takes it for an acknowledgement and postpones its heartbeat.

A new reader is matched at once, and the heartbeat for it counts for all readers of the writer. So
whenever a Fast DDS writer is discovered that matches one of our readers, a *probe reader* with the
same QoS is created for a moment. It belongs to no node, and nothing is taken from it. Readers that
are not reliable wait for no heartbeat, and a reader of ours that is created after the writer causes
one itself. Readers of services take nothing from Fast DDS (:mod:`.service_peers`).
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

_BATCH: Final = 256
# Attack: writers that come and go without end. Batches in one turn; the rest has to wait.
_BATCHES: Final = 4
# A program creates its writers within a few milliseconds: one probe reader a topic for all. Cyclone
# announces a writer just before it matches it with readers, so a writer without a match is checked
# once more. Seconds.
_SETTLE: Final = 0.02
_SECOND_CHECK: Final = 0.3
# Seconds for which a probe reader exists: some slow round trips of a network. No longer, as a
# publisher of rclpy counts it as a subscription.
_LIFE: Final = 0.3
# Attack: writers that come and go without end, on one topic (it has one probe reader at a time, so
# three a second) or on all that we read.
MAX_READERS: Final = 64
MAX_WRITERS: Final = 1024
# What one tick does, so that the data plane has its turn: deleting a reader takes Cyclone a
# millisecond, asking one for its writers some microseconds.
_DELETED: Final = 1
_CHECKED: Final = 16
_ASKED: Final = 64


@dataclass
class _LateWriter:
    """A writer that was just discovered; ``due`` is when to check it."""

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
        """When it is to be deleted."""
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
            pass  # our readers, created later, cause a heartbeat of these themselves
        self._listener = ReaderListener(context.dispatcher, self._entity, self._on_ready)
        context.schedule.add(self)

    def _take(self) -> list[tuple[bytes, str | None, int]]:
        """(GUID, topic or None where it left, instance handle) of some writers."""
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
        """Our readers of a topic."""
        key = self._domain, topic
        readers = self._context.readers.acquire(key)
        self._context.readers.release(key)
        return readers

    def tick(self, now: float) -> None:
        """Create the probe readers that are due, and delete those whose time is over."""
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
                return True  # it has matched that one
            writer.due = existing.until
            return False
        if len(self._probes) >= MAX_READERS:
            writer.due = min(probe.until for probe in self._probes.values())
            return False
        try:
            entity = reader.participant.create_reader(*key, PROBE_READER)
        except MiddlewareError:
            return True  # the samples come with the next heartbeat
        self._probes[key] = _ProbeReader(entity, reader.participant, *key, now)
        return True

    def _matching_reader(self, handle: int, topic: str) -> TopicReader | None:
        """A reliable reader of ours that is matched with the writer.

        A transient-local one where there is one. The heartbeat for a volatile reader begins after
        the samples that were written before, and all readers would take these for unavailable.
        """
        reliable = [reader for reader in self._readers(topic) if reader.needs_heartbeat]
        reliable.sort(key=lambda reader: not reader.qos.transient_local)
        for reader in reliable[:_ASKED]:
            if handle in cyclone.peek_matched_writers(reader.entity):
                return reader
        return None


def _probe_qos(qos: QoSProfile) -> QoSProfile:
    """A profile that matches the same writers, and keeps next to nothing."""
    return QoSProfile(
        depth=1,
        durability=qos.durability,
        ownership_exclusive=qos.ownership_exclusive,
        ownership_strength=qos.ownership_strength,
        partitions=qos.partitions,
    )
