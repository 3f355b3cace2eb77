"""A network inside this process: for unit tests and for seeing how little is needed.

All :class:`MemoryMiddleware` objects of one :class:`Bus` share it. QoS is
honoured as far as it shows inside a process: keep-last depth, transient-local
history, and that a best-effort writer does not reach a reliable reader.
"""

from __future__ import annotations

import itertools
import threading
from collections import deque
from collections.abc import Callable
from itertools import islice
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
from .wakeup_fd import Wake

_End = TypeVar("_End")


class Bus:
    """Writers and readers by (domain, topic)."""

    def __init__(self) -> None:
        self.lock = threading.RLock()
        self.readers: dict[tuple[int, str], list[MemoryReader]] = {}
        self.writers: dict[tuple[int, str], list[MemoryWriter]] = {}
        self.nodes: list[MemoryNode] = []
        self.askers = itertools.count(1)


class MemoryWriter(Writer):
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
        sample = bytes(cdr)
        with self._bus.lock:
            for reader in self._bus.readers.get(self._key, ()):
                if reader.matches(self):
                    reader.put(sample)
            self.past.append(sample)
        return True

    def matched(self) -> int:
        with self._bus.lock:
            if self not in self._bus.writers.get(self._key, ()):
                return 0
            return sum(it.matches(self) for it in self._bus.readers.get(self._key, ()))

    def close(self) -> None:
        with self._bus.lock:
            _leave(self._bus.writers, self._key, self)
        self._node.left(self)


class MemoryReader(Reader):
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
        self.announced = False  # nobody took since
        self._node = node
        self._middleware = node.middleware
        self._key = key
        depth = None if qos.history == HistoryPolicy.KEEP_ALL else qos.depth
        self._samples: deque[bytes] = deque(maxlen=depth)
        self._untold = 0  # the last of them, whose sizes nobody has asked for
        bus = self._middleware.bus
        with bus.lock:
            bus.readers.setdefault(key, []).append(self)
            if qos.transient_local:
                for writer in bus.writers.get(key, ()):
                    if self.matches(writer):
                        for sample in writer.past:
                            self.put(sample)

    def matches(self, writer: MemoryWriter) -> bool:
        return (
            writer.type_name == self.type_name
            and (writer.qos.reliable or not self.qos.reliable)
            and (writer.qos.transient_local or not self.qos.transient_local)
        )

    def put(self, sample: bytes) -> None:
        self._samples.append(sample)
        self._untold += 1
        if not self.announced:
            self._middleware.mark(self)

    def take(self, limit: int) -> list[bytes]:
        with self._middleware.bus.lock:
            self.announced = False
            taken = [self._samples.popleft() for _ in range(min(limit, len(self._samples)))]
            self._untold = min(self._untold, len(self._samples))
            return taken

    def arrived(self, limit: int) -> list[int]:
        with self._middleware.bus.lock:
            self.announced = False
            there = len(self._samples)
            untold = min(self._untold, there)
            told = min(untold, limit)
            self._untold = untold - told
            first = there - untold
            return [len(it) for it in islice(self._samples, first, first + told)]

    def again(self) -> None:
        """Call ``on_ready`` once more."""
        with self._middleware.bus.lock:
            self._middleware.mark(self)

    def close(self) -> None:
        bus = self._middleware.bus
        with bus.lock:
            _leave(bus.readers, self._key, self)
            self._middleware.unmark(self)
            self._samples.clear()
        self._node.left(self)


def _leave(ends: dict[tuple[int, str], list[_End]], key: tuple[int, str], end: _End) -> None:
    """Take an end off its topic, and the topic away with its last one."""
    there = ends.get(key, [])
    if end in there:
        there.remove(end)
        if not there:
            del ends[key]


class MemoryRequester(Requester):
    """Requests travel as samples with 16 bytes of identity in front, replies likewise."""

    def __init__(self, guid: int, writer: Writer, reader: MemoryReader) -> None:
        self._guid = guid.to_bytes(8, "little")
        self._sequence = 0
        self._writer = writer
        self._reader = reader

    def request(self, cdr: Bytes) -> int | None:
        self._sequence += 1
        self._writer.write(self._guid + self._sequence.to_bytes(8, "little") + bytes(cdr))
        return self._sequence

    def again(self) -> None:
        self._reader.again()

    def take(self, limit: int) -> list[tuple[int, bytes]]:
        while True:
            replies = self._reader.take(limit)
            own = [
                (int.from_bytes(sample[8:16], "little"), sample[16:])
                for sample in replies
                if sample[:8] == self._guid and len(sample) >= 20
            ]
            if own or not replies:
                return own

    def arrived(self, limit: int) -> list[int]:
        return self._reader.arrived(limit)

    def close(self) -> None:
        self._writer.close()
        self._reader.close()


class MemoryReplier(Replier):
    def __init__(self, writer: Writer, reader: Reader) -> None:
        self._writer = writer
        self._reader = reader

    def take(self, limit: int) -> list[tuple[bytes, int, bytes]]:
        return [
            (sample[:8] + bytes(8), int.from_bytes(sample[8:16], "little"), sample[16:])
            for sample in self._reader.take(limit)
            if len(sample) >= 20
        ]

    def reply(self, guid: bytes, sequence: int, cdr: Bytes) -> bool:
        return self._writer.write(guid[:8] + sequence.to_bytes(8, "little") + bytes(cdr))

    def arrived(self, limit: int) -> list[int]:
        return self._reader.arrived(limit)

    def close(self) -> None:
        self._writer.close()
        self._reader.close()


class MemoryNode(Node):
    def __init__(self, middleware: MemoryMiddleware, domain: int, full_name: str) -> None:
        self.domain = domain
        self.full_name = full_name
        self.middleware = middleware
        # In order of creation; a dictionary, as many come and go.
        self._endpoints: dict[MemoryWriter | MemoryReader, None] = {}
        middleware.bus.nodes.append(self)

    def create_writer(self, topic: str, type_name: str, qos: QoSProfile) -> MemoryWriter:
        writer = MemoryWriter(self, (self.domain, topic), type_name, qos)
        self._endpoints[writer] = None
        self.middleware.compare_types(writer, (self.domain, topic))
        return writer

    def create_reader(
        self, topic: str, type_name: str, qos: QoSProfile, on_ready: OnReady
    ) -> MemoryReader:
        key = (self.domain, topic)
        reader = MemoryReader(self, key, type_name, qos, on_ready)
        self._endpoints[reader] = None
        self.middleware.compare_types(reader, key)
        return reader

    def create_requester(self, service: Service, qos: QoSProfile, on_ready: OnReady) -> Requester:
        writer = self.create_writer(service.request_topic, service.request_type, qos)
        reader = self.create_reader(service.reply_topic, service.reply_type, qos, on_ready)
        return MemoryRequester(next(self.middleware.bus.askers), writer, reader)

    def create_replier(self, service: Service, qos: QoSProfile, on_ready: OnReady) -> Replier:
        writer = self.create_writer(service.reply_topic, service.reply_type, qos)
        reader = self.create_reader(service.request_topic, service.request_type, qos, on_ready)
        return MemoryReplier(writer, reader)

    def close(self) -> None:
        for endpoint in list(self._endpoints):
            endpoint.close()
        if self in self.middleware.bus.nodes:
            self.middleware.bus.nodes.remove(self)
        self.middleware.nodes.pop(self, None)

    def left(self, endpoint: MemoryWriter | MemoryReader) -> None:
        """The endpoint is closed."""
        self._endpoints.pop(endpoint, None)


class MemoryMiddleware(Middleware):
    """See the module."""

    name = "memory"

    def __init__(self, bus: Bus | None = None) -> None:
        self.bus = bus or Bus()
        self._ready: dict[MemoryReader, Callable[[], None]] = {}
        self._wake = Wake()
        self.nodes: dict[MemoryNode, None] = {}

    def create_node(
        self, domain: int, namespace: str, name: str, localhost_only: bool = False
    ) -> MemoryNode:
        check_domain(domain)
        node = MemoryNode(self, domain, f"{namespace.rstrip('/')}/{name}")
        self.nodes[node] = None
        return node

    def mark(self, reader: MemoryReader) -> None:
        """Called with the bus locked."""
        self._ready[reader] = reader.on_ready
        self._wake.set()

    def unmark(self, reader: MemoryReader) -> None:
        """Likewise: the reader is closed."""
        self._ready.pop(reader, None)

    def compare_types(self, one: MemoryWriter | MemoryReader, key: tuple[int, str]) -> None:
        """Report the types, other than that of ``one``, that its topic has."""
        if self.on_type_conflict is not None:
            with self.bus.lock:
                there = [*self.bus.writers.get(key, ()), *self.bus.readers.get(key, ())]
            for other in sorted({it.type_name for it in there} - {one.type_name}):
                self.on_type_conflict(key[1], one.type_name, other)

    def fileno(self) -> int:
        return self._wake.fileno()

    def dispatch(self) -> None:
        self._wake.clear()
        for reader in list(self._ready):
            with self.bus.lock:
                on_ready = self._ready.pop(reader, None)
                if on_ready is None:
                    continue  # closed meanwhile
                reader.announced = True
            try:
                on_ready()
            except BaseException:
                self._wake.set()  # for the others
                raise

    def dispatch_local(self) -> None:
        if self._ready:
            self.dispatch()

    def close(self) -> None:
        for node in list(self.nodes):
            node.close()
        self._wake.close()


def create() -> MemoryMiddleware:
    """A middleware on a bus of its own."""
    return MemoryMiddleware()
