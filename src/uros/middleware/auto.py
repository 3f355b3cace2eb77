"""The default middleware: topics over dds, services over rtps; without Cyclone all over rtps.

Cyclone is the faster one for topics. It cannot write the inline QoS in which rmw_fastrtps expects
the identity of a request, so services use :mod:`.rtps`, which serves the RMWs of all peers. That is
opened for the first service, so that an agent whose boards have none does not pay for it.

In the ROS graph a board is one node: the entry of the dds node in ``ros_discovery_info`` lists the
service endpoints too. Readers of the graph find endpoints by GUID, whichever participant they
belong to, and the participant of rtps announces no nodes.

Where this Python has no Cyclone, :func:`create` returns the rtps middleware itself.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

from .. import poller
from ..qos import QoSProfile
from .base import (
    Middleware,
    Node,
    OnReady,
    Replier,
    Requester,
    Service,
    Writer,
)
from .cyclone_package import why_missing

if TYPE_CHECKING:
    from .dds.endpoints import DdsReader
    from .dds.middleware import DdsMiddleware
    from .graph import LiveSource
    from .rtps.middleware import RtpsMiddleware
    from .rtps.node import RtpsNode


class AutoNode(Node):
    """A node on dds, whose services are on rtps.

    Attributes:
        dds: The node on dds.
    """

    def __init__(
        self,
        middleware: AutoMiddleware,
        domain: int,
        namespace: str,
        name: str,
        localhost_only: bool,
    ) -> None:
        self._middleware = middleware
        self._domain = domain
        self._localhost_only = localhost_only
        self.dds = middleware.dds.create_node(domain, namespace, name, localhost_only)
        self._rtps: RtpsNode | None = None

    def create_writer(self, topic: str, type_name: str, qos: QoSProfile) -> Writer:
        """Create a publisher's writer on dds."""
        return self.dds.create_writer(topic, type_name, qos)

    def create_reader(
        self, topic: str, type_name: str, qos: QoSProfile, on_ready: OnReady
    ) -> DdsReader:
        """Create a subscription's reader on dds."""
        return self.dds.create_reader(topic, type_name, qos, on_ready)

    def create_requester(self, service: Service, qos: QoSProfile, on_ready: OnReady) -> Requester:
        """Create a service client on rtps."""
        return self._service_node().create_requester(service, qos, on_ready)

    def create_replier(self, service: Service, qos: QoSProfile, on_ready: OnReady) -> Replier:
        """Create a service's server on rtps."""
        return self._service_node().create_replier(service, qos, on_ready)

    def _service_node(self) -> RtpsNode:
        """Return the node that has the services."""
        if self._rtps is None:
            self._rtps = self._middleware.services().create_service_node(
                self._domain, self.dds.entry, self._localhost_only
            )
        return self._rtps

    def close(self) -> None:
        """Leave the graph with all endpoints; idempotent."""
        if self._rtps is not None:
            self._rtps.close()
        self.dds.close()


class AutoMiddleware(Middleware):
    """Topics over dds, services over rtps.

    Attributes:
        dds: What carries the topics.

    Args:
        dds: The same; it is closed with this middleware.
    """

    name = "auto"
    needs_turns = True

    def __init__(self, dds: DdsMiddleware) -> None:
        super().__init__()
        self.dds = dds
        self.engines = [dds]
        self._rtps: RtpsMiddleware | None = None
        # Both have a descriptor of their own; the poller makes one of them.
        self._poller = poller.create()
        self._poller.watch(self.dds.fileno(), self.dds.dispatch)

    def create_node(
        self, domain: int, namespace: str, name: str, localhost_only: bool = False
    ) -> AutoNode:
        """Create a node on dds; see :class:`AutoNode`."""
        self._configure(self.dds)
        return AutoNode(self, domain, namespace, name, localhost_only)

    def _configure(self, middleware: Middleware) -> None:
        """Pass on what was set before the first node."""
        middleware.on_type_conflict = self.on_type_conflict
        middleware.on_notice = self.on_notice
        middleware.batching = self.batching

    def services(self) -> RtpsMiddleware:
        """Return the middleware for services, which the first call opens."""
        if self._rtps is None:
            from .rtps.middleware import RtpsMiddleware

            self._rtps = RtpsMiddleware(announces_nodes=False)
            self._configure(self._rtps)
            self.engines.append(self._rtps)
            self._poller.watch(self._rtps.fileno(), self._rtps.dispatch)
        return self._rtps

    def fileno(self) -> int:
        """Return the descriptor that is readable when :meth:`dispatch` has work."""
        return self._poller.fileno()

    def dispatch(self) -> None:
        """Dispatch dds and rtps."""
        try:
            self.dds.dispatch()
        finally:
            if self._rtps is not None:
                self._rtps.dispatch()
            self._poller.rearm()

    def dispatch_local(self) -> None:
        """Dispatch what this process has written."""
        try:
            self.dds.dispatch_local()
        finally:
            if self._rtps is not None:
                self._rtps.dispatch_local()

    def flush(self) -> None:
        """Send the samples that are held back."""
        self.dds.flush()
        if self._rtps is not None:
            self._rtps.flush()

    def graph(
        self, domain: int, on_change: Callable[[], None], paced: bool = True
    ) -> LiveSource | None:
        """Watch the graph of a domain by dds."""
        self._configure(self.dds)
        return self.dds.graph(domain, on_change, paced)

    def next_deadline(self) -> float | None:
        """Return when :meth:`tick` has work (``time.monotonic``), or None."""
        deadlines = [self.dds.next_deadline()]
        if self._rtps is not None:
            deadlines.append(self._rtps.next_deadline())
        return min((at for at in deadlines if at is not None), default=None)

    def tick(self) -> None:
        """Do what is due by time."""
        self.dds.tick()
        if self._rtps is not None:
            self._rtps.tick()

    def close(self) -> None:
        """Leave the network; idempotent."""
        self._poller.close()
        if self._rtps is not None:
            self._rtps.close()
        self.dds.close()


def create() -> AutoMiddleware | RtpsMiddleware:
    """Return a middleware configured by this process's environment.

    Raises:
        MiddlewareError: As of :class:`.dds.middleware.DdsMiddleware` or
            :class:`.rtps.middleware.RtpsMiddleware`.
    """
    if why_missing():
        from .rtps.middleware import RtpsMiddleware

        return RtpsMiddleware()
    from .dds.middleware import DdsMiddleware

    return AutoMiddleware(DdsMiddleware())
