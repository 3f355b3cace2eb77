"""The agent's default middleware: topics over dds, services over ros2.

Cyclone needs no types and no ROS installation for topics, and is the faster one. It cannot speak
services of rmw_fastrtps, so services go over rclpy if that can be imported. It is imported for the
first service, so that an agent whose boards have none does not pay for it. Without rclpy, and for
types that it does not have, services have dds's form, which rmw_cyclonedds understands, and
:attr:`~uros.middleware.base.Middleware.on_notice` says so. If RMW_IMPLEMENTATION is
rmw_cyclonedds_cpp, dds's form is used without a notice.

Importing rclpy takes long, and other boards must be served meanwhile. In an agent (which sets
``batching``), endpoints of a service whose type is not loaded yet are
:mod:`~uros.middleware.services.pending_endpoints`. A host program waits for the import, because it
has no other boards to serve.

In the ROS graph a board is one node. Its services belong to a second node, of rclpy, which has a
hidden name. The board's node lists the endpoints of the services as its own, and readers of the
graph find them by GUID, whichever participant they belong to. The hidden node is taken out of the
graph, see :mod:`.dds.suppressed_nodes`.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from functools import partial
from importlib.util import find_spec
from typing import TYPE_CHECKING, Any, Final

from ..qos import QoSProfile
from .base import (
    Middleware,
    MiddlewareError,
    Node,
    OnReady,
    Reader,
    Replier,
    Requester,
    Service,
    Writer,
)
from .dds.middleware import DdsMiddleware
from .services.pending_endpoints import (
    PendingEndpoint,
    PendingReplier,
    PendingRequester,
    ServiceEndpoint,
)

if TYPE_CHECKING:
    from .graph import LiveSource
    from .ros2.middleware import Ros2Middleware, Ros2Node
    from .ros2.type_loader import TypeLoader
    from .ros_names import TypeName

_CYCLONE: Final = "rmw_cyclonedds_cpp"


class AutoNode(Node):
    """A node on dds, and on ros2 as soon as it has a service there."""

    def __init__(
        self,
        middleware: AutoMiddleware,
        domain: int,
        namespace: str,
        name: str,
        localhost_only: bool,
    ) -> None:
        self._middleware = middleware
        self._ros_arguments = domain, namespace, "_" + name, localhost_only
        self._dds = middleware.dds.create_node(domain, namespace, name, localhost_only)
        self._ros: Ros2Node | None = None
        self._pending: dict[PendingEndpoint[Any], None] = {}

    def create_writer(self, topic: str, type_name: str, qos: QoSProfile) -> Writer:
        """Create a publisher's writer on dds."""
        return self._dds.create_writer(topic, type_name, qos)

    def create_reader(
        self, topic: str, type_name: str, qos: QoSProfile, on_ready: OnReady
    ) -> Reader:
        """Create a subscription's reader on dds."""
        return self._dds.create_reader(topic, type_name, qos, on_ready)

    def create_requester(self, service: Service, qos: QoSProfile, on_ready: OnReady) -> Requester:
        """Create a service client, which may be pending."""
        pending = PendingRequester(self, service, qos, on_ready)
        return self._create(pending) or pending

    def create_replier(self, service: Service, qos: QoSProfile, on_ready: OnReady) -> Replier:
        """Create a service's server, which may be pending."""
        pending = PendingReplier(self, service, qos, on_ready)
        return self._create(pending) or pending

    def _create(self, pending: PendingEndpoint[ServiceEndpoint]) -> ServiceEndpoint | None:
        """Create the endpoint itself; return None if its type must be loaded first."""
        try:
            is_held = self._middleware.hold(pending)
        except MiddlewareError as error:
            return self.create_pending(pending, error)
        if not is_held:
            return self.create_pending(pending)
        self._pending[pending] = None
        return None

    def create_pending(
        self, pending: PendingEndpoint[ServiceEndpoint], error: MiddlewareError | None = None
    ) -> ServiceEndpoint:
        """Create the endpoint on ros2, listed as this node's, or on dds if ros2 cannot have it.

        Args:
            pending: Stands for the endpoint.
            error: Why ros2 cannot have it, if that is known already.

        Raises:
            MiddlewareError: dds refuses it too.
        """
        self._pending.pop(pending, None)
        try:
            if error is not None:
                raise error
            ros = self._middleware.services()
            if ros is not None and self._ros is None:
                self._ros = ros.create_node(*self._ros_arguments)
            created = None if ros is None or self._ros is None else pending.create_on(self._ros)
        except MiddlewareError as refusal:
            self._middleware.notice(
                f"service {pending.service.request_topic} is there for rmw_cyclonedds only:"
                f" {refusal}"
            )
            created = None
        if created is None:
            return pending.create_on(self._dds)
        on_ros: Any = created  # Ros2Requester or Ros2Replier
        self._dds.adopt(on_ros.readers, on_ros.writers)
        on_ros.on_close = partial(self._dds.disown, on_ros.readers, on_ros.writers)
        return created

    def cancel_pending(self, pending: PendingEndpoint[Any]) -> None:
        """Forget a pending endpoint, which was closed."""
        if pending in self._pending:
            del self._pending[pending]
            self._middleware.drop(pending)

    def close(self) -> None:
        """Leave the graph with all endpoints; idempotent."""
        for pending in list(self._pending):
            pending.close()
        if self._ros is not None:
            self._ros.close()
            self._ros = None
        self._dds.close()


class AutoMiddleware(Middleware):
    """Topics over dds, services over ros2 if rclpy can be imported.

    Attributes:
        dds: What carries the topics.
    """

    name = "auto"

    def __init__(self) -> None:
        super().__init__()
        self.dds = DdsMiddleware()
        self._ros: Ros2Middleware | None = None
        self._ros_was_tried = False
        self._type_loader: TypeLoader | None = None
        # Pending endpoints by type, and the types whose loading has ended, with what failed.
        self._held: dict[TypeName, dict[PendingEndpoint[Any], None]] = {}
        self._loaded: dict[TypeName, MiddlewareError | None] = {}

    def create_node(
        self, domain: int, namespace: str, name: str, localhost_only: bool = False
    ) -> AutoNode:
        """Create a node on dds; see :class:`AutoNode`."""
        self._configure()
        return AutoNode(self, domain, namespace, name, localhost_only)

    def _configure(self) -> None:
        """Pass what was set before the first node on to dds."""
        self.dds.on_type_conflict = self.on_type_conflict
        self.dds.on_notice = self.on_notice
        self.dds.batching = self.batching

    def services(self) -> Ros2Middleware | None:
        """Return the middleware for services; None if it is dds.

        It is dds if rclpy cannot be used, or if rclpy would load a second Cyclone into this process
        without need, because dds has the same form of services.
        """
        if os.environ.get("RMW_IMPLEMENTATION") == _CYCLONE:
            return None
        if not self._ros_was_tried:
            self._ros_was_tried = True
            try:
                if self._type_loader is not None and self._type_loader.failure is not None:
                    raise self._type_loader.failure
                from .ros2.middleware import Ros2Middleware

                self._ros = Ros2Middleware(self.dds.wakeup)
            except (ImportError, MiddlewareError) as error:
                self.notice(_without_rclpy(error))
        return self._ros

    # --- pending endpoints -------------------------------------------------------

    def hold(self, pending: PendingEndpoint[Any]) -> bool:
        """Hold an endpoint until its type is loaded; :meth:`dispatch` creates it then.

        Returns:
            False if it can be created at once.

        Raises:
            MiddlewareError: ros2 cannot have it.
        """
        if (
            not self.batching
            or os.environ.get("RMW_IMPLEMENTATION") == _CYCLONE
            or (self._ros_was_tried and self._ros is None)
            or find_spec("rclpy") is None
        ):
            return False
        from .ros2 import types
        from .ros2.type_loader import TypeLoader
        from .services import names

        names.service_name(pending.service)
        name = names.service_type(pending.service)
        types.check_package(name)
        if self._type_loader is None:
            self._type_loader = TypeLoader(self.dds.wakeup)
        if self._type_loader.is_loaded(name):
            return False
        self._held.setdefault(name, {})[pending] = None
        if name not in self._loaded:
            self._type_loader.request(name)
        return True

    def drop(self, pending: PendingEndpoint[Any]) -> None:
        """Hold an endpoint no more, and cancel the loading of its type if it was the last."""
        for name, waiting in list(self._held.items()):
            if pending in waiting:
                del waiting[pending]
                if not waiting and self._type_loader is not None:
                    del self._held[name]
                    self._loaded.pop(name, None)
                    self._type_loader.cancel(name)

    def _resolve_one(self) -> None:
        """Create one pending endpoint: each takes a ms or more, and boards must be served."""
        if self._type_loader is None:
            return
        if self._type_loader.has_results():
            self._loaded.update(self._type_loader.take_results())
        while self._loaded:
            name, error = next(iter(self._loaded.items()))
            waiting = self._held.get(name)
            if waiting:
                pending = next(iter(waiting))
                del waiting[pending]
                try:
                    pending.resolve(error)
                except MiddlewareError as failure:
                    self.notice(f"service {pending.service.request_topic} is not there: {failure}")
                break
            self._held.pop(name, None)
            del self._loaded[name]

    def _has_work(self) -> bool:
        """Return whether ros2 or :meth:`_resolve_one` has work."""
        if self._type_loader is not None and (self._loaded or self._type_loader.has_results()):
            return True
        return self._ros is not None and self._ros.has_work()

    def fileno(self) -> int:
        """Return the descriptor that is readable when :meth:`dispatch` has work."""
        return self.dds.fileno()

    def dispatch(self) -> None:
        """Dispatch dds and ros2, and create one pending endpoint."""
        try:
            self.dds.dispatch()
        finally:
            # After dds, which clears the descriptor, whatever has set it.
            try:
                if self._ros is not None:
                    self._ros.dispatch()
            finally:
                self._resolve_one()
                if self._loaded:
                    self.dds.wakeup.set()

    def dispatch_local(self) -> None:
        """Dispatch what this process has written; ros2 has to wait for :meth:`dispatch`."""
        try:
            self.dds.dispatch_local()
        finally:
            if self._has_work():
                self.dds.wakeup.set()

    def flush(self) -> None:
        """Send the samples that dds holds back."""
        self.dds.flush()

    def graph(self, domain: int, on_change: Callable[[], None]) -> LiveSource | None:
        """Watch the graph of a domain by dds."""
        self._configure()
        return self.dds.graph(domain, on_change)

    def next_deadline(self) -> float | None:
        """Return when :meth:`tick` has work (``time.monotonic``), or None."""
        return self.dds.next_deadline()

    def tick(self) -> None:
        """Do what is due by time."""
        self.dds.tick()

    def close(self) -> None:
        """Leave the network; idempotent."""
        if self._type_loader is not None:
            self._type_loader.close()
        self._held.clear()
        if self._ros is not None:
            self._ros.close()
        self.dds.close()


def _without_rclpy(error: Exception) -> str:
    from . import NAMES

    return (
        "ROS 2 nodes with rmw_fastrtps see services of boards but get no answers, and calls of"
        " their services are refused (those with rmw_cyclonedds work), as rclpy cannot be used here"
        f" ({error}): start the agent with -m rtps, which needs nothing, or {NAMES['ros2'][1]}"
    )


def create() -> AutoMiddleware:
    """Return a middleware configured by this process's environment."""
    return AutoMiddleware()
