"""Nodes by rclpy, all of a domain in one context."""

from __future__ import annotations

import os
from typing import Any

from ...qos import QoSProfile
from ..base import Middleware, MiddlewareError, Node, OnReady, Service, check_domain
from ..wakeup_fd import Wake
from . import rcl
from .domain import RosDomain
from .endpoints import Ros2Reader, Ros2Replier, Ros2Requester, Ros2Writer


class Ros2Node(Node):
    """A node of the ROS graph."""

    def __init__(
        self, middleware: Ros2Middleware, domain: RosDomain, namespace: str, name: str
    ) -> None:
        self.domain = domain
        self.endpoints: dict[Any, None] = {}  # in order of creation
        self._middleware = middleware
        self._namespace, self._name = namespace, name
        self.handle = rcl.create_node(domain.context, namespace, name)
        middleware.nodes[self] = None

    def create_writer(self, topic: str, type_name: str, qos: QoSProfile) -> Ros2Writer:
        return Ros2Writer(self, topic, type_name, qos)

    def create_reader(
        self, topic: str, type_name: str, qos: QoSProfile, on_ready: OnReady
    ) -> Ros2Reader:
        return Ros2Reader(self, topic, type_name, qos, on_ready)

    def create_requester(
        self, service: Service, qos: QoSProfile, on_ready: OnReady
    ) -> Ros2Requester:
        return Ros2Requester(self, service, qos, on_ready)

    def create_replier(self, service: Service, qos: QoSProfile, on_ready: OnReady) -> Ros2Replier:
        return Ros2Replier(self, service, qos, on_ready)

    def guids(self, topic: str, is_writer: bool) -> set[bytes]:
        """The GUIDs of this node's endpoints of a topic (DDS name)."""
        return rcl.guids(self.handle, topic, is_writer, self._namespace, self._name)

    def close(self) -> None:
        if self in self._middleware.nodes:
            del self._middleware.nodes[self]
            for endpoint in list(self.endpoints):
                endpoint.close()
            self.handle.destroy_when_not_in_use()


class Ros2Middleware(Middleware):
    """See the module. Domains are started by their first node.

    ``wake`` is what tells that there is work, where that is another's too: then it is not cleared
    and not closed here.
    """

    name = "ros2"

    def __init__(self, wake: Wake | None = None) -> None:
        rcl.load()
        self.nodes: dict[Ros2Node, None] = {}
        self._domains: dict[int, RosDomain] = {}
        self._owns_wake = wake is None
        self._wake = wake or Wake()
        self._closed = False

    def create_node(
        self, domain: int, namespace: str, name: str, localhost_only: bool = False
    ) -> Ros2Node:
        check_domain(domain)
        if localhost_only and not _stays_here():
            raise MiddlewareError(
                "a client wants a participant that never leaves this machine, and domain"
                f" {domain} is open to the network: start the agent with"
                " ROS_AUTOMATIC_DISCOVERY_RANGE=LOCALHOST"
            )
        if domain not in self._domains:
            self._domains[domain] = RosDomain(domain, self._wake)
        return Ros2Node(self, self._domains[domain], namespace, name)

    def fileno(self) -> int:
        return self._wake.fileno()

    def has_news(self) -> bool:
        """Whether :meth:`dispatch` has work."""
        return any(domain.has_news() for domain in self._domains.values())

    def dispatch(self) -> None:
        if self._owns_wake:
            self._wake.clear()
        failed: Exception | None = None
        for domain in self._domains.values():
            failed = domain.dispatch() or failed
        if failed is not None:
            raise failed

    def close(self) -> None:
        if self._closed:
            return
        self._closed = True
        for node in list(self.nodes):
            node.close()
        for domain in self._domains.values():
            domain.close()
        if self._owns_wake:
            self._wake.close()


def _stays_here() -> bool:
    reach = os.environ.get("ROS_AUTOMATIC_DISCOVERY_RANGE", "").upper()
    if not reach:
        return os.environ.get("ROS_LOCALHOST_ONLY") == "1"
    return reach == "LOCALHOST"
