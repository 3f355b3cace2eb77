"""Publishers, subscriptions, service clients and servers of one node.

Samples of topics pass as they are, in either byte order. Requests and replies are converted to
objects of rclpy and back, because rclpy sends no others; bytes that it cannot read are refused
here.
"""

from __future__ import annotations

import itertools
import time
import warnings
from collections import deque
from collections.abc import Callable
from typing import Any, Final, Protocol

from ...qos import HistoryPolicy, QoSProfile
from ..base import (
    MAX_PAST,
    Bytes,
    MiddlewareError,
    OnReady,
    Reader,
    Replier,
    Requester,
    Service,
    Writer,
)
from ..ros_names import message_type, topic_name
from ..services.names import service_name, service_type
from . import profiles, rcl, types
from .domain import EntityListener, RosDomain

# The most identities of requests that are kept, because requests may never be answered.
MAX_UNANSWERED: Final = 1024
# The most takes in a row that may return nothing: all clients of a service get the replies to each
# of them, and its reader keeps so many.
_MAX_MISSES: Final = 10
# A write that took longer than this has waited for room in the history: half of the 100 ms for
# which Fast DDS waits, in seconds.
_BLOCKED: Final = 0.05


class OwningNode(Protocol):
    """What endpoints need of the node that they are created for.

    Attributes:
        domain: Its domain.
        endpoints: Its endpoints; they add and remove themselves.
        handle: rclpy's node.
    """

    domain: RosDomain
    endpoints: dict[Any, None]
    handle: Any


class Ros2Writer(Writer):
    """A publisher of rclpy's."""

    __slots__ = ("_entity", "_may_fill", "_node", "_what")

    def __init__(self, node: OwningNode, topic: str, type_name: str, qos: QoSProfile) -> None:
        name = topic_name(topic)
        kind = types.find_message(message_type(type_name))
        profile = profiles.to_rclpy(qos)
        self._what = f"topic {name}"
        self._node = node
        self._may_fill = qos.reliable and qos.history == HistoryPolicy.KEEP_ALL
        with rcl.refused(self._what), node.handle:
            self._entity: Any = rcl.load().Publisher(node.handle, kind, name, profile)
        node.endpoints[self] = None

    def write(self, cdr: Bytes) -> bool:
        """Publish a sample; return False if the history is full.

        Raises:
            MiddlewareError: rclpy refuses it.
        """
        if self._entity is None:
            return True
        started = time.monotonic()
        try:
            self._entity.publish_raw(bytes(cdr))
        except RuntimeError as error:
            # A full history raises the same error as any other fault, but only after DDS has
            # waited for room.
            if self._may_fill and time.monotonic() - started > _BLOCKED:
                return False
            raise MiddlewareError(f"{self._what}: {error}") from error
        return True

    def matched(self) -> int:
        """Return how many subscriptions match it."""
        return 0 if self._entity is None else int(self._entity.get_subscription_count())

    def close(self) -> None:
        """Leave the topic; idempotent."""
        if self._entity is not None:
            self._entity.destroy_when_not_in_use()
            self._entity = None
            self._node.endpoints.pop(self, None)


class _Taking:
    """An endpoint that is waited for.

    rclpy gives the size of a sample only by taking it. So samples whose sizes were asked for
    (:meth:`_sizes`) wait here, under the same depth, and are handed out first.
    """

    __slots__ = ("_listener", "_node", "_waiting", "entity")

    def __init__(
        self, node: OwningNode, entity: Any, kind: str, depth: int, on_ready: OnReady
    ) -> None:
        self.entity = entity
        self._waiting: deque[Any] = deque(maxlen=depth)
        self._node = node
        self._listener = EntityListener(entity, kind, on_ready)
        node.endpoints[self] = None
        node.domain.watch(self._listener)

    def _take(self, take: Callable[[], Any], limit: int, misses: int = 0) -> list[Any]:
        """Call ``take`` until it returned ``limit`` samples, or None more than ``misses`` times."""
        listener = self._listener
        listener.taken = True
        samples: list[Any] = []
        while self._waiting and len(samples) < limit:
            samples.append(self._waiting.popleft())
        while self.entity is not None and len(samples) < limit:
            try:
                sample = take()
            except (RuntimeError, ValueError):  # a sample that is no such message: it is dropped
                sample = None
            if sample is not None:
                samples.append(sample)
            elif misses:
                misses -= 1
            else:
                break
        if listener.paused and self.entity is not None:
            self._node.domain.resume(listener)
        return samples

    def _sizes(self, take: Callable[[], Any], size: Callable[[Any], int], limit: int) -> list[int]:
        """Move samples that ``take`` returns to those that wait; return their sizes."""
        waiting, self._waiting = self._waiting, deque()
        try:
            arrived = self._take(take, limit)
        finally:
            self._waiting = waiting
        waiting.extend(arrived)
        return [size(sample) for sample in arrived]

    def close(self) -> None:
        """Leave the network; idempotent."""
        self._waiting.clear()
        if self.entity is not None:
            self.entity = None
            self._node.domain.destroy(self._listener)
            self._node.endpoints.pop(self, None)


class Ros2Reader(_Taking, Reader):
    """A subscription of rclpy's."""

    __slots__ = ("_kind",)

    def __init__(
        self, node: OwningNode, topic: str, type_name: str, qos: QoSProfile, on_ready: OnReady
    ) -> None:
        name = topic_name(topic)
        self._kind = types.find_message(message_type(type_name))
        profile = profiles.to_rclpy(qos)
        with rcl.refused(f"topic {name}"), node.handle:
            entity = rcl.load().Subscription(node.handle, self._kind, name, profile)
        depth = MAX_PAST if qos.history == HistoryPolicy.KEEP_ALL else max(1, qos.depth)
        super().__init__(node, entity, "subscription", depth, on_ready)

    def _one(self) -> bytes | None:
        message = self.entity.take_message(self._kind, True)
        return None if message is None else bytes(message[0])

    def take(self, limit: int) -> list[bytes]:
        """Take samples, oldest first."""
        return self._take(self._one, limit)

    def arrived(self, limit: int) -> list[int]:
        """Return the octets of samples that have arrived and were not asked for before."""
        return self._sizes(self._one, len, limit)


class _ServiceEndpoint(_Taking):
    """A service client or server."""

    __slots__ = ("_name", "_type")

    def __init__(
        self, node: OwningNode, service: Service, qos: QoSProfile, kind: str, on_ready: OnReady
    ) -> None:
        self._name = service_name(service)
        self._type = types.find_service(service_type(service))
        profile = profiles.to_rclpy(qos)
        create = rcl.load().Client if kind == "client" else rcl.load().Service
        with rcl.refused(f"service {self._name}"), node.handle:
            entity = create(node.handle, self._type, self._name, profile)
        super().__init__(node, entity, kind, max(1, qos.depth), on_ready)


class Ros2Requester(_ServiceEndpoint, Requester):
    """A service client of rclpy's."""

    __slots__ = ()

    def __init__(self, node: OwningNode, service: Service, qos: QoSProfile, on_ready: OnReady):
        super().__init__(node, service, qos, "client", on_ready)

    def request(self, cdr: Bytes) -> int | None:
        """Send a request; return its sequence number.

        Raises:
            MiddlewareError: rclpy cannot read or send it.
        """
        about = f"a request of {self._name}"
        message = rcl.read(about, cdr, self._type.Request)
        if self.entity is None:
            return None
        with rcl.refused(about):
            sequence: int = self.entity.send_request(message)
        return sequence

    def _one(self) -> tuple[int, bytes] | None:
        header, message = self.entity.take_response(self._type.Response)
        if header is None:
            return None
        return header.request_id.sequence_number, rcl.as_bytes(message)

    def take(self, limit: int) -> list[tuple[int, bytes]]:
        """Take replies to own requests."""
        return self._take(self._one, limit, _MAX_MISSES)

    def arrived(self, limit: int) -> list[int]:
        """Return the octets of samples that have arrived and were not asked for before."""
        return self._sizes(self._one, lambda reply: len(reply[1]), limit)


class Ros2Replier(_ServiceEndpoint, Replier):
    """A server of rclpy's.

    rclpy gives the identity of a request as an object with nothing but the sequence number to read.
    So the GUID that :meth:`take` returns is one of our own, and stands for that object.
    """

    __slots__ = ("_numbers", "_unanswered")

    def __init__(self, node: OwningNode, service: Service, qos: QoSProfile, on_ready: OnReady):
        self._numbers = itertools.count(1)
        self._unanswered: dict[tuple[bytes, int], Any] = {}
        super().__init__(node, service, qos, "service", on_ready)

    def _one(self) -> tuple[bytes, int, bytes] | None:
        message, header = self.entity.service_take_request(self._type.Request)
        if header is None:
            return None
        request_id = header.request_id
        guid = b"uros-rcl" + next(self._numbers).to_bytes(8, "big")
        key = guid, request_id.sequence_number
        if len(self._unanswered) >= MAX_UNANSWERED:
            del self._unanswered[next(iter(self._unanswered))]
        self._unanswered[key] = request_id
        return (*key, rcl.as_bytes(message))

    def take(self, limit: int) -> list[tuple[bytes, int, bytes]]:
        """Take requests."""
        return self._take(self._one, limit)

    def arrived(self, limit: int) -> list[int]:
        """Return the octets of samples that have arrived and were not asked for before."""
        return self._sizes(self._one, lambda request: len(request[2]), limit)

    def reply(self, guid: bytes, sequence: int, cdr: Bytes) -> bool:
        """Send a reply, unless the request's identity is not kept any more.

        Raises:
            MiddlewareError: rclpy cannot read or send it.
        """
        about = f"a reply of {self._name}"
        message = rcl.read(about, cdr, self._type.Response)
        request_id = self._unanswered.pop((bytes(guid), sequence), None)
        if request_id is not None and self.entity is not None:
            with rcl.refused(about), warnings.catch_warnings(record=True) as warned:
                warnings.simplefilter("always", RuntimeWarning)
                self.entity.service_send_response(message, request_id)
            if warned:
                # Fast DDS has waited a tenth of a second for the client's reader to be discovered.
                # rclpy holds the GIL over that, so a thread would not help; but it is rare, as
                # clients announce the reader first: of 48 new ones none made its server wait.
                raise MiddlewareError(f"{about} is lost: {warned[0].message}")
        return True

    def close(self) -> None:
        """Leave the service; idempotent."""
        super().close()
        self._unanswered.clear()
