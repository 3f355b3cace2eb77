"""The middleware that boards meet by default: topics over dds, services over ros2.

Cyclone needs no type and no installation for topics, and is the faster one. Services of
rmw_fastrtps it cannot speak, so they go over rclpy, where that can be imported: at the first
service, as an agent whose boards have none should not pay for it. Without rclpy, and for types that
it does not have, services have dds's form, which rmw_cyclonedds understands, and
:attr:`~uros.middleware.base.Middleware.on_notice` tells so. Where RMW_IMPLEMENTATION says
rmw_cyclonedds, that is just the form which is wanted.

Importing rclpy takes long, and other boards are to be served meanwhile. Where a data plane runs
this (it sets ``batching``), the ends of a service whose type is not imported yet are
:mod:`~uros.middleware.pending_endpoints` ones. A host program waits for the import: it has nobody
else to serve.

In the ROS graph a board is one node. The rclpy node behind its services has a hidden name, and the
board's node lists their endpoints as its own: who looks up a node's services finds them by GUID,
whichever participant they are of. The hidden node is taken out of the graph: :mod:`.dds.hidden`.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from functools import partial
from importlib.util import find_spec
from typing import TYPE_CHECKING, Any, Final, TypeVar

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
from .pending_endpoints import Late, LateReplier, LateRequester

if TYPE_CHECKING:
    from .graph import LiveSource
    from .ros2.middleware import Ros2Middleware, Ros2Node
    from .ros2.names import TypeName
    from .ros2.type_loader import Preparation

_End = TypeVar("_End", Requester, Replier)

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
        self._late: dict[Late[Any], None] = {}

    def create_writer(self, topic: str, type_name: str, qos: QoSProfile) -> Writer:
        return self._dds.create_writer(topic, type_name, qos)

    def create_reader(
        self, topic: str, type_name: str, qos: QoSProfile, on_ready: OnReady
    ) -> Reader:
        return self._dds.create_reader(topic, type_name, qos, on_ready)

    def create_requester(self, service: Service, qos: QoSProfile, on_ready: OnReady) -> Requester:
        late = LateRequester(self, service, qos, on_ready)
        return self._create(late) or late

    def create_replier(self, service: Service, qos: QoSProfile, on_ready: OnReady) -> Replier:
        late = LateReplier(self, service, qos, on_ready)
        return self._create(late) or late

    def _create(self, late: Late[_End]) -> _End | None:
        """The end itself; None where it must wait."""
        try:
            waits = self._middleware.hold(late)
        except MiddlewareError as error:
            return self.end_of(late, error)
        if not waits:
            return self.end_of(late)
        self._late[late] = None
        return None

    def end_of(self, late: Late[_End], error: MiddlewareError | None = None) -> _End:
        """The end itself, listed as this node's: on ros2, or on dds where it cannot be there;
        ``error`` says that it cannot.
        """
        self._late.pop(late, None)
        try:
            if error is not None:
                raise error
            ros = self._middleware.services()
            if ros is not None and self._ros is None:
                self._ros = ros.create_node(*self._place)
            end = None if ros is None or self._ros is None else late.made_by(self._ros)
        except MiddlewareError as refusal:
            self._middleware.notice(
                f"service {late.service.request_topic} is there for rmw_cyclonedds only: {refusal}"
            )
            end = None
        if end is None:
            return late.made_by(self._dds)
        ours: Any = end  # Ros2Requester or Ros2Replier
        self._dds.adopt(ours.readers, ours.writers)
        ours.on_close = partial(self._dds.disown, ours.readers, ours.writers)
        return end

    def dropped(self, late: Late[Any]) -> None:
        """One that waited has been closed."""
        if late in self._late:
            del self._late[late]
            self._middleware.drop(late)

    def close(self) -> None:
        for late in list(self._late):
            late.close()
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
        self._preparation: Preparation | None = None
        # Ends that wait, and what is told to those of a type whose waiting is over.
        self._held: dict[TypeName, dict[Late[Any], None]] = {}
        self._over: dict[TypeName, MiddlewareError | None] = {}

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
        bring a second Cyclone into this process to speak what dds speaks already.
        """
        if os.environ.get("RMW_IMPLEMENTATION") == _CYCLONE:
            return None
        if not self._tried:
            self._tried = True
            try:
                if self._preparation is not None and self._preparation.failure is not None:
                    raise self._preparation.failure
                from .ros2.middleware import Ros2Middleware

                self._ros = Ros2Middleware(self.dds.wake)
            except (ImportError, MiddlewareError) as error:
                self.notice(_without_rclpy(error))
        return self._ros

    # --- ends of services that wait for their type -------------------------------

    def hold(self, late: Late[Any]) -> bool:
        """Whether this end must wait; then :meth:`dispatch` makes it when its time has come.
        Raises MiddlewareError where waiting is in vain.
        """
        if (
            not self.batching
            or os.environ.get("RMW_IMPLEMENTATION") == _CYCLONE
            or (self._tried and self._ros is None)
            or find_spec("rclpy") is None
        ):
            return False
        from .ros2 import names, types
        from .ros2.type_loader import Preparation

        names.service_name(late.service)
        name = names.service_type(late.service)
        types.check_package(name)
        if self._preparation is None:
            self._preparation = Preparation(self.dds.wake)
        if self._preparation.has(name):
            return False
        self._held.setdefault(name, {})[late] = None
        if name not in self._over:
            self._preparation.want(name)
        return True

    def drop(self, late: Late[Any]) -> None:
        """It waits no more."""
        for name, held in list(self._held.items()):
            if late in held:
                del held[late]
                if not held and self._preparation is not None:
                    del self._held[name]
                    self._over.pop(name, None)
                    self._preparation.forget(name)

    def _make_one(self) -> None:
        """Make one end that waited: each takes a ms or more, and others have their turn between."""
        if self._preparation is None:
            return
        if self._preparation.has_news():
            self._over.update(self._preparation.news())
        while self._over:
            name, error = next(iter(self._over.items()))
            held = self._held.get(name)
            if held:
                late = next(iter(held))
                del held[late]
                try:
                    late.arrive(error)
                except MiddlewareError as failure:
                    self.notice(f"service {late.service.request_topic} is not there: {failure}")
                break
            self._held.pop(name, None)
            del self._over[name]

    def _has_news(self) -> bool:
        """Whether ros2 or :meth:`_make_one` has work."""
        if self._preparation is not None and (self._over or self._preparation.has_news()):
            return True
        return self._ros is not None and self._ros.has_news()

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
            try:
                if self._ros is not None:
                    self._ros.dispatch()
            finally:
                self._make_one()
                if self._over:
                    self.dds.wake.set()

    def dispatch_local(self) -> None:
        try:
            self.dds.dispatch_local()
        finally:
            if self._has_news():
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
        if self._preparation is not None:
            self._preparation.close()
        self._held.clear()
        if self._ros is not None:
            self._ros.close()
        self.dds.close()


def _without_rclpy(error: Exception) -> str:
    from . import NAMES

    return (
        "ROS 2 nodes with rmw_fastrtps see services of boards but get no answers, and calls of"
        " their services are refused (those with rmw_cyclonedds work), as rclpy cannot be used here"
        f" ({error}): {NAMES['ros2'][1]}"
    )


def create() -> AutoMiddleware:
    """A middleware configured by this process's environment."""
    return AutoMiddleware()
