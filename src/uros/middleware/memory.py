"""A network inside this process: for unit tests, and as the smallest example of a middleware.

All :class:`MemoryMiddleware` objects of one :class:`Bus` share it, each in a thread of its own if
wanted. QoS is honoured as far as it matters inside a process: keep-last depth, transient-local
history, and that a best-effort writer does not match a reliable reader.
"""

from __future__ import annotations

import itertools
import threading
from collections import deque
from collections.abc import Callable
from typing import TypeVar

from ..qos import HistoryPolicy, QoSProfile
from .base import (
    MAX_PAST,
    Bytes,
    Middleware,
    Node,
    OnReady,
    Reader,
    Replier,
    Requester,
    Service,
    Writer,
    check_domain,
)
from .sample_queue import SampleQueue
from .wakeup_fd import WakeupFd

_Endpoint = TypeVar("_Endpoint")


class Bus:
    """What the middlewares of one network share.

    Attributes:
        lock: Guards everything here, and the samples of the readers.
        readers: The readers by (domain, topic).
        writers: The writers by (domain, topic).
        nodes: The nodes, in order of creation.
        client_ids: Numbers for service clients.
    """

    def __init__(self) -> None:
        self.lock = threading.RLock()
        self.readers: dict[tuple[int, str], list[MemoryReader]] = {}
        self.writers: dict[tuple[int, str], list[MemoryWriter]] = {}
        self.nodes: list[MemoryNode] = []
        self.client_ids = itertools.count(1)


class MemoryWriter(Writer):
    """A publisher's writer.

    Attributes:
        type_name: The DDS name of its type.
        qos: Its profile.
        past: Its history for late transient-local readers.
    """

    def __init__(
        self, node: MemoryNode, key: tuple[int, str], type_name: str, qos: QoSProfile
    ) -> None:
        self.type_name = type_name
        self.qos = qos
        self._node = node
        bus = self._bus = node.middleware.bus
        self._key = key
        depth = MAX_PAST if qos.history == HistoryPolicy.KEEP_ALL else qos.depth
        self.past: deque[bytes] = deque(maxlen=depth if qos.transient_local else 0)
        with bus.lock:
            bus.writers.setdefault(key, []).append(self)

    def write(self, cdr: Bytes) -> bool:
        """Put a sample into all matching readers; always True."""
        sample = bytes(cdr)
        with self._bus.lock:
            for reader in self._bus.readers.get(self._key, ()):
                if reader.matches(self):
                    reader.put(sample)
            self.past.append(sample)
        return True

    def matched(self) -> int:
        """Return how many readers match it."""
        with self._bus.lock:
            if self not in self._bus.writers.get(self._key, ()):
                return 0
            return sum(reader.matches(self) for reader in self._bus.readers.get(self._key, ()))

    def close(self) -> None:
        """Leave the topic; idempotent."""
        with self._bus.lock:
            _leave(self._bus.writers, self._key, self)
        self._node.left(self)


class MemoryReader(Reader):
    """A subscription's reader.

    Attributes:
        type_name: The DDS name of its type.
        qos: Its profile.
        on_ready: Called when samples have arrived.
        announced: Whether it was called and nothing was taken since.
    """

    def __init__(
        self,
        node: MemoryNode,
        key: tuple[int, str],
        type_name: str,
        qos: QoSProfile,
        on_ready: OnReady,
    ) -> None:
        self.type_name = type_name
        self.qos = qos
        self.on_ready = on_ready
        self.announced = False
        self._node = node
        self._middleware = node.middleware
        self._key = key
        depth = None if qos.history == HistoryPolicy.KEEP_ALL else qos.depth
        self._samples: SampleQueue[bytes] = SampleQueue(depth, len)
        bus = self._middleware.bus
        with bus.lock:
            bus.readers.setdefault(key, []).append(self)
            if qos.transient_local:
                for writer in bus.writers.get(key, ()):
                    if self.matches(writer):
                        for sample in writer.past:
                            self.put(sample)

    def matches(self, writer: MemoryWriter) -> bool:
        """Return whether a writer of the topic has the type and offers the QoS."""
        return (
            writer.type_name == self.type_name
            and (writer.qos.reliable or not self.qos.reliable)
            and (writer.qos.transient_local or not self.qos.transient_local)
        )

    def put(self, sample: bytes) -> None:
        """Store a sample; called with the bus locked, from any thread."""
        self._samples.put(sample)
        if not self.announced:
            self._middleware.mark(self)

    def take(self, limit: int) -> list[bytes]:
        """Take samples, oldest first."""
        with self._middleware.bus.lock:
            self.announced = False
            return self._samples.take(limit)

    def arrived(self, limit: int) -> list[int]:
        """Return the octets of samples that have arrived and were not asked for before."""
        with self._middleware.bus.lock:
            self.announced = False
            return self._samples.arrived(limit)

    def again(self) -> None:
        """Have ``on_ready`` called once more."""
        with self._middleware.bus.lock:
            self._middleware.mark(self)

    def close(self) -> None:
        """Leave the topic; idempotent."""
        bus = self._middleware.bus
        with bus.lock:
            _leave(bus.readers, self._key, self)
            self._middleware.unmark(self)
            self._samples.clear()
        self._node.left(self)


def _leave(
    endpoints: dict[tuple[int, str], list[_Endpoint]], key: tuple[int, str], endpoint: _Endpoint
) -> None:
    """Remove an endpoint from its topic, and the topic with its last one."""
    peers = endpoints.get(key, [])
    if endpoint in peers:
        peers.remove(endpoint)
        if not peers:
            del endpoints[key]


class MemoryRequester(Requester):
    """A service client: requests and replies are samples with 16 octets of identity in front."""

    def __init__(self, guid: int, writer: Writer, reader: MemoryReader) -> None:
        self._guid = guid.to_bytes(8, "little")
        self._sequence = 0
        self._writer = writer
        self._reader = reader

    def request(self, cdr: Bytes) -> int | None:
        """Send a request; return its sequence number."""
        self._sequence += 1
        self._writer.write(self._guid + self._sequence.to_bytes(8, "little") + bytes(cdr))
        return self._sequence

    def again(self) -> None:
        """Have ``on_ready`` called once more."""
        self._reader.again()

    def take(self, limit: int) -> list[tuple[int, bytes]]:
        """Take replies to own requests."""
        own: list[tuple[int, bytes]] = []
        while True:
            wanted = limit - len(own)
            replies = self._reader.take(wanted)
            own += [
                (int.from_bytes(sample[8:16], "little"), sample[16:])
                for sample in replies
                if sample[:8] == self._guid and len(sample) >= 20
            ]
            if len(replies) < wanted or len(own) == limit:
                return own

    def arrived(self, limit: int) -> list[int]:
        """Return the octets of samples that have arrived and were not asked for before."""
        return self._reader.arrived(limit)

    def close(self) -> None:
        """Leave the service; idempotent."""
        self._writer.close()
        self._reader.close()


class MemoryReplier(Replier):
    """A service's server."""

    def __init__(self, writer: Writer, reader: Reader) -> None:
        self._writer = writer
        self._reader = reader

    def take(self, limit: int) -> list[tuple[bytes, int, bytes]]:
        """Take requests."""
        requests: list[tuple[bytes, int, bytes]] = []
        while True:
            wanted = limit - len(requests)
            samples = self._reader.take(wanted)
            requests += [
                (sample[:8] + bytes(8), int.from_bytes(sample[8:16], "little"), sample[16:])
                for sample in samples
                if len(sample) >= 20
            ]
            if len(samples) < wanted or len(requests) == limit:
                return requests

    def reply(self, guid: bytes, sequence: int, cdr: Bytes) -> bool:
        """Send a reply; always True."""
        return self._writer.write(guid[:8] + sequence.to_bytes(8, "little") + bytes(cdr))

    def arrived(self, limit: int) -> list[int]:
        """Return the octets of samples that have arrived and were not asked for before."""
        return self._reader.arrived(limit)

    def close(self) -> None:
        """Leave the service; idempotent."""
        self._writer.close()
        self._reader.close()


class MemoryNode(Node):
    """A node.

    Attributes:
        domain: Its domain.
        full_name: Its namespace and name.
        middleware: What has created it.
    """

    def __init__(self, middleware: MemoryMiddleware, domain: int, full_name: str) -> None:
        self.domain = domain
        self.full_name = full_name
        self.middleware = middleware
        # In order of creation; a dictionary, because many endpoints are created and closed.
        self._endpoints: dict[MemoryWriter | MemoryReader, None] = {}
        middleware.bus.nodes.append(self)

    def create_writer(self, topic: str, type_name: str, qos: QoSProfile) -> MemoryWriter:
        """Create a publisher's writer."""
        writer = MemoryWriter(self, (self.domain, topic), type_name, qos)
        self._endpoints[writer] = None
        self.middleware.compare_types(writer, (self.domain, topic))
        return writer

    def create_reader(
        self, topic: str, type_name: str, qos: QoSProfile, on_ready: OnReady
    ) -> MemoryReader:
        """Create a subscription's reader."""
        key = (self.domain, topic)
        reader = MemoryReader(self, key, type_name, qos, on_ready)
        self._endpoints[reader] = None
        self.middleware.compare_types(reader, key)
        return reader

    def create_requester(self, service: Service, qos: QoSProfile, on_ready: OnReady) -> Requester:
        """Create a service client."""
        writer = self.create_writer(service.request_topic, service.request_type, qos)
        reader = self.create_reader(service.reply_topic, service.reply_type, qos, on_ready)
        return MemoryRequester(next(self.middleware.bus.client_ids), writer, reader)

    def create_replier(self, service: Service, qos: QoSProfile, on_ready: OnReady) -> Replier:
        """Create a service's server."""
        writer = self.create_writer(service.reply_topic, service.reply_type, qos)
        reader = self.create_reader(service.request_topic, service.request_type, qos, on_ready)
        return MemoryReplier(writer, reader)

    def close(self) -> None:
        """Leave the graph with all endpoints; idempotent."""
        for endpoint in list(self._endpoints):
            endpoint.close()
        if self in self.middleware.bus.nodes:
            self.middleware.bus.nodes.remove(self)
        self.middleware.nodes.pop(self, None)

    def left(self, endpoint: MemoryWriter | MemoryReader) -> None:
        """Forget an endpoint, which was closed."""
        self._endpoints.pop(endpoint, None)


class MemoryMiddleware(Middleware):
    """A middleware on a bus.

    Attributes:
        bus: The network.
        nodes: The nodes that it has created.

    Args:
        bus: The network; a new one by default.
    """

    name = "memory"

    def __init__(self, bus: Bus | None = None) -> None:
        super().__init__()
        self.bus = bus or Bus()
        self._ready: dict[MemoryReader, Callable[[], None]] = {}
        self._wakeup = WakeupFd()
        self.nodes: dict[MemoryNode, None] = {}

    def create_node(
        self, domain: int, namespace: str, name: str, localhost_only: bool = False
    ) -> MemoryNode:
        """Create a node; nothing ever leaves this process."""
        check_domain(domain)
        node = MemoryNode(self, domain, f"{namespace.rstrip('/')}/{name}")
        self.nodes[node] = None
        return node

    def mark(self, reader: MemoryReader) -> None:
        """Have a reader's ``on_ready`` called; called with the bus locked, from any thread."""
        self._ready[reader] = reader.on_ready
        self._wakeup.set()

    def unmark(self, reader: MemoryReader) -> None:
        """Undo :meth:`mark` for a reader that is closed; called with the bus locked."""
        self._ready.pop(reader, None)

    def compare_types(
        self, new_endpoint: MemoryWriter | MemoryReader, key: tuple[int, str]
    ) -> None:
        """Report the types, other than that of ``new_endpoint``, that its topic ``key`` has."""
        if self.on_type_conflict is not None:
            with self.bus.lock:
                endpoints = [*self.bus.writers.get(key, ()), *self.bus.readers.get(key, ())]
            for type_name in sorted(
                {endpoint.type_name for endpoint in endpoints} - {new_endpoint.type_name}
            ):
                self.on_type_conflict(key[1], new_endpoint.type_name, type_name)

    def fileno(self) -> int:
        """Return the descriptor that is readable when :meth:`dispatch` has work."""
        return self._wakeup.fileno()

    def dispatch(self) -> None:
        """Call ``on_ready`` of each reader that received something."""
        self._wakeup.clear()
        for reader in list(self._ready):
            with self.bus.lock:
                on_ready = self._ready.pop(reader, None)
                if on_ready is None:
                    continue  # closed meanwhile
                reader.announced = True
            try:
                on_ready()
            except BaseException:
                self._wakeup.set()  # for the others
                raise

    def dispatch_local(self) -> None:
        """Do the same, if a reader received something."""
        if self._ready:
            self.dispatch()

    def close(self) -> None:
        """Leave the bus with all nodes; idempotent."""
        for node in list(self.nodes):
            node.close()
        self._wakeup.close()


def create() -> MemoryMiddleware:
    """Return a middleware on a bus of its own."""
    return MemoryMiddleware()
