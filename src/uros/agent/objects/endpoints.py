"""What stands behind an XRCE object at the middleware.

A datawriter's samples the session hands over directly; it only counts them. The
others turn samples of the middleware into payloads of the client and back:
plain CDR, for a replier behind the 24 bytes of a SampleIdentity, for a
requester behind the 4 bytes of the request that is answered.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from copy import copy
from typing import Final

from ...middleware.base import (
    MAX_PAST,
    Bytes,
    MiddlewareError,
    Node,
    Reader,
    Service,
    Writer,
)
from ...qos import HistoryPolicy, QoSProfile, services_profile
from ...wire.data import SAMPLE_IDENTITY_SIZE, pull_sample_identity, push_sample_identity
from ...wire.errors import DecodeError
from ..policy.memory_budget import MESSAGE_BYTES, Budget
from ..policy.reader_backlog import Backlog

# Requests whose answers are still expected; a service that never answers must
# not make the agent grow.
MAX_PENDING: Final = 256
# Attack: a reader that keeps all, or two thousand million, and is never asked. Fast DDS keeps so
# many, with the C++ agent; the oldest go then, so that no writer waits for a client that is slow.
MAX_UNREAD: Final = 5000
# Attack: replies nobody asked for, as fast as they can be sent. Takes of them in a row.
_MAX_MISSES: Final = 4


class WriterEndpoint:
    """A datawriter.

    A transient-local one keeps its last samples for readers that come late: their octets are
    counted as well.
    """

    __slots__ = ("_budget", "_past", "_write", "_writer", "unread", "written")

    def __init__(self, writer: Writer, qos: QoSProfile, budget: Budget) -> None:
        self._writer = writer
        self._write = writer.write
        self.written = 0  # samples; the client may ask
        self.unread = 0  # octets that are kept for others
        if qos.transient_local:
            depth = MAX_PAST if qos.history == HistoryPolicy.KEEP_ALL else max(1, qos.depth)
            self._past: deque[int] = deque(maxlen=depth)
            self._budget = budget
            self._write = self._write_and_count

    def _write_and_count(self, cdr: Bytes) -> bool:
        if not self._writer.write(cdr):
            return False
        size, past = len(cdr) + MESSAGE_BYTES, self._past
        if len(past) == past.maxlen:
            self.unread -= past.popleft()
        else:
            self._budget.since += size
        past.append(size)
        self.unread += size
        return True

    def write(self, cdr: memoryview) -> bool:
        """Hand over one sample. False: no room now."""
        done = self._write(cdr)
        self.written += done
        return done

    def matched(self) -> int:
        """How many readers the samples reach."""
        return self._writer.matched()

    def close(self) -> None:
        self._writer.close()


class ReadingEndpoint:
    """What has samples that wait for the client."""

    __slots__ = ("backlog", "taken")

    backlog: Backlog
    taken: int  # samples, for the agent's owner

    @property
    def unread(self) -> int:
        """Octets that wait, as far as they are known."""
        return self.backlog.octets


class ReaderEndpoint(ReadingEndpoint):
    """A datareader."""

    __slots__ = ("_reader",)

    def __init__(
        self,
        node: Node,
        topic: str,
        type_name: str,
        qos: QoSProfile,
        on_ready: Callable[[], None],
        budget: Budget,
        dropped: Callable[[str], None],
    ) -> None:
        if qos.history == HistoryPolicy.KEEP_ALL:
            qos = copy(qos)
            qos.history, qos.depth = HistoryPolicy.KEEP_LAST, MAX_UNREAD
        self.taken = 0
        self._reader: Reader = node.create_reader(topic, type_name, qos, on_ready)
        self.backlog = Backlog(self._reader, max(1, qos.depth), budget, dropped)

    def take(self, limit: int) -> list[tuple[int, bytes]]:
        samples = [(sample[1] & 1, sample[4:]) for sample in self._reader.take(limit)]
        self.taken += len(samples)
        self.backlog.took(len(samples))
        return samples

    def close(self) -> None:
        self._reader.close()


class RequesterEndpoint(ReadingEndpoint):
    """A requester: remembers which of the client's requests a reply belongs to.

    ``on_refusal(request_ids, why)`` is called for requests that nobody will answer.
    """

    __slots__ = ("_object_id", "_on_ready", "_on_refusal", "_pending", "_requester")

    def __init__(
        self,
        node: Node,
        service: Service,
        object_id: int,
        on_ready: Callable[[], None],
        on_refusal: Callable[[list[int], str], None],
        budget: Budget,
        dropped: Callable[[str], None],
    ) -> None:
        self._object_id = object_id.to_bytes(2, "big")
        self._pending: dict[int, bytes] = {}
        self._on_ready = on_ready
        self._on_refusal = on_refusal
        self.taken = 0  # replies
        qos = services_profile()
        self._requester = node.create_requester(service, qos, self._ready)
        self.backlog = Backlog(self._requester, qos.depth, budget, dropped)

    def _ready(self) -> None:
        self._on_ready()
        if self._pending and (why := self._requester.refusal()):
            pending, self._pending = self._pending, {}
            self._on_refusal([int.from_bytes(it, "big") for it in pending.values()], why)

    def write(self, flags: int, payload: memoryview) -> bool:
        """``payload``: request id, object id, body. False: no room now."""
        request_id = bytes(payload[:2])
        try:
            sequence = self._requester.request(bytes((0, flags & 1, 0, 0)) + payload[4:])
        except MiddlewareError as error:
            self._on_refusal([int.from_bytes(request_id, "big")], str(error))
            return True
        if sequence is None:
            return False
        if len(self._pending) >= MAX_PENDING:
            del self._pending[next(iter(self._pending))]
        self._pending[sequence] = request_id
        return True

    def take(self, limit: int) -> list[tuple[int, bytes]]:
        out: list[tuple[int, bytes]] = []
        for _ in range(_MAX_MISSES):
            replies = self._requester.take(limit)
            self.backlog.took(len(replies))
            for sequence, sample in replies:
                request_id = self._pending.pop(sequence, None)
                if request_id is not None:
                    out.append((sample[1] & 1, request_id + self._object_id + sample[4:]))
            if out or not replies:
                break
        else:
            self._requester.again()
        self.taken += len(out)
        return out

    def close(self) -> None:
        self._requester.close()


class ReplierEndpoint(ReadingEndpoint):
    """A replier: the identity of the asker travels to the client and back."""

    __slots__ = ("_replier",)

    def __init__(
        self, node: Node, service: Service, on_ready: Callable[[], None], budget: Budget,
        dropped: Callable[[str], None],
    ) -> None:  # fmt: skip
        self.taken = 0  # requests
        qos = services_profile()
        self._replier = node.create_replier(service, qos, on_ready)
        self.backlog = Backlog(self._replier, qos.depth, budget, dropped)

    def write(self, flags: int, payload: memoryview) -> bool:
        """``payload``: request id, object id, identity, body. False: no room now."""
        if len(payload) < 4 + SAMPLE_IDENTITY_SIZE:
            raise DecodeError("a reply without the identity of its request")
        guid, sequence = pull_sample_identity(payload, 4, len(payload))
        if sequence & 1 << 63:
            raise DecodeError("a reply to a request with a negative number")
        body = payload[4 + SAMPLE_IDENTITY_SIZE :]
        return self._replier.reply(guid, sequence, bytes((0, flags & 1, 0, 0)) + body)

    def take(self, limit: int) -> list[tuple[int, bytes]]:
        out = []
        for guid, sequence, sample in self._replier.take(limit):
            identity = bytearray(SAMPLE_IDENTITY_SIZE)
            push_sample_identity(identity, 0, guid, sequence)
            out.append((sample[1] & 1, bytes(identity) + sample[4:]))
        self.taken += len(out)
        self.backlog.took(len(out))
        return out

    def close(self) -> None:
        self._replier.close()
