"""Writers and readers of nodes: the contract of a middleware on a participant's endpoints.

Endpoints of this process that match are joined directly: nothing of theirs goes over a socket.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Protocol

from ...qos import HistoryPolicy, QoSProfile
from ..base import MAX_PAST, Bytes, OnReady, Reader, Writer
from ..sample_queue import SampleQueue
from .local import LocalReader, LocalWriter, lifespan, why_unmatched
from .parameters import EndpointData, InlineQos, write_related_identity
from .reader import Sample


def _size(sample: Sample) -> int:
    return len(sample.payload or b"")


def _nothing() -> None:
    """An endpoint without a node has nobody to tell."""


class EndpointOwner(Protocol):
    """What endpoints need of the domain that they are in."""

    def ready(self, reader: RtpsReader) -> None:
        """Have the reader's ``on_ready`` called by the next dispatch."""

    def written(self) -> None:
        """Note that datagrams wait for a flush; flush at once without batching."""

    def create_local_writer(
        self, topic: str, type_name: str, qos: QoSProfile,
        wants_header: Callable[[EndpointData], bool] | None,
    ) -> LocalWriter:  # fmt: skip
        """Create and announce a writer."""

    def create_local_reader(
        self, topic: str, type_name: str, qos: QoSProfile, deliver: Callable[[Sample], bool]
    ) -> LocalReader:
        """Create and announce a reader."""

    def join(self, endpoint: RtpsWriter | RtpsReader) -> None:
        """Connect an endpoint with those of this process that match it."""

    def remove(self, endpoint: RtpsWriter | RtpsReader) -> None:
        """Undo :meth:`join`, delete the local endpoint and announce that."""


class RtpsWriter(Writer):
    """A publisher's writer.

    Attributes:
        guid: Its GUID.
        local: The writer of our participant.
        readers: The readers of this process that match.
        on_close: Called when it is closed.
    """

    __slots__ = (
        "_domain", "_lifespan", "_waits", "guid", "is_open", "local", "on_close", "readers"
    )  # fmt: skip

    def __init__(
        self, domain: EndpointOwner, topic: str, type_name: str, qos: QoSProfile,
        wants_header: Callable[[EndpointData], bool] | None = None,
    ) -> None:  # fmt: skip
        self._domain = domain
        self.on_close: Callable[[], None] = _nothing
        self.readers: list[RtpsReader] = []
        # Whether it waits for room in a reliable reader, instead of losing a sample.
        self._waits = qos.reliable and qos.history == HistoryPolicy.KEEP_ALL
        self._lifespan = lifespan(qos)
        self.local = domain.create_local_writer(topic, type_name, qos, wants_header)
        self.guid = self.local.data.guid
        self.is_open = True
        domain.join(self)

    def write(self, cdr: Bytes) -> bool:
        """Write a sample; False where the history has no room."""
        payload = bytes(cdr)
        if not self.readers and self.local.write_once(payload, time.time_ns()):
            if self.local.state.readers:
                self._domain.written()
            return True
        return self.write_related(payload, None, None, None)

    def write_related(
        self,
        payload: bytes,
        related: tuple[bytes, int] | None,
        readers: frozenset[bytes] | None,
        with_header: bytes | None,
    ) -> bool:
        """Write a request or a reply.

        Args:
            payload: The sample with its encapsulation header.
            related: The identity that goes along in inline QoS; None without one.
            readers: GUIDs of the only readers that it is for; None: for all.
            with_header: The sample for readers that want the identity in it.

        Returns:
            False where the history, or a reader of this process, has no room.
        """
        to = self.readers
        if readers is not None:
            to = [reader for reader in to if reader.guid in readers]
        if self._waits and any(reader.is_full and reader.is_reliable for reader in to):
            return False
        now, wall = time.monotonic(), time.time_ns()
        state = self.local.state
        if state.readers or state.transient_local:
            inline_qos = b"" if related is None else write_related_identity(*related)
            if not self.local.write(payload, wall, now, inline_qos, readers, with_header):
                return False
            self._domain.written()
        else:
            state.last += 1  # no other process hears it, now or later
        if to:
            qos = None if related is None else InlineQos(related=related)
            expires = now + self._lifespan
            received = Sample(payload, self.guid, state.last, qos, False, expires, wall)
            for reader in to:
                reader.put(received)
        return True

    def matches(self, reader: RtpsReader) -> bool:
        """Return whether a reader of this process matches."""
        return why_unmatched(self.local.data, reader.local.data) == []

    def past(self) -> list[Sample]:
        """Return the samples that a late reader gets."""
        return [
            Sample(
                change.payload,
                self.guid,
                change.number,
                None,
                False,
                change.expires,
                change.time_ns or 0,
            )  # fmt: skip
            for change in self.local.state.history(time.monotonic())
        ]

    def matched(self) -> int:
        """Return how many readers match it, those of this process included."""
        return len(self.readers) + self.local.matched() if self.is_open else 0

    def close(self) -> None:
        """Leave the topic; idempotent."""
        if self.is_open:
            self.is_open = False
            self._domain.remove(self)
            self.on_close()


class RtpsReader(Reader):
    """A subscription's reader.

    Attributes:
        guid: Its GUID.
        local: Its reader of RTPS.
        is_reliable: Whether its QoS is reliable.
        on_ready: Called by a dispatch after samples have come.
        on_close: Called when it is closed.
        is_open: Whether it was not closed.
        is_announced: Whether ``on_ready`` was called, or will be, since the last take.
    """

    __slots__ = (
        "_depth", "_domain", "_samples", "_was_full", "guid", "is_announced", "is_open",
        "is_reliable", "local", "on_close", "on_ready",
    )  # fmt: skip

    def __init__(
        self, domain: EndpointOwner, topic: str, type_name: str, qos: QoSProfile, on_ready: OnReady
    ) -> None:
        self._domain = domain
        self.on_ready = on_ready
        self.on_close: Callable[[], None] = _nothing
        self.is_announced = False
        self._depth = None if qos.history == HistoryPolicy.KEEP_ALL else max(1, qos.depth)
        self._samples: SampleQueue[Sample] = SampleQueue(self._depth, _size)
        self._was_full = False
        self.is_reliable = qos.reliable
        self.local = domain.create_local_reader(topic, type_name, qos, self._deliver)
        self.guid = self.local.data.guid
        self.is_open = True
        domain.join(self)

    def _deliver(self, sample: Sample) -> bool:
        """Take a sample of a remote writer; False where there is no room."""
        if sample.payload is None or sample.is_key:
            return True  # it disposes of an instance: these topics have none
        if self.put(sample):
            return True
        self._was_full = True
        return False

    @property
    def is_full(self) -> bool:
        """Whether it keeps all samples and has no room for one more."""
        return self._depth is None and len(self._samples) >= MAX_PAST

    def put(self, sample: Sample) -> bool:
        """Store a sample; False where there is no room."""
        if self._depth is None and self.is_full:
            return False
        self._samples.put(sample)
        if not self.is_announced:
            self.is_announced = True
            self._domain.ready(self)
        return True

    def take_samples(self, limit: int) -> list[Sample]:
        """Take samples with what is known of them, oldest first; those that expired are dropped."""
        self.is_announced = False
        if not self.is_open:
            return []
        now = time.monotonic()
        samples: list[Sample] = []
        while len(samples) < limit:
            wanted = limit - len(samples)
            taken = self._samples.take(wanted)
            samples += [sample for sample in taken if sample.expires > now]
            if len(taken) < wanted:
                break
        if self._was_full and len(self._samples) < MAX_PAST:
            self._was_full = False
            self.local.state.resume(now)
        return samples

    def take(self, limit: int) -> list[bytes]:
        """Take samples, oldest first."""
        return [sample.payload for sample in self.take_samples(limit) if sample.payload is not None]

    def take_stamped(self, limit: int) -> list[tuple[bytes, int, bytes]]:
        """Take samples with their source times (Unix ns), 0 if unknown, and their writers."""
        return [
            (sample.payload, sample.source_ns, sample.writer)
            for sample in self.take_samples(limit)
            if sample.payload is not None
        ]

    def arrived(self, limit: int) -> list[int]:
        """Return the octets of samples that have arrived and were not asked for before."""
        self.is_announced = False
        return self._samples.arrived(limit)

    def lost(self) -> int:
        """Return how many samples were lost on the network, or replaced by newer ones."""
        return self.local.state.lost() + self._samples.dropped

    def again(self) -> None:
        """Have ``on_ready`` called once more."""
        self.is_announced = True
        self._domain.ready(self)

    def close(self) -> None:
        """Leave the topic; idempotent."""
        if self.is_open:
            self.is_open = False
            self._domain.remove(self)
            self.on_close()
            self._samples.clear()
