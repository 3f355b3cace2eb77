"""Writers, readers and services of one node.

Services speak rmw_cyclonedds's format: request and reply carry, between the
encapsulation header and the body, the client's 64-bit id and a 64-bit sequence
number in the sample's byte order. What tells a client's two endpoints from
another's is ``clientid=…`` (``serviceid=…``) in their USER_DATA.
"""

from __future__ import annotations

import struct
from collections.abc import Callable
from typing import TYPE_CHECKING, Final

from ...qos import QoSProfile
from ..base import Bytes, MiddlewareError, OnReady, Reader, Replier, Requester, Service, Writer
from . import cyclone
from .watched import Watched

if TYPE_CHECKING:
    from .middleware import DdsNode

_HEADER: Final = 16
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


class DdsReader(Watched, Reader):
    __slots__ = ("_close", "guid", "participant", "qos", "type_name")

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
        if qos.reliable:
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
        self.taken = True
        if self._close is None:
            return []
        samples = [sample for sample, _ in cyclone.take(self.entity, limit)]
        if self.paused:  # after the take: what it left is no news
            self.middleware.resume(self)
        return samples

    def close(self) -> None:
        if self._close:
            self._close()
            self._close = None


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
    __slots__ = ("_client", "_reader", "_sequence", "_writer")

    def __init__(self, node: DdsNode, service: Service, qos: QoSProfile, on_ready: OnReady) -> None:
        data = f"clientid={node.unique_id()};".encode()
        self._reader = DdsReader(
            node, service.reply_topic, service.reply_type, qos, on_ready, data
        )
        try:
            self._writer = DdsWriter(node, service.request_topic, service.request_type, qos, data)
        except BaseException:
            self._reader.close()
            raise
        self._client = struct.pack("<Q", cyclone.instance_handle(self._writer.entity))
        self._sequence = 0

    def request(self, cdr: Bytes) -> int | None:
        sequence = self._sequence + 1
        if not self._writer.write(_join(cdr, self._client + struct.pack("<q", sequence))):
            return None
        self._sequence = sequence
        return sequence

    def take(self, limit: int) -> list[tuple[int, bytes]]:
        while True:
            samples = self._reader.take(limit)
            parsed = [_parse(sample) for sample in samples]
            own = [(it[1], it[2]) for it in parsed if it is not None and it[0] == self._client]
            if own or not samples:
                return own

    def close(self) -> None:
        self._writer.close()
        self._reader.close()


class DdsReplier(Replier):
    __slots__ = ("_reader", "_writer")

    def __init__(self, node: DdsNode, service: Service, qos: QoSProfile, on_ready: OnReady) -> None:
        data = f"serviceid={node.unique_id()};".encode()
        self._writer = DdsWriter(node, service.reply_topic, service.reply_type, qos, data)
        try:
            self._reader = DdsReader(
                node, service.request_topic, service.request_type, qos, on_ready, data
            )
        except BaseException:
            self._writer.close()
            raise

    def take(self, limit: int) -> list[tuple[bytes, int, bytes]]:
        parsed = [_parse(sample) for sample in self._reader.take(limit)]
        return [(it[0] + bytes(8), it[1], it[2]) for it in parsed if it is not None]

    def reply(self, guid: bytes, sequence: int, cdr: Bytes) -> bool:
        return self._writer.write(_join(cdr, guid[:8] + struct.pack("<q", sequence)))

    def close(self) -> None:
        self._writer.close()
        self._reader.close()
