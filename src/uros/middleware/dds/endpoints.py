"""Writers, readers, service clients and servers of one node.

Services have the form of rmw_cyclonedds: the header of
:mod:`uros.middleware.services.request_header`, and ``clientid=…`` or ``serviceid=…`` in the
USER_DATA of both endpoints. With endpoints of another form nothing is exchanged, see
:mod:`~uros.middleware.dds.service_peers`.
"""

from __future__ import annotations

import ctypes
import struct
from collections.abc import Callable
from typing import Any, Final, Protocol

from ...qos import QoSProfile
from .. import user_data
from ..base import Bytes, MiddlewareError, OnReady, Reader, Replier, Requester, Service, Writer
from ..services import request_header
from ..services.form import CLIENT_ID, SERVICE_ID
from ..services.names import display_name
from . import cyclone
from .context import DdsContext, TopicReader
from .dispatcher import ReaderListener
from .participant import SharedParticipant
from .service_peers import MatchedServers, MatchedWriters

# The most takes in a row that may return nothing for us, because replies to other clients, or
# forged ones, may arrive as fast as they can be sent. The rest is taken in a later turn of the
# loop.
_MAX_MISSES: Final = 4

_get_sample_lost_status = cyclone.function(
    "dds_get_sample_lost_status", ctypes.c_int32, ctypes.c_int32, ctypes.c_void_p
)


class OwningNode(Protocol):
    """What endpoints need of the node that they are created for."""

    context: DdsContext
    participant: SharedParticipant

    def service_endpoint_id(self) -> str:
        """Return a new id for a service client or server, as rmw_cyclonedds writes it."""

    def expect_late_writers(self) -> None:
        """Prepare for a reliable reader; see :mod:`~uros.middleware.dds.late_writer_heartbeat`."""

    def register(self, endpoint: DdsWriter | DdsReader) -> None:
        """List an endpoint in the node's discovery info."""

    def unregister(self, endpoint: DdsWriter | DdsReader) -> None:
        """Remove an endpoint from that list."""


class DdsWriter(Writer):
    """A publisher's writer.

    Attributes:
        entity: The DDS entity.
        guid: Its GUID.
        type_name: The DDS name of its type.
    """

    __slots__ = (
        "_batching", "_close", "_dispatcher", "_local_readers", "_unsent", "entity", "guid",
        "type_name",
    )  # fmt: skip

    def __init__(
        self, node: OwningNode, topic: str, type_name: str, qos: QoSProfile, data: bytes
    ) -> None:
        context, participant = node.context, node.participant
        self.type_name = type_name
        self._batching = context.middleware.batching
        self._unsent = context.unsent
        self.entity = participant.create_writer(
            topic, type_name, qos, data + user_data.type_hash(type_name), self._batching
        )
        self.guid = cyclone.guid(self.entity)
        node.register(self)
        self._dispatcher = context.dispatcher
        self._local_readers = context.readers.acquire((participant.domain, topic))
        handle = cyclone.instance_handle(self.entity)
        self._dispatcher.own_writers.add(handle)

        def close() -> None:
            self._dispatcher.own_writers.discard(handle)
            if self._batching:
                cyclone.flush(self.entity)
            node.unregister(self)
            participant.delete_writer(self.entity, topic, type_name, qos)
            context.readers.release((participant.domain, topic))

        self._close: Callable[[], None] | None = close

    def write(self, cdr: Bytes) -> bool:
        """Write a sample; return False if the writer has no room.

        Raises:
            MiddlewareError: DDS refuses it, or it is big endian and its type unknown.
        """
        if self._local_readers:
            self._dispatcher.written(self._local_readers, not self._batching)
        if self._batching:
            self._unsent.add(self.entity)
        if cdr[1] & 1:
            if len(cdr) & 3:
                return cyclone.write(self.entity, cdr)
            code = cyclone.write_aligned(self.entity, cdr)
            return code == 0 or cyclone.is_written(code)
        return cyclone.write(self.entity, _little_endian(self.type_name, cdr))

    def matched(self) -> int:
        """Return how many readers match it, those of this process included."""
        return cyclone.count_readers(self.entity) if self._close else 0

    def close(self) -> None:
        """Send what is held back and delete the writer; idempotent."""
        if self._close:
            self._close()
            self._close = None


def _little_endian(type_name: str, cdr: Bytes) -> bytes:
    """Convert a big-endian sample, which the binding would label as little endian.

    Raises MiddlewareError for a type that uros does not know.
    """
    from ...interfaces import InterfaceError, codec, load

    try:
        return codec.to_cdr(codec.from_cdr(load(type_name), cdr))
    except InterfaceError as error:
        raise MiddlewareError(
            f"big-endian samples of {type_name} cannot be passed on: {error}"
        ) from error


class _ServiceWriter(DdsWriter):
    """Writes requests or replies such that Cyclone's readers alone read them."""

    __slots__ = ()

    def write(self, cdr: Bytes) -> bool:
        if self._local_readers:
            self._dispatcher.written(self._local_readers, not self._batching)
        if self._batching:
            self._unsent.add(self.entity)
        return cyclone.write_disposed(self.entity, cdr)


class DdsReader(TopicReader, Reader):
    """A subscription's reader.

    Attributes:
        guid: Its GUID.
    """

    __slots__ = ("_close", "guid")
    _may_need_heartbeat = True
    counts_replaced = False  # Cyclone has no such count

    def __init__(
        self,
        node: OwningNode,
        topic: str,
        type_name: str,
        qos: QoSProfile,
        on_ready: OnReady,
        data: bytes,
    ) -> None:
        context, participant = node.context, node.participant
        dispatcher = context.dispatcher
        needs_heartbeat = self._may_need_heartbeat and qos.reliable
        if needs_heartbeat:
            node.expect_late_writers()
        entity = participant.create_reader(
            topic, type_name, qos, data + user_data.type_hash(type_name)
        )
        self.guid = cyclone.guid(entity)
        super().__init__(dispatcher, entity, on_ready, participant, type_name, qos, needs_heartbeat)
        node.register(self)
        local_readers = context.readers.acquire((participant.domain, topic))
        local_readers.append(self)

        def close() -> None:
            local_readers.remove(self)
            dispatcher.unwatch(self)
            node.unregister(self)
            participant.delete_reader(entity, topic, type_name, qos)
            context.readers.release((participant.domain, topic))

        self._close: Callable[[], None] | None = close

    def take(self, limit: int) -> list[bytes]:
        """Take samples, oldest first."""
        return [sample for sample, _ in self._take(limit)]

    def take_stamped(self, limit: int) -> list[tuple[bytes, int, bytes]]:
        """Take samples with their source times (Unix ns), without the GUIDs of their writers."""
        return [(sample, info.source_timestamp, b"") for sample, info in self._take(limit)]

    def _take(self, limit: int) -> list[tuple[bytes, Any]]:
        """Take samples with their SampleInfo."""
        self.taken = True
        if self._close is None:
            return []
        samples = cyclone.take(self.entity, limit)
        if self.paused:  # after the take: what it left must not wake the thread
            self.dispatcher.resume(self)
        return samples

    def arrived(self, limit: int) -> list[int]:
        """Return the octets of samples that have arrived and were not asked for before."""
        self.taken = True
        if self._close is None:
            return []
        sizes = cyclone.unread(self.entity, limit)
        if self.paused:
            self.dispatcher.resume(self)
        return sizes

    def lost(self) -> int:
        """Return how many samples the network has lost."""
        if self._close is None:
            return 0
        status = (ctypes.c_uint32 * 2)()  # total, and its change, of dds_sample_lost_status
        cyclone.check(_get_sample_lost_status(self.entity, status), "count lost samples")
        return int(status[0])

    def close(self) -> None:
        """Delete the reader; idempotent."""
        if self._close:
            self._close()
            self._close = None


class _ServiceReader(DdsReader):
    """Reads requests or replies of endpoints that use the header; ``role`` is theirs."""

    __slots__ = ("_writers", "refused")
    _may_need_heartbeat = False

    def __init__(
        self, node: OwningNode, topic: str, type_name: str, qos: QoSProfile, on_ready: OnReady,
        data: bytes, role: bytes,
    ) -> None:  # fmt: skip
        super().__init__(node, topic, type_name, qos, on_ready, data)
        self._writers = MatchedWriters(self.entity, role)
        self.refused = 0  # samples of incompatible writers

    def take_parsed(self, limit: int) -> tuple[int, list[tuple[bytes, int, bytes]]]:
        """Return how many samples were taken, and those with the header, split by `remove`."""
        samples = self._take(limit)
        out = []
        for sample, info in samples:
            if not self._writers.is_compatible(info.publication_handle):
                self.refused += 1
            elif (parsed := request_header.remove(sample)) is not None:
                out.append(parsed)
        return len(samples), out


class DdsRequester(Requester):
    """A service client."""

    __slots__ = (
        "_client_id", "_context", "_match_listener", "_name", "_on_ready", "_reader", "_sequence",
        "_servers", "_writer",
    )  # fmt: skip

    def __init__(
        self, node: OwningNode, service: Service, qos: QoSProfile, on_ready: OnReady
    ) -> None:
        data = CLIENT_ID + node.service_endpoint_id().encode() + b";"
        self._context, self._on_ready = node.context, on_ready
        self._name = display_name(service)
        self._reader = _ServiceReader(
            node, service.reply_topic, service.reply_type, qos, on_ready, data, SERVICE_ID
        )
        try:
            self._writer = _ServiceWriter(
                node, service.request_topic, service.request_type, qos, data
            )
        except BaseException:
            self._reader.close()
            raise
        entity = self._writer.entity
        self._client_id = struct.pack("<Q", cyclone.instance_handle(entity))
        self._sequence = 0
        self._servers = MatchedServers(entity)
        cyclone.wake_on(entity, cyclone.STATUS_PUBLICATION_MATCHED)
        self._match_listener: ReaderListener | None = ReaderListener(
            node.context.dispatcher, entity, self._on_matched
        )

    def _on_matched(self) -> None:
        """Check the servers again, because one has matched or left."""
        if self._match_listener is not None:
            self._match_listener.taken = True
            cyclone.reset(self._match_listener.entity, cyclone.STATUS_PUBLICATION_MATCHED)
            if self._servers.has_incompatible():
                self._on_ready()

    def refusal(self) -> str:
        """Return why no request is sent, or an empty string."""
        if self._match_listener is None or not self._servers.has_incompatible():
            return ""
        return (
            f"{self._name} is not called: a server of it speaks another form of services than"
            " rmw_cyclonedds's, as rmw_fastrtps does, and would read wrong arguments; use the"
            " middleware auto or rtps in place of dds"
        )

    def request(self, cdr: Bytes) -> int | None:
        """Send a request; return its sequence number, or None if there is no room.

        Raises:
            MiddlewareError: An incompatible server is matched, see :meth:`refusal`.
        """
        if why := self.refusal():
            raise MiddlewareError(why)
        sequence = self._sequence + 1
        if not self._writer.write(request_header.insert(cdr, self._client_id, sequence)):
            return None
        self._sequence = sequence
        return sequence

    def take(self, limit: int) -> list[tuple[int, bytes]]:
        """Take replies to own requests."""
        own: list[tuple[int, bytes]] = []
        for _ in range(_MAX_MISSES):
            wanted = limit - len(own)
            count, parsed = self._reader.take_parsed(wanted)
            own += [
                (sequence, body)
                for client_id, sequence, body in parsed
                if client_id == self._client_id
            ]
            if count < wanted or len(own) == limit:
                return own
        self.again()
        return own

    def again(self) -> None:
        """Have ``on_ready`` called again, after others."""
        self._context.dispatcher.requeue(self._reader)

    def arrived(self, limit: int) -> list[int]:
        """Return the octets of samples that have arrived and were not asked for before."""
        return self._reader.arrived(limit)

    def close(self) -> None:
        """Delete both endpoints; idempotent."""
        if self._match_listener is not None:
            self._context.dispatcher.unwatch(self._match_listener)
            self._match_listener = None
        self._writer.close()
        self._reader.close()


class DdsReplier(Replier):
    """A service's server."""

    __slots__ = ("_context", "_name", "_noticed", "_reader", "_writer")

    def __init__(
        self, node: OwningNode, service: Service, qos: QoSProfile, on_ready: OnReady
    ) -> None:
        data = SERVICE_ID + node.service_endpoint_id().encode() + b";"
        self._context = node.context
        self._name = display_name(service)
        self._noticed = False
        self._writer = _ServiceWriter(node, service.reply_topic, service.reply_type, qos, data)
        try:
            self._reader = _ServiceReader(
                node, service.request_topic, service.request_type, qos, on_ready, data, CLIENT_ID
            )
        except BaseException:
            self._writer.close()
            raise

    def take(self, limit: int) -> list[tuple[bytes, int, bytes]]:
        """Take requests, each with the client's id padded to a GUID."""
        requests: list[tuple[bytes, int, bytes]] = []
        for _ in range(_MAX_MISSES):
            wanted = limit - len(requests)
            count, parsed = self._reader.take_parsed(wanted)
            if self._reader.refused and not self._noticed:
                self._noticed = True
                self._context.notice(
                    f"a client of {self._name} gets no answer: it speaks another form of services"
                    " than rmw_cyclonedds's, as rmw_fastrtps does; use the middleware auto or rtps"
                    " in place of dds"
                )
            requests += [
                (client_id + bytes(8), sequence, body) for client_id, sequence, body in parsed
            ]
            if count < wanted or len(requests) == limit:
                return requests
        self._context.dispatcher.requeue(self._reader)
        return requests

    def reply(self, guid: bytes, sequence: int, cdr: Bytes) -> bool:
        """Send a reply; return False if there is no room."""
        return self._writer.write(request_header.insert(cdr, guid[:8], sequence))

    def arrived(self, limit: int) -> list[int]:
        """Return the octets of samples that have arrived and were not asked for before."""
        return self._reader.arrived(limit)

    def close(self) -> None:
        """Delete both endpoints; idempotent."""
        self._writer.close()
        self._reader.close()
