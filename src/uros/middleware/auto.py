"""The middleware that boards meet by default: topics over dds, services over ros2.

Cyclone needs no type and no installation for topics, and is the faster one. Services of
rmw_fastrtps it cannot speak, so they go over rclpy, where that can be imported: at the first
service, as an agent whose boards have none should not pay for it. Without rclpy, and for types that
it does not have, services have dds's form, which rmw_cyclonedds understands, and
:attr:`~uros.middleware.base.Middleware.on_notice` tells so. Where RMW_IMPLEMENTATION says
rmw_cyclonedds, that is just the form which is wanted.

In the ROS graph a board is one node. The rclpy node behind its services has a hidden name, and the
board's node lists their endpoints as its own: who looks up a node's services finds them by GUID,
whichever participant they are of.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING, Final, TypeVar

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

if TYPE_CHECKING:
    from .graph import LiveSource
    from .ros2.endpoints import Ros2Replier, Ros2Requester
    from .ros2.middleware import Ros2Middleware, Ros2Node

_End = TypeVar("_End", "Ros2Requester", "Ros2Replier")

# Attack: a board that makes one service after the other, each of another type.
_MAX_NOTICES: Final = 1000
_CYCLONE: Final = "rmw_cyclonedds_cpp"


class AutoNode(Node):
    """A node on dds, and on ros2 as soon as it has a service there."""

    def __init__(
        self, middleware: AutoMiddleware, domain: int, namespace: str, name: str, here: bool
    ) -> None:
        self._middleware = middleware
        self._place = domain, namespace, "_" + name, here
        self._dds = middleware.dds.create_node(domain, namespace, name, here)
        self._ros: Ros2Node | None = None

    def create_writer(self, topic: str, type_name: str, qos: QoSProfile) -> Writer:
        return self._dds.create_writer(topic, type_name, qos)

    def create_reader(
        self, topic: str, type_name: str, qos: QoSProfile, on_ready: OnReady
    ) -> Reader:
        return self._dds.create_reader(topic, type_name, qos, on_ready)

    def create_requester(self, service: Service, qos: QoSProfile, on_ready: OnReady) -> Requester:
        made = self._service(lambda node: node.create_requester(service, qos, on_ready), service)
        return made or self._dds.create_requester(service, qos, on_ready)

    def create_replier(self, service: Service, qos: QoSProfile, on_ready: OnReady) -> Replier:
        made = self._service(lambda node: node.create_replier(service, qos, on_ready), service)
        return made or self._dds.create_replier(service, qos, on_ready)

    def _service(self, make: Callable[[Ros2Node], _End], service: Service) -> _End | None:
        """An end of a service on ros2, listed as this node's; None where it cannot be there."""
        ros = self._middleware.services()
        if ros is None:
            return None
        try:
            if self._ros is None:
                self._ros = ros.create_node(*self._place)
            end = make(self._ros)
        except MiddlewareError as error:
            self._middleware.notice(
                f"service {service.request_topic} is there for rmw_cyclonedds only: {error}"
            )
            return None
        self._dds.adopt(end.readers, end.writers)
        end.on_close = partial(self._dds.disown, end.readers, end.writers)
        return end

    def close(self) -> None:
        if self._ros is not None:
            self._ros.close()
            self._ros = None
        self._dds.close()


class AutoMiddleware(Middleware):
    """See the module."""

    name = "auto"

    def __init__(self) -> None:
        self.dds = DdsMiddleware()
        self._ros: Ros2Middleware | None = None
        self._tried = False
        self._noticed: set[str] = set()

    def create_node(
        self, domain: int, namespace: str, name: str, localhost_only: bool = False
    ) -> AutoNode:
        self._configure()
        return AutoNode(self, domain, namespace, name, localhost_only)

    def _configure(self) -> None:
        """What this was told before the first node is for dds too."""
        self.dds.on_type_conflict = self.on_type_conflict
        self.dds.on_notice = self.on_notice
        self.dds.batching = self.batching

    def services(self) -> Ros2Middleware | None:
        """What carries services, or None where that is dds: rclpy is not to be had, or would
        bring a second Cyclone into this process to speak what dds speaks already."""
        if os.environ.get("RMW_IMPLEMENTATION") == _CYCLONE:
            return None
        if not self._tried:
            self._tried = True
            try:
                from .ros2.middleware import Ros2Middleware

                self._ros = Ros2Middleware(self.dds.wake)
            except (ImportError, MiddlewareError) as error:
                self.notice(_without_rclpy(error))
        return self._ros

    def notice(self, text: str) -> None:
        """Tell this once."""
        if self.on_notice is not None and text not in self._noticed:
            if len(self._noticed) < _MAX_NOTICES:
                self._noticed.add(text)
                self.on_notice(text)

    def fileno(self) -> int:
        return self.dds.fileno()

    def dispatch(self) -> None:
        try:
            self.dds.dispatch()
        finally:
            # After it: it makes the descriptor unreadable, whoever has made it readable.
            if self._ros is not None:
                self._ros.dispatch()

    def dispatch_local(self) -> None:
        try:
            self.dds.dispatch_local()
        finally:
            if self._ros is not None and self._ros.has_news():
                self.dds.wake.set()

    def flush(self) -> None:
        self.dds.flush()

    def graph(self, domain: int, on_change: Callable[[], None]) -> LiveSource | None:
        self._configure()
        return self.dds.graph(domain, on_change)

    def next_deadline(self) -> float | None:
        return self.dds.next_deadline()

    def tick(self) -> None:
        self.dds.tick()

    def close(self) -> None:
        if self._ros is not None:
            self._ros.close()
        self.dds.close()


def _without_rclpy(error: Exception) -> str:
    from . import NAMES

    return (
        "services are there for rmw_cyclonedds only, as rclpy cannot be used"
        f" ({error}): {NAMES['ros2'][1]}"
    )


def create() -> AutoMiddleware:
    """A middleware configured by this process's environment."""
    return AutoMiddleware()
