"""Fast DDS writers whose first heartbeat our readers missed are made to send another.

A Fast DDS writer says which of its samples there are to have (a heartbeat) when it meets a
reader, and then every three seconds. A program that starts often meets our readers before Cyclone
has heard of its writers, and what comes from a writer that nobody knows is dropped. Where that
program has published already, Cyclone cannot tell whether it may deliver what follows, and keeps
it back for up to three seconds. Cyclone's own request (a preemptive ACKNACK) does not help: Fast
DDS takes it for an acknowledgement and puts its heartbeat off.

A new reader is met at once, and what its heartbeat says counts for all readers of a writer. So
whenever a Fast DDS writer is discovered that one of our readers hears, a second reader of the same
kind is there for a moment. No node has it, and nothing is taken from it. Other readers than
reliable ones wait for no heartbeat, and a reader of ours that comes later than the writer makes
it send one itself. Readers of services take nothing from Fast DDS (:mod:`.forms`).
"""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from cyclonedds import _clayer

from ...qos import QoSProfile
from ..base import MiddlewareError
from . import builtin, cyclone
from .reader_listener import Watched
from .service_forms import FAST_DDS, OFFER

if TYPE_CHECKING:
    from .endpoints import DdsReader
    from .middleware import DdsMiddleware
    from .participant import SharedParticipant

_BATCH: Final = 256
# Attack: writers that come and go without end. Batches in one turn; others come between.
_BATCHES: Final = 4
# A program makes its writers within a few milliseconds: one reader a topic for all. Cyclone tells
# of a writer just before it connects it with readers, so who is not heard is looked at once more.
_SETTLE: Final = 0.02
_SECOND_LOOK: Final = 0.3
# How long a second reader is there: some slow round trips of a network. No longer, as a publisher
# of rclpy counts it as a subscription.
_LIFE: Final = 0.3
# Attack: writers that come and go without end, on one topic (it has one at once, so three a
# second) or on all that we read.
MAX_READERS: Final = 64
MAX_WRITERS: Final = 1024
# What one tick does of it, so that the data plane has its turn: to delete a reader takes Cyclone
# a millisecond, to ask one whom it hears some microseconds.
_DELETED: Final = 1
_LOOKED_AT: Final = 16
_ASKED: Final = 64


@dataclass
class _Writer:
    """One that was just discovered; ``due`` is when to look at it."""

    topic: str
    seen: float
    due: float
    looked: bool = False


@dataclass
class _Second:
    """A second reader, what it was made from, and how long it is needed."""

    reader: int
    participant: SharedParticipant
    topic: str
    type_name: str
    qos: QoSProfile
    since: float

    @property
    def until(self) -> float:
        return self.since + _LIFE

    def delete(self) -> None:
        self.participant.delete_reader(self.reader, self.topic, self.type_name, self.qos)


class Offers:
    """Does that for one domain, from before its first reliable reader on.

    Ends with the participant it looks through. ``due`` is when :meth:`tick` has something to do.
    """

    def __init__(self, middleware: DdsMiddleware, participant: SharedParticipant) -> None:
        self.due: float | None = None
        self._middleware = middleware
        self._domain = participant.domain
        self._writers: dict[int, _Writer] = {}  # by their instance handles
        self._seconds: dict[tuple[str, str, QoSProfile], _Second] = {}
        self._entity = builtin.create_reader(participant.entity, builtin.TOPIC_PUBLICATION)
        while self._take():
            pass  # those are met by our readers themselves
        self._watched = Watched(middleware, self._entity, self._on_ready)

    def _take(self) -> list[tuple[bytes, str | None, int]]:
        """(GUID, topic or None where it left, instance handle) of some writers."""
        got = _clayer.ddspy_take_endpoint(
            self._entity,
            _BATCH,
            lambda key, _participant, _handle, topic, _type, _qos, info, _id: (
                key,
                topic if info.valid_data else None,
                info.instance_handle,
            ),
            lambda _pointer: None,
        )
        return [] if isinstance(got, int) else got

    def _on_ready(self) -> None:
        self._watched.taken = True
        now = time.monotonic()
        for _ in range(_BATCHES):
            news = self._take()
            for guid, topic, handle in news:
                if topic is None:
                    self._writers.pop(handle, None)
                elif (
                    guid.startswith(FAST_DDS)
                    and len(self._writers) < MAX_WRITERS
                    and any(reader.waits_for_offers for reader in self._readers(topic))
                ):
                    self._writers[handle] = _Writer(topic, now, now + _SETTLE)
            if len(news) < _BATCH:
                break
        else:
            self._middleware.again(self._watched)
        self._plan()

    def _readers(self, topic: str) -> list[DdsReader]:
        """Our readers of a topic."""
        local = self._middleware.local
        key = self._domain, topic
        readers = local.get(key)
        local.release(key)
        return readers

    def tick(self, now: float) -> None:
        """Make what is due, and delete what has had its time."""
        old = [key for key, second in self._seconds.items() if second.until <= now]
        for key in old[:_DELETED]:
            self._seconds.pop(key).delete()
        new = [handle for handle, writer in self._writers.items() if writer.due <= now]
        for handle in new[:_LOOKED_AT]:
            if self._is_done(handle, self._writers[handle], now):
                del self._writers[handle]
        self._plan()

    def _plan(self) -> None:
        times = [second.until for second in self._seconds.values()]
        times += [writer.due for writer in self._writers.values()]
        self.due = min(times, default=None)

    def _is_done(self, handle: int, writer: _Writer, now: float) -> bool:
        """Let a writer meet a second reader; False where that is to be done at its new time."""
        reader = self._hearing(handle, writer.topic)
        if reader is None:
            if writer.looked:
                return True
            writer.looked = True
            writer.due = now + _SECOND_LOOK
            return False
        qos = _like(reader.qos)
        key = writer.topic, reader.type_name, qos
        before = self._seconds.get(key)
        if before is not None:
            if before.since > writer.seen:
                return True  # it has met that one
            writer.due = before.until
            return False
        if len(self._seconds) >= MAX_READERS:
            writer.due = min(second.until for second in self._seconds.values())
            return False
        try:
            entity = reader.participant.create_reader(*key, OFFER)
        except MiddlewareError:
            return True  # it comes with the next heartbeat then
        self._seconds[key] = _Second(entity, reader.participant, *key, now)
        return True

    def _hearing(self, handle: int, topic: str) -> DdsReader | None:
        """A reliable reader of ours that is connected with the writer.

        One that wants what was written before it came, where there is one: the heartbeat for
        another reader would not name these samples, and all readers would give them up.
        """
        reliable = [reader for reader in self._readers(topic) if reader.waits_for_offers]
        reliable.sort(key=lambda reader: not reader.qos.transient_local)
        for reader in reliable[:_ASKED]:
            if handle in cyclone.heard_writers(reader.entity):
                return reader
        return None


def _like(qos: QoSProfile) -> QoSProfile:
    """What is connected with the same writers, and keeps next to nothing."""
    return QoSProfile(
        depth=1,
        durability=qos.durability,
        ownership_exclusive=qos.ownership_exclusive,
        ownership_strength=qos.ownership_strength,
        partitions=qos.partitions,
    )
