"""Publishers, subscriptions and services of one node.

Samples of topics pass as they are, in either byte order. Requests and replies become objects of
rclpy and bytes again, because rclpy sends no others; what they do not read as is refused here.
"""

from __future__ import annotations

import itertools
import time
import warnings
from collections import deque
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, Final

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
from . import names, profiles, rcl, types
from .domain import Watched

if TYPE_CHECKING:
    from .middleware import Ros2Node

# Attack: requests that nobody answers must not make the agent grow.
MAX_UNANSWERED: Final = 1024
# Takes that may bring nothing in a row: replies to other clients of a service, which come to all
# its clients, as many as a reader of services keeps.
_MAX_MISSES: Final = 10
# Half of the 100 ms for which Fast DDS waits for room.
_BLOCKED: Final = 0.05


class Ros2Writer(Writer):
    __slots__ = ("_entity", "_may_fill", "_node", "_what")

    def __init__(self, node: Ros2Node, topic: str, type_name: str, qos: QoSProfile) -> None:
        name = names.topic_name(topic)
        kind = types.find_message(names.message_type(type_name))
        profile = profiles.to_rclpy(qos)
        self._what = f"topic {name}"
        self._node = node
        self._may_fill = qos.reliable and qos.history == HistoryPolicy.KEEP_ALL
        with rcl.refused(self._what), node.handle:
            self._entity: Any = rcl.load().Publisher(node.handle, kind, name, profile)
        node.endpoints[self] = None

    def write(self, cdr: Bytes) -> bool:
        if self._entity is None:
            return True
        started = time.monotonic()
        try:
            self._entity.publish_raw(bytes(cdr))
        except RuntimeError as error:
            # A full history is told like any other fault, but after the time that DDS may wait.
            if self._may_fill and time.monotonic() - started > _BLOCKED:
                return False
            raise MiddlewareError(f"{self._what}: {error}") from error
        return True

    def matched(self) -> int:
        return 0 if self._entity is None else int(self._entity.get_subscription_count())

    def close(self) -> None:
        if self._entity is not None:
            self._entity.destroy_when_not_in_use()
            self._entity = None
            self._node.endpoints.pop(self, None)


class _Taking:
    """An endpoint that is waited for.

    rclpy tells nothing of a sample but by taking it. So what was looked at (:meth:`_look`) waits
    here, under the same depth, and goes out first.
    """

    __slots__ = ("_node", "_waiting", "_watched", "entity")

    def __init__(
        self, node: Ros2Node, entity: Any, kind: str, depth: int, on_ready: OnReady
    ) -> None:
        self.entity = entity
        self._waiting: deque[Any] = deque(maxlen=depth)
        self._node = node
        self._watched = Watched(entity, kind, on_ready)
        node.endpoints[self] = None
        node.domain.watch(self._watched)

    def _take(self, one: Callable[[], Any], limit: int, misses: int = 0) -> list[Any]:
        """What ``one`` gives until it has given ``limit``, or None more than ``misses`` times."""
        watched = self._watched
        watched.taken = True
        taken: list[Any] = []
        while self._waiting and len(taken) < limit:
            taken.append(self._waiting.popleft())
        while self.entity is not None and len(taken) < limit:
            try:
                got = one()
            except (RuntimeError, ValueError):  # a sample that is no such message: it is gone
                got = None
            if got is not None:
                taken.append(got)
            elif misses:
                misses -= 1
            else:
                break
        if watched.paused and self.entity is not None:
            self._node.domain.resume(watched)
        return taken

    def _look(
        self, one: Callable[[], Any], size: Callable[[Any], int], limit: int
    ) -> list[int]:
        """What ``one`` gives goes to those that wait; their sizes."""
        waiting, self._waiting = self._waiting, deque()
        try:
            came = self._take(one, limit)
        finally:
            self._waiting = waiting
        waiting.extend(came)
        return [size(it) for it in came]

    def close(self) -> None:
        self._waiting.clear()
        if self.entity is not None:
            self.entity = None
            self._node.domain.destroy(self._watched)
            self._node.endpoints.pop(self, None)


class Ros2Reader(_Taking, Reader):
    __slots__ = ("_kind",)

    def __init__(
        self, node: Ros2Node, topic: str, type_name: str, qos: QoSProfile, on_ready: OnReady
    ) -> None:
        name = names.topic_name(topic)
        self._kind = types.find_message(names.message_type(type_name))
        profile = profiles.to_rclpy(qos)
        with rcl.refused(f"topic {name}"), node.handle:
            entity = rcl.load().Subscription(node.handle, self._kind, name, profile)
        depth = MAX_PAST if qos.history == HistoryPolicy.KEEP_ALL else max(1, qos.depth)
        super().__init__(node, entity, "subscription", depth, on_ready)

    def _one(self) -> bytes | None:
        taken = self.entity.take_message(self._kind, True)
        return None if taken is None else bytes(taken[0])

    def take(self, limit: int) -> list[bytes]:
        return self._take(self._one, limit)

    def arrived(self, limit: int) -> list[int]:
        return self._look(self._one, len, limit)


class _ServiceEnd(_Taking):
    """An end of a service. ``readers`` and ``writers`` are its GUIDs, where the RMW is on DDS;
    ``on_close`` is called when it leaves.
    """

    __slots__ = ("_name", "_type", "on_close", "readers", "writers")

    def __init__(
        self, node: Ros2Node, service: Service, qos: QoSProfile, kind: str, on_ready: OnReady
    ) -> None:
        self._name = names.service_name(service)
        self._type = types.find_service(names.service_type(service))
        self.on_close: Callable[[], None] | None = None
        profile = profiles.to_rclpy(qos)
        make = rcl.load().Client if kind == "client" else rcl.load().Service
        topics = (service.reply_topic, False), (service.request_topic, True)
        if kind == "service":
            topics = (service.request_topic, False), (service.reply_topic, True)
        before = [node.guids(*topic) for topic in topics]
        with rcl.refused(f"service {self._name}"), node.handle:
            entity = make(node.handle, self._type, self._name, profile)
        self.readers, self.writers = (
            sorted(node.guids(*topic) - old) for topic, old in zip(topics, before, strict=True)
        )
        super().__init__(node, entity, kind, max(1, qos.depth), on_ready)

    def close(self) -> None:
        super().close()
        if self.on_close is not None:
            self.on_close()
            self.on_close = None


class Ros2Requester(_ServiceEnd, Requester):
    __slots__ = ()

    def __init__(self, node: Ros2Node, service: Service, qos: QoSProfile, on_ready: OnReady):
        super().__init__(node, service, qos, "client", on_ready)

    def request(self, cdr: Bytes) -> int | None:
        what = f"a request of {self._name}"
        message = rcl.read(what, cdr, self._type.Request)
        if self.entity is None:
            return None
        with rcl.refused(what):
            sequence: int = self.entity.send_request(message)
        return sequence

    def _one(self) -> tuple[int, bytes] | None:
        header, message = self.entity.take_response(self._type.Response)
        if header is None:
            return None
        return header.request_id.sequence_number, rcl.as_bytes(message)

    def take(self, limit: int) -> list[tuple[int, bytes]]:
        return self._take(self._one, limit, _MAX_MISSES)

    def arrived(self, limit: int) -> list[int]:
        return self._look(self._one, lambda it: len(it[1]), limit)


class Ros2Replier(_ServiceEnd, Replier):
    """rclpy hands out the identity of a request as an object that tells nothing but its number, so
    the GUID given here is one of our own, and stands for that object.
    """

    __slots__ = ("_numbers", "_unanswered")

    def __init__(self, node: Ros2Node, service: Service, qos: QoSProfile, on_ready: OnReady):
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
        return self._take(self._one, limit)

    def arrived(self, limit: int) -> list[int]:
        return self._look(self._one, lambda it: len(it[2]), limit)

    def reply(self, guid: bytes, sequence: int, cdr: Bytes) -> bool:
        what = f"a reply of {self._name}"
        message = rcl.read(what, cdr, self._type.Response)
        request_id = self._unanswered.pop((bytes(guid), sequence), None)
        if request_id is not None and self.entity is not None:
            with rcl.refused(what), warnings.catch_warnings(record=True) as told:
                warnings.simplefilter("always", RuntimeWarning)
                self.entity.service_send_response(message, request_id)
            if told:
                # Fast DDS has waited a tenth of a second for the asker's reader to be discovered.
                # rclpy holds the GIL over that, so a thread would be no help; but it is rare, as
                # clients announce the reader first: of 48 new ones none had its server wait.
                raise MiddlewareError(f"{what} is lost: {told[0].message}")
        return True

    def close(self) -> None:
        super().close()
        self._unanswered.clear()
