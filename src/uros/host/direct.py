"""Connection of a host's nodes: a middleware of their own, in place of a session with an agent.

A :class:`Direct` has the interface of a :class:`uros.client.connection.Connection` that is always
connected. It creates the endpoint of an entity when the entity is added, so the entity's
``create``, which asks an agent for the endpoint, is not called.
"""

from __future__ import annotations

import atexit
import os
import sys
import threading
import time
import traceback
import weakref
from collections.abc import Callable
from typing import Any, Final, Protocol

from .. import names
from ..client.clock import Clock
from ..client.connection import AGENT_CONNECTED, AGENT_DISCONNECTED
from ..client.entities import Client, Entity, Future, Publisher, Service, Subscription
from ..client.node import Node
from ..client.protocols import NodeConnection
from ..interfaces.codec import to_cdr
from ..middleware import base
from ..printable import printable
from ..qos import DurabilityPolicy, QoSProfile, services_profile
from .background import BackgroundTurns
from .interrupt import Interrupt

# Most samples taken before their callbacks run.
_BATCH: Final = 32
# Request ids of entities have two bytes; 0 means that nothing was sent.
_NUMBERS: Final = 0xFFFF
# Delay before a reply that the middleware could not take is sent again.
_RETRY_MS: Final = 5
# Octets of a GUID.
_GUID: Final = 16
# Most takes in a row that return only malformed samples, or replies to no request. The limit
# prevents this attack: a flood of such samples.
_MAX_MISSES: Final = 4


class SystemClock(Clock):
    """The host's own clock, which needs no synchronization with an agent."""

    def __init__(self) -> None:
        super().__init__()
        self.synchronized = True

    def _update(self) -> None:
        us = time.time_ns() // 1000
        seconds, self._us = divmod(us, 1_000_000)
        self.high, self.low = seconds >> 16, seconds & 0xFFFF


class _Endpoint(Protocol):
    """An entity's endpoint at the middleware."""

    def write(self, message: Any, prefix: bytes) -> int:
        """Send a message; return the number of a request, else 1, or 0 if it cannot be sent now."""

    def close(self) -> None: ...


class _Writer:
    """A publisher's endpoint."""

    def __init__(self, node: base.Node, entity: Publisher) -> None:
        self._writer = node.create_writer(
            names.topic_to_dds(entity.name), entity.type._DDS_TYPE, _profile(entity.qos)
        )
        self.close = self._writer.close

    def write(self, message: Any, prefix: bytes) -> int:
        return int(self._writer.write(to_cdr(message)))

    def matched(self) -> int:
        return self._writer.matched()


class _ReceivingEndpoint:
    """A receiving endpoint, which takes samples when its entity's queue is empty.

    Until then samples stay at the middleware, where QoS applies, and the endpoint stays in the set
    ``waiting``. :meth:`on_ready` may be called in any thread; samples are taken by the program's.
    """

    def __init__(self, entity: Any, waiting: set[_ReceivingEndpoint]) -> None:
        self._entity = entity
        self._most = max(1, min(entity.depth, _BATCH))
        self._waiting = waiting

    def on_ready(self) -> None:
        self._waiting.add(self)

    def fill(self) -> bool:
        """Take samples if the queue is empty; return whether there may be callbacks to run."""
        if self._entity._queue:
            return False
        for _ in range(_MAX_MISSES):
            samples = self.take(self._most)
            if not samples:
                self._waiting.discard(self)
                return False
            for prefix, sample in samples:
                self._deliver(prefix, sample)
            if self._entity._queue:
                break
        return True  # more samples may be ready; other endpoints are served before they are taken

    def _deliver(self, prefix: bytes, sample: bytes) -> None:
        if sample[0] or sample[1] > 1:  # no plain CDR
            self._entity.malformed += 1
        elif prefix:
            data = prefix + sample[4:]
            self._entity.on_data(data, 0, len(data), sample[1] == 1)
        else:
            self._entity.on_data(sample, 4, len(sample), sample[1] == 1)

    def take(self, limit: int) -> list[tuple[bytes, bytes]]:
        """Take samples, each with the prefix that its entity expects before the sample."""
        raise NotImplementedError


class _Reader(_ReceivingEndpoint):
    """A subscription's endpoint."""

    def __init__(
        self, node: base.Node, entity: Subscription, waiting: set[_ReceivingEndpoint]
    ) -> None:
        super().__init__(entity, waiting)
        topic, type_name = names.topic_to_dds(entity.name), entity.type._DDS_TYPE
        self._reader = node.create_reader(topic, type_name, _profile(entity.qos), self.on_ready)
        self.close = self._reader.close

    def write(self, message: Any, prefix: bytes) -> int:
        raise TypeError("a subscription sends nothing")

    def take(self, limit: int) -> list[tuple[bytes, bytes]]:
        return [(b"", sample) for sample in self._reader.take(limit)]


class _Replier(_ReceivingEndpoint):
    """A service's endpoint. A request's identity is the client's GUID and the sequence number."""

    def __init__(self, node: base.Node, entity: Service, waiting: set[_ReceivingEndpoint]) -> None:
        super().__init__(entity, waiting)
        self._replier = node.create_replier(_service(entity), services_profile(), self.on_ready)
        self.close = self._replier.close

    def write(self, message: Any, prefix: bytes) -> int:
        sequence = int.from_bytes(prefix[_GUID:], "little", signed=True)
        return int(self._replier.reply(prefix[:_GUID], sequence, to_cdr(message)))

    def take(self, limit: int) -> list[tuple[bytes, bytes]]:
        return [
            (guid + sequence.to_bytes(8, "little", signed=True), sample)
            for guid, sequence, sample in self._replier.take(limit)
        ]


class _FailedCall:
    """Entry in a client's queue that makes a future fail."""

    def __init__(self, future: Future, why: str) -> None:
        self._future = future
        self._why = why

    def finish(self, _result: Any, _error: Exception | None) -> None:
        self._future.finish(None, OSError(self._why))


class _Requester(_ReceivingEndpoint):
    """A client's endpoint. It maps each request id of the entity to a sequence number."""

    def __init__(self, node: base.Node, entity: Client, waiting: set[_ReceivingEndpoint]) -> None:
        super().__init__(entity, waiting)
        self._sequences: dict[int, int] = {}
        self._failed: dict[int, str] = {}  # reasons, by request id, which is negative
        self._requester = node.create_requester(_service(entity), services_profile(), self.on_ready)
        self.close = self._requester.close

    def write(self, message: Any, prefix: bytes) -> int:
        try:
            sequence = self._requester.request(to_cdr(message))
        except base.MiddlewareError as error:
            number = -1 - len(self._failed)
            self._failed[number] = str(error)
            self._waiting.add(self)
            return number
        if sequence is None:
            return 0
        number = sequence % _NUMBERS + 1
        self._sequences[number] = sequence
        return number

    def fill(self) -> bool:
        """Take replies, and fail the calls that will have no reply."""
        ready = super().fill()
        if self._sequences and (why := self._requester.refusal()):
            self._failed.update(dict.fromkeys(self._sequences, why))
            self._sequences.clear()
        for number, why in self._failed.items():
            future = self._entity._pending.pop(number, None)
            if future is not None:
                self._entity._queue.append((_FailedCall(future, why), None))
                ready = True
        self._failed.clear()
        return ready

    def take(self, limit: int) -> list[tuple[bytes, bytes]]:
        out: list[tuple[bytes, bytes]] = []
        for _ in range(_MAX_MISSES):
            replies = self._requester.take(limit)
            for sequence, sample in replies:
                number = sequence % _NUMBERS + 1
                if self._sequences.get(number) == sequence:
                    del self._sequences[number]
                    out.append((number.to_bytes(2, "big") + bytes(2), sample))
            if out or not replies:
                return out
        self._requester.again()
        return out


def _profile(qos: Any) -> QoSProfile:
    return QoSProfile(depth=qos) if isinstance(qos, int) else qos


def _service(entity: Service | Client) -> base.Service:
    request, response = entity.type.Request, entity.type.Response
    return base.Service(
        f"rq{entity.name}Request", request._DDS_TYPE, f"rr{entity.name}Reply", response._DDS_TYPE
    )


def _check_type(entity: Entity) -> None:
    """Raise TypeError if the entity's type is not a generated class of its kind."""
    kind = "message" if isinstance(entity, (Publisher, Subscription)) else "service"
    given = None
    if hasattr(entity.type, "Request"):
        given = "service"
    elif hasattr(entity.type, "_DDS_TYPE"):
        given = "message"
    if given != kind:
        example = "std_msgs/msg/String" if kind == "message" else "std_srvs/srv/Trigger"
        raise TypeError(
            f"{entity.name}: {entity.type!r} is not a {kind} type: give a class, such as"
            f' uros.interfaces.load("{example}")'
        )


def _print_notice(text: str) -> None:
    """Print a line about the network, which may hold text of others."""
    try:
        print(printable(f"uros: {text}"), file=sys.stderr)
    except (OSError, ValueError):
        pass  # nobody reads it, or it is closed


class Direct(NodeConnection):
    """One or more nodes' connection to the network of ``middleware``, which it owns.

    Use it from one thread. It is closed with its last node, or when the program ends.

    A program that creates a node and then sleeps is discovered and stays so: while nothing pumps, a
    thread of :class:`BackgroundTurns` takes turns: RTPS has no thread, and with Cyclone the nodes
    and endpoints of a participant are announced by turns (``ros_discovery_info``).

    A process that is forked has no connection: that of its parent goes on.
    """

    connections = 1

    has_agent = False

    def __init__(self, middleware: base.Middleware, domain: int = 0) -> None:
        self.middleware = middleware
        self.domain = domain
        self.clock: Clock = SystemClock()
        self.state = AGENT_CONNECTED
        self.on_state: Callable[[int], object] | None = None
        self.reason = ""
        self.interrupt = Interrupt()
        self._state_reported = False
        self._count = 0
        self._nodes: dict[Any, base.Node] = {}
        self._endpoints: dict[int, _Endpoint] = {}  # by the entity's number
        self._waiting: set[_ReceivingEndpoint] = set()  # endpoints that may have more samples
        # Held by whoever uses the middleware or `_waiting`, but not while the program waits.
        self._lock = threading.RLock()
        self._is_pumping = False
        self._stalled = False  # whether the middleware could not send a reply, which is retried
        self._conflicts: set[tuple[str, str, str]] = set()
        middleware.on_type_conflict = self._type_conflict
        middleware.on_notice = _print_notice
        atexit.register(self.close)
        self._background: BackgroundTurns | None = None
        if middleware.needs_turns:
            self._background = BackgroundTurns(
                self._take_turn,
                lambda error: _print_notice(f"the network failed, which is tried again: {error}"),
            )
        _open.add(self)

    # --- interface of nodes and entities -------------------------------------------------------

    def add(self, entity: Any) -> int:
        """Create a node, or the endpoint of an entity.

        Returns:
            Its number.

        Raises:
            MiddlewareError: The middleware cannot create it, or the connection is closed.
            TypeError: The entity's type is not a generated message or service class.
        """
        if self.state != AGENT_CONNECTED:
            raise base.MiddlewareError(f"{entity.name}: the node has been destroyed")
        number = self._count
        self._count += 1
        with self._lock:
            if isinstance(entity, Node):
                self._nodes[entity] = self.middleware.create_node(
                    entity.domain_id, entity.get_namespace(), entity.name
                )
            else:
                self._create_endpoint(number, entity)
            self.middleware.tick()  # announces it
        return number

    def _create_endpoint(self, number: int, entity: Any) -> None:
        _check_type(entity)
        node = self._nodes[entity.node]
        endpoint: _Endpoint
        if isinstance(entity, Publisher):
            endpoint = _Writer(node, entity)
        elif isinstance(entity, Subscription):
            endpoint = _Reader(node, entity, self._waiting)
        elif isinstance(entity, Service):
            endpoint = _Replier(node, entity, self._waiting)
        else:
            endpoint = _Requester(node, entity, self._waiting)
        self._endpoints[number] = endpoint
        entity.created = True

    def matched(self, publisher: Publisher) -> int:
        """Return the number of matched subscriptions."""
        endpoint = self._endpoints[publisher.number]
        assert isinstance(endpoint, _Writer)
        with self._lock:
            return endpoint.matched()

    def transient_local(self, depth: int) -> QoSProfile:
        """Return the profile of a publisher that keeps ``depth`` messages for late joiners."""
        return QoSProfile(depth, durability=DurabilityPolicy.TRANSIENT_LOCAL)

    def remove(self, entity: Any, object_ids: tuple[int, ...]) -> None:
        """Destroy the endpoint of an entity, or a node with all its endpoints."""
        with self._lock:
            if isinstance(entity, Node):
                node = self._nodes.pop(entity, None)
                if node is not None:
                    node.close()
                if not self._nodes:
                    self.close()
                return
            endpoint = self._endpoints.pop(entity.number, None)
            if endpoint is not None:
                self._waiting.discard(endpoint)
                endpoint.close()

    def write(self, object_id: int, message: Any, prefix: bytes, reliable: bool | int) -> int:
        """Send a message without waiting; return as `_Endpoint.write` does."""
        endpoint = self._endpoints.get(object_id >> 4)
        if endpoint is None:
            return 0
        self.interrupt.hold()
        try:
            with self._lock:
                self.middleware.dispatch()  # a program that only publishes may never pump
                number = endpoint.write(message, prefix)
                self.middleware.tick()
        finally:
            self.interrupt.release()
        if prefix and not number:
            self._stalled = True
        return number

    # --- the loop -------------------------------------------------------------------------------

    def pump(self, timeout_ms: int) -> None:
        """Take samples for the nodes, waiting ``timeout_ms`` at most; below 0 none are taken."""
        if timeout_ms < 0:
            return
        if self.state != AGENT_CONNECTED:
            raise base.MiddlewareError("the node has been destroyed")
        if not self._state_reported and self.on_state is not None:
            self._state_reported = True
            try:
                self.on_state(self.state)
            except Exception as error:
                traceback.print_exception(error)
            timeout_ms = 0
        if self._stalled:
            self._stalled = False
            timeout_ms = min(timeout_ms, _RETRY_MS)
        self.interrupt.hold()
        self._is_pumping = True
        try:
            self._work(timeout_ms / 1000)
        finally:
            self._is_pumping = False
            self.interrupt.release()

    def _work(self, seconds: float) -> None:
        middleware = self.middleware
        with self._lock:
            if self._fill():
                seconds = 0.0
            deadline = middleware.next_deadline()
        if deadline is not None:
            seconds = min(seconds, max(0.0, deadline - time.monotonic()))
        is_ready = self.interrupt.wait(middleware.fileno(), seconds)
        with self._lock:
            if is_ready:
                middleware.dispatch()
                self._fill()
            middleware.tick()

    def _fill(self) -> bool:
        """Take samples for all endpoints; return whether there may be callbacks to run."""
        ready = False
        for endpoint in list(self._waiting):
            ready |= endpoint.fill()
        return ready

    def _take_turn(self) -> None:
        """Receive and do what is due, unless the program does so; in another thread."""
        with self._lock:
            if self.state == AGENT_CONNECTED and not self._is_pumping:
                self.middleware.dispatch()
                self.middleware.tick()

    def leave_to_parent(self) -> None:
        """Forget the connection in a forked process, without leaving the network."""
        self._lock = threading.RLock()  # a thread of the parent may hold the other one
        self.state = AGENT_DISCONNECTED
        self.reason = "the process was forked: create nodes after the fork"
        atexit.unregister(self.close)

    def _type_conflict(self, topic: str, own_type: str, type_name: str) -> None:
        conflict = topic, own_type, type_name
        if conflict not in self._conflicts:
            self._conflicts.add(conflict)
            _print_notice(
                f"{topic[2:]} is {names.type_from_dds(own_type)} here, and"
                f" {names.type_from_dds(type_name)} elsewhere on the network: samples of one do"
                " not reach the other"
            )

    def close(self) -> None:
        """Leave the network with all nodes; idempotent."""
        with self._lock:
            if self.state != AGENT_CONNECTED:
                return
            self.state = AGENT_DISCONNECTED
            atexit.unregister(self.close)
            if self._background is not None:
                self._background.stop()
            self._endpoints.clear()
            self._waiting.clear()
            self._nodes.clear()
            self.middleware.close()


_open: weakref.WeakSet[Direct] = weakref.WeakSet()


def _leave_to_parent() -> None:
    for connection in list(_open):
        connection.leave_to_parent()


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_leave_to_parent)
