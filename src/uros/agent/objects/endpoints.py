"""The middleware's endpoints for the datawriters, datareaders and services of a client.

The session passes the samples of a datawriter to :meth:`WriterEndpoint.write`. The
other endpoints convert samples of the middleware to payloads of the client and back:
CDR, for a replier after the 24 bytes of a SampleIdentity, for a requester after
the 4 bytes of the request that is answered.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from copy import copy
from typing import Final

from ...middleware.base import (
    MAX_PAST,
    MiddlewareError,
    Node,
    Reader,
    Service,
    Writer,
)
from ...qos import HistoryPolicy, QoSProfile, services_profile
from ...wire.data import SAMPLE_IDENTITY_SIZE, pull_sample_identity, push_sample_identity
from ...wire.errors import DecodeError
from ..policy.memory_budget import MESSAGE_BYTES, MemoryBudget
from ..policy.reader_backlog import Backlog
from ..policy.rules import Limiter

# The most requests for whose replies a requester waits: a service may never reply. The oldest is
# forgotten.
MAX_PENDING: Final = 256
# The most samples that wait in a datareader: one with KEEP_ALL or a depth of 2^31 may never be
# read. With the C++ agent, Fast DDS keeps so many. The oldest are dropped, so that no writer waits
# for a slow client.
MAX_UNREAD: Final = 5000
# The most takes in a row that return only replies without a request: these may arrive as fast as
# they can be sent.
_MAX_MISSES: Final = 4


def _ignore(reason: str) -> None:
    """Do nothing with the reason."""


class WriterEndpoint:
    """A datawriter: passes the client's samples to the middleware and counts them.

    A sample passes, in this order: the gate, the limiter, the middleware's writer, the account
    of what a transient-local writer keeps for late readers, the recorder. Only a sample that the
    middleware has taken is counted and recorded.

    Args:
        writer: The middleware's end.
        qos: The QoS that it was created with.
        budget: The memory account of all clients.
        limiter: The limits that the rules set for the node; None: no limit.
        on_too_large: Called with the reason when the limiter drops a sample for its size.
    """

    __slots__ = ("_budget", "_direct", "_gate", "_limiter", "_on_too_large", "_past",
                 "_recorder", "_writer", "unread", "written")  # fmt: skip

    def __init__(
        self,
        writer: Writer,
        qos: QoSProfile,
        budget: MemoryBudget,
        limiter: Limiter | None = None,
        on_too_large: Callable[[str], None] = _ignore,
    ) -> None:
        self._writer = writer
        self._budget = budget
        self._limiter = limiter
        self._on_too_large = on_too_large
        self._recorder: Callable[[memoryview], None] | None = None
        self._gate: Callable[[int], bool] | None = None
        self._past: deque[int] | None = None  # sizes of the samples that are kept
        self.written = 0  # samples; the client may ask
        self.unread = 0  # bytes that are kept for late readers
        if qos.transient_local:
            depth = MAX_PAST if qos.history == HistoryPolicy.KEEP_ALL else max(1, qos.depth)
            self._past = deque(maxlen=depth)
        self._choose_path()

    def _choose_path(self) -> None:
        """Pass samples straight to the middleware if there is nothing to check or record."""
        plain = (
            self._limiter is None
            and self._recorder is None
            and self._gate is None
            and self._past is None
        )
        self._direct = self._writer.write if plain else None

    def set_recorder(self, recorder: Callable[[memoryview], None]) -> None:
        """Call ``recorder`` with each sample that the middleware has taken from now on."""
        self._recorder = recorder
        self._choose_path()

    def set_gate(self, gate: Callable[[int], bool]) -> None:
        """Hold samples back until ``gate`` returns True for the number of matched readers."""
        self._gate = gate
        self._choose_path()

    def write(self, cdr: memoryview) -> bool:
        """Write one sample.

        Returns:
            False if there is no room: the sample must be given again later.
        """
        direct = self._direct
        if direct is not None:
            done = direct(cdr)
            self.written += done
            return done
        if self._gate is not None:
            if not self._gate(self._writer.matched()):
                return False
            self._gate = None
            self._choose_path()
        if self._limiter is not None:
            return self._limiter.write(cdr, self._hand_over, self._on_too_large)
        return self._hand_over(cdr)

    def republish(self, cdr: bytes) -> None:
        """Write the last sample of before a restart, without gate and limiter.

        Called before :meth:`set_recorder`: the state file has the sample already.
        """
        self._hand_over(memoryview(cdr))

    def _hand_over(self, cdr: memoryview) -> bool:
        if not self._writer.write(cdr):
            return False
        self.written += 1
        if self._past is not None:
            self._account(len(cdr) + MESSAGE_BYTES, self._past)
        if self._recorder is not None:
            self._recorder(cdr)
        return True

    def _account(self, size: int, past: deque[int]) -> None:
        if len(past) == past.maxlen:
            self.unread -= past.popleft()
        else:
            self._budget.since += size
        past.append(size)
        self.unread += size

    def matched(self) -> int:
        """Return how many readers match the writer."""
        return self._writer.matched()

    def close(self) -> None:
        """Close the middleware's end."""
        self._writer.close()


class ReadingEndpoint:
    """An endpoint with samples that wait for the client."""

    __slots__ = ("backlog", "taken")

    backlog: Backlog
    taken: int  # samples; shown to the agent's owner

    @property
    def unread(self) -> int:
        """The octets that wait to be taken, as far as they are known."""
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
        budget: MemoryBudget,
        dropped: Callable[[str], None],
    ) -> None:
        if qos.history == HistoryPolicy.KEEP_ALL:
            qos = copy(qos)
            qos.history, qos.depth = HistoryPolicy.KEEP_LAST, MAX_UNREAD
        self.taken = 0
        self._reader: Reader = node.create_reader(topic, type_name, qos, on_ready)
        self.backlog = Backlog(self._reader, max(1, qos.depth), budget, dropped)

    def take(self, limit: int) -> list[tuple[int, bytes]]:
        """Return at most ``limit`` samples: (flags of DATA, payload)."""
        samples = [(sample[1] & 1, sample[4:]) for sample in self._reader.take(limit)]
        count = len(samples)
        self.taken += count
        self.backlog.empty = count < limit
        if self.backlog.octets:
            self.backlog.took(count, limit)
        return samples

    def close(self) -> None:
        """Close the middleware's end."""
        self._reader.close()


class RequesterEndpoint(ReadingEndpoint):
    """A requester: remembers which of the client's requests a reply belongs to.

    Args:
        node: The client's node.
        service: Its topics and types.
        object_id: The requester's, which each reply repeats.
        on_ready: Called when replies can be taken.
        on_refusal: Called with the ids of requests that nobody will answer, and the reason.
        budget: The memory account of all clients.
        dropped: Called with the reason when replies that wait are dropped.
    """

    __slots__ = ("_object_id", "_on_ready", "_on_refusal", "_pending", "_requester")

    def __init__(
        self,
        node: Node,
        service: Service,
        object_id: int,
        on_ready: Callable[[], None],
        on_refusal: Callable[[list[int], str], None],
        budget: MemoryBudget,
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
            self._on_refusal([int.from_bytes(request, "big") for request in pending.values()], why)

    def write(self, flags: int, payload: memoryview) -> bool:
        """Send one request.

        Args:
            flags: The flags of WRITE_DATA.
            payload: Request id, object id, body.

        Returns:
            False if there is no room: the request must be given again later.
        """
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
        """Return at most ``limit`` replies to requests that wait: (flags of DATA, payload)."""
        out: list[tuple[int, bytes]] = []
        for _ in range(_MAX_MISSES):
            wanted = limit - len(out)
            replies = self._requester.take(wanted)
            self.backlog.took(len(replies), wanted)
            for sequence, sample in replies:
                request_id = self._pending.pop(sequence, None)
                if request_id is not None:
                    out.append((sample[1] & 1, request_id + self._object_id + sample[4:]))
            if len(replies) < wanted or len(out) == limit:
                break
        else:
            self._requester.again()
        self.taken += len(out)
        return out

    def close(self) -> None:
        """Close the middleware's end."""
        self._requester.close()


class ReplierEndpoint(ReadingEndpoint):
    """A replier: the client gets the identity of each request, and returns it in the reply."""

    __slots__ = ("_replier",)

    def __init__(
        self, node: Node, service: Service, on_ready: Callable[[], None], budget: MemoryBudget,
        dropped: Callable[[str], None],
    ) -> None:  # fmt: skip
        self.taken = 0  # requests
        qos = services_profile()
        self._replier = node.create_replier(service, qos, on_ready)
        self.backlog = Backlog(self._replier, qos.depth, budget, dropped)

    def write(self, flags: int, payload: memoryview) -> bool:
        """Send one reply.

        Args:
            flags: The flags of WRITE_DATA.
            payload: Request id, object id, identity, body.

        Returns:
            False if there is no room: the reply must be given again later.

        Raises:
            DecodeError: The payload has no identity of a request.
        """
        if len(payload) < 4 + SAMPLE_IDENTITY_SIZE:
            raise DecodeError("a reply without the identity of its request")
        guid, sequence = pull_sample_identity(payload, 4, len(payload))
        if sequence & 1 << 63:
            raise DecodeError("a reply to a request with a negative number")
        body = payload[4 + SAMPLE_IDENTITY_SIZE :]
        return self._replier.reply(guid, sequence, bytes((0, flags & 1, 0, 0)) + body)

    def take(self, limit: int) -> list[tuple[int, bytes]]:
        """Return at most ``limit`` requests: (flags of DATA, payload)."""
        out = []
        for guid, sequence, sample in self._replier.take(limit):
            identity = bytearray(SAMPLE_IDENTITY_SIZE)
            push_sample_identity(identity, 0, guid, sequence)
            out.append((sample[1] & 1, bytes(identity) + sample[4:]))
        self.taken += len(out)
        self.backlog.took(len(out), limit)
        return out

    def close(self) -> None:
        """Close the middleware's end."""
        self._replier.close()
