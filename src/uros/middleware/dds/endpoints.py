"""Writers, readers and services of one node.

Services speak rmw_cyclonedds's format: request and reply carry, between the
encapsulation header and the body, the client's 64-bit id and a 64-bit sequence
number in the sample's byte order. What tells a client's two endpoints from
another's is ``clientid=…`` (``serviceid=…``) in their USER_DATA. With endpoints
of another form nothing is exchanged: see :mod:`~uros.middleware.dds.service_forms`.
"""

from __future__ import annotations

import struct
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, Final

from ... import names
from ...qos import QoSProfile
from ..base import Bytes, MiddlewareError, OnReady, Reader, Replier, Requester, Service, Writer
from . import cyclone, service_forms
from .reader_listener import Watched

if TYPE_CHECKING:
    from .middleware import DdsNode

_HEADER: Final = 16
# Attack: replies to other clients, or forged ones, as fast as they can be sent. Takes that may
# bring nothing for us in a row; the rest has its turn after others.
_MAX_MISSES: Final = 4
_write = cyclone.write


def type_data(type_name: str) -> bytes:
    """USER_DATA that tells the hash of a type uros knows: ``typehash=RIHS01_…;``"""
    from ...interfaces.typehash import known_hash

    package, _, rest = type_name.partition("::")
    kind, _, name = rest.partition("::dds_::")
    if not name.endswith("_"):
        return b""
    known = known_hash(f"{package}/{kind}/{name[:-1]}")
    return f"typehash={known};".encode() if known else b""


class DdsWriter(Writer):
    __slots__ = ("_batching", "_close", "_local", "_middleware", "entity", "guid", "type_name")

    def __init__(self, node: DdsNode, topic: str, type_name: str, qos: QoSProfile, data: bytes):
        participant = node.participant
        self.type_name = type_name
        self._batching = node.middleware.batching
        self.entity = participant.create_writer(
            topic, type_name, qos, data + type_data(type_name), self._batching
        )
        self.guid = cyclone.guid(self.entity)
        node.add_writer(self)
        self._middleware = node.middleware
        self._local = node.middleware.local.get((participant.domain, topic))
        handle = cyclone.instance_handle(self.entity)
        node.middleware.own_writers.add(handle)

        def close() -> None:
            node.middleware.own_writers.discard(handle)
            if self._batching:
                cyclone.flush(self.entity)
            node.remove_writer(self)
            participant.delete_writer(self.entity, topic, type_name, qos)
            node.middleware.local.release((participant.domain, topic))

        self._close: Callable[[], None] | None = close

    def write(self, cdr: Bytes) -> bool:
        if self._local:
            self._middleware.written(self._local)
        if self._batching:
            self._middleware.unsent.add(self.entity)
        if cdr[1] & 1:
            return _write(self.entity, cdr)
        return _write(self.entity, _little_endian(self.type_name, cdr))

    def matched(self) -> int:
        return cyclone.count_readers(self.entity) if self._close else 0

    def close(self) -> None:
        if self._close:
            self._close()
            self._close = None


def _little_endian(type_name: str, cdr: Bytes) -> bytes:
    """A big-endian sample turned round: the binding would mislabel it as it is.

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
    """Writes requests or replies, for readers of Cyclone's alone; see :mod:`.forms`."""

    __slots__ = ()

    def write(self, cdr: Bytes) -> bool:
        if self._local:
            self._middleware.written(self._local)
        if self._batching:
            self._middleware.unsent.add(self.entity)
        return cyclone.write_disposed(self.entity, cdr)


class DdsReader(Watched, Reader):
    """``waits_for_offers``: see :mod:`~uros.middleware.dds.late_writer_heartbeat`."""

    __slots__ = ("_close", "guid", "participant", "qos", "type_name", "waits_for_offers")
    _may_wait = True

    def __init__(
        self,
        node: DdsNode,
        topic: str,
        type_name: str,
        qos: QoSProfile,
        on_ready: OnReady,
        data: bytes,
    ) -> None:
        middleware, participant = node.middleware, node.participant
        self.participant, self.type_name, self.qos = participant, type_name, qos
        self.waits_for_offers = self._may_wait and qos.reliable
        if self.waits_for_offers:
            middleware.expect_offers(participant)
        entity = participant.create_reader(topic, type_name, qos, data + type_data(type_name))
        self.guid = cyclone.guid(entity)
        super().__init__(middleware, entity, on_ready)
        node.add_reader(self)
        local = middleware.local.get((participant.domain, topic))
        local.append(self)
        middleware.watch_local(self)

        def close() -> None:
            local.remove(self)
            middleware.unwatch(self)
            node.remove_reader(self)
            participant.delete_reader(entity, topic, type_name, qos)
            middleware.local.release((participant.domain, topic))

        self._close: Callable[[], None] | None = close

    def take(self, limit: int) -> list[bytes]:
        return [sample for sample, _ in self._take(limit)]

    def _take(self, limit: int) -> list[tuple[bytes, Any]]:
        """Samples with their SampleInfo."""
        self.taken = True
        if self._close is None:
            return []
        samples = cyclone.take(self.entity, limit)
        if self.paused:  # after the take: what it left is no news
            self.middleware.resume(self)
        return samples

    def arrived(self, limit: int) -> list[int]:
        self.taken = True
        if self._close is None:
            return []
        sizes = cyclone.unread(self.entity, limit)
        if self.paused:
            self.middleware.resume(self)
        return sizes

    def close(self) -> None:
        if self._close:
            self._close()
            self._close = None


class _ServiceReader(DdsReader):
    """Reads requests or replies, of those who speak our form. ``mark`` is what they announce."""

    __slots__ = ("_senders", "refused")
    _may_wait = False

    def __init__(
        self, node: DdsNode, topic: str, type_name: str, qos: QoSProfile, on_ready: OnReady,
        data: bytes, mark: bytes,
    ) -> None:  # fmt: skip
        super().__init__(node, topic, type_name, qos, on_ready, data)
        self._senders = service_forms.Senders(self.entity, mark)
        self.refused = 0  # samples of others

    def take_parsed(self, limit: int) -> tuple[int, list[tuple[bytes, int, bytes]]]:
        """How many samples were taken, and those in our form: (client id as little-endian bytes,
        sequence number, body as a sample).
        """
        taken = self._take(limit)
        out = []
        for sample, info in taken:
            if not self._senders.speaks(info.publication_handle):
                self.refused += 1
            elif (parsed := _parse(sample)) is not None:
                out.append(parsed)
        return len(taken), out


def _join(cdr: Bytes, header: bytes) -> bytes:
    """A sample with an identity header (given little endian) put behind its encapsulation."""
    if not cdr[1] & 1:
        raise MiddlewareError("big-endian service payloads cannot be passed on")
    view = memoryview(cdr)
    return b"".join((view[:4], header, view[4:]))


def _parse(sample: bytes) -> tuple[bytes, int, bytes] | None:
    """``(client id as little-endian bytes, sequence number, body as a sample)``."""
    if len(sample) < 4 + _HEADER:
        return None
    order = "<" if sample[1] & 1 else ">"
    client, sequence = struct.unpack_from(order + "Qq", sample, 4)
    return struct.pack("<Q", client), sequence, sample[:4] + sample[4 + _HEADER :]


class DdsRequester(Requester):
    __slots__ = (
        "_client", "_matching", "_middleware", "_name", "_on_ready", "_reader", "_sequence",
        "_servers", "_writer",
    )  # fmt: skip

    def __init__(self, node: DdsNode, service: Service, qos: QoSProfile, on_ready: OnReady) -> None:
        data = f"clientid={node.unique_id()};".encode()
        self._middleware, self._on_ready = node.middleware, on_ready
        self._name = _shown(service)
        self._reader = _ServiceReader(
            node, service.reply_topic, service.reply_type, qos, on_ready, data, service_forms.SERVER
        )
        try:
            self._writer = _ServiceWriter(
                node, service.request_topic, service.request_type, qos, data
            )
        except BaseException:
            self._reader.close()
            raise
        entity = self._writer.entity
        self._client = struct.pack("<Q", cyclone.instance_handle(entity))
        self._sequence = 0
        self._servers = service_forms.Servers(entity)
        cyclone.wake_on(entity, cyclone.STATUS_PUBLICATION_MATCHED)
        self._matching: Watched | None = Watched(node.middleware, entity, self._matched)

    def _matched(self) -> None:
        """A server came or left."""
        if self._matching is not None:
            self._matching.taken = True
            cyclone.reset(self._matching.entity, cyclone.STATUS_PUBLICATION_MATCHED)
            if self._servers.foreign():
                self._on_ready()

    def refusal(self) -> str:
        if self._matching is None or not self._servers.foreign():
            return ""
        return (
            f"{self._name} is not called: a server of it speaks another form of services than"
            " rmw_cyclonedds's, as rmw_fastrtps does, and would read wrong arguments; give the"
            " agent, or this program, a Python with rclpy, or start that server with"
            " RMW_IMPLEMENTATION=rmw_cyclonedds_cpp"
        )

    def request(self, cdr: Bytes) -> int | None:
        if why := self.refusal():
            raise MiddlewareError(why)
        sequence = self._sequence + 1
        if not self._writer.write(_join(cdr, self._client + struct.pack("<q", sequence))):
            return None
        self._sequence = sequence
        return sequence

    def take(self, limit: int) -> list[tuple[int, bytes]]:
        for _ in range(_MAX_MISSES):
            taken, parsed = self._reader.take_parsed(limit)
            own = [it[1:] for it in parsed if it[0] == self._client]
            if own or not taken:
                return own
        self.again()
        return []

    def again(self) -> None:
        self._middleware.again(self._reader)

    def arrived(self, limit: int) -> list[int]:
        return self._reader.arrived(limit)

    def close(self) -> None:
        if self._matching is not None:
            self._middleware.unwatch(self._matching)
            self._matching = None
        self._writer.close()
        self._reader.close()


class DdsReplier(Replier):
    __slots__ = ("_middleware", "_name", "_reader", "_told", "_writer")

    def __init__(self, node: DdsNode, service: Service, qos: QoSProfile, on_ready: OnReady) -> None:
        data = f"serviceid={node.unique_id()};".encode()
        self._middleware = node.middleware
        self._name = _shown(service)
        self._told = False
        self._writer = _ServiceWriter(node, service.reply_topic, service.reply_type, qos, data)
        try:
            self._reader = _ServiceReader(
                node, service.request_topic, service.request_type, qos, on_ready, data,
                service_forms.CLIENT,
            )  # fmt: skip
        except BaseException:
            self._writer.close()
            raise

    def take(self, limit: int) -> list[tuple[bytes, int, bytes]]:
        for _ in range(_MAX_MISSES):
            taken, parsed = self._reader.take_parsed(limit)
            if self._reader.refused and not self._told:
                self._told = True
                self._middleware.notice(
                    f"a client of {self._name} gets no answer: it speaks another form of services"
                    " than rmw_cyclonedds's, as rmw_fastrtps does; give the agent, or this"
                    " program, a Python with rclpy"
                )
            if parsed or not taken:
                return [(it[0] + bytes(8), it[1], it[2]) for it in parsed]
        self._middleware.again(self._reader)
        return []

    def reply(self, guid: bytes, sequence: int, cdr: Bytes) -> bool:
        return self._writer.write(_join(cdr, guid[:8] + struct.pack("<q", sequence)))

    def arrived(self, limit: int) -> list[int]:
        return self._reader.arrived(limit)

    def close(self) -> None:
        self._writer.close()
        self._reader.close()


def _shown(service: Service) -> str:
    """A service's name, as a person reads it."""
    return names.service_from_request(service.request_topic) or service.request_topic
