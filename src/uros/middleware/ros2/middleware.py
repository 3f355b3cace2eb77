"""Nodes by rclpy, all of a domain in one context."""

from __future__ import annotations

import os
from typing import Any

from ...qos import QoSProfile
from ..base import Middleware, Node, OnReady, Service, check_domain
from ..domains import check_loopback
from ..environment import discovery_range
from ..wakeup_fd import WakeupFd
from . import rcl
from .domain import RosDomain
from .endpoints import Ros2Reader, Ros2Replier, Ros2Requester, Ros2Writer


class Ros2Node(Node):
    """A node of the ROS graph.

    Attributes:
        domain: Its domain.
        endpoints: Its endpoints, in order of creation.
        handle: rclpy's node.
    """

    def __init__(
        self, middleware: Ros2Middleware, domain: RosDomain, namespace: str, name: str
    ) -> None:
        self.domain = domain
        self.endpoints: dict[Any, None] = {}
        self._middleware = middleware
        self.handle = rcl.create_node(domain.context, namespace, name)
        middleware.nodes[self] = None

    def create_writer(self, topic: str, type_name: str, qos: QoSProfile) -> Ros2Writer:
        """Create a publisher."""
        return Ros2Writer(self, topic, type_name, qos)

    def create_reader(
        self, topic: str, type_name: str, qos: QoSProfile, on_ready: OnReady
    ) -> Ros2Reader:
        """Create a subscription."""
        return Ros2Reader(self, topic, type_name, qos, on_ready)

    def create_requester(
        self, service: Service, qos: QoSProfile, on_ready: OnReady
    ) -> Ros2Requester:
        """Create a service client."""
        return Ros2Requester(self, service, qos, on_ready)

    def create_replier(self, service: Service, qos: QoSProfile, on_ready: OnReady) -> Ros2Replier:
        """Create a service's server."""
        return Ros2Replier(self, service, qos, on_ready)

    def close(self) -> None:
        """Leave the graph with all endpoints; idempotent."""
        if self in self._middleware.nodes:
            del self._middleware.nodes[self]
            for endpoint in list(self.endpoints):
                endpoint.close()
            self.handle.destroy_when_not_in_use()


class Ros2Middleware(Middleware):
    """rclpy, configured by this process's environment.

    A domain is opened by its first node.

    Attributes:
        nodes: The nodes that are open.

    Raises:
        ImportError: There is no rclpy.
        MiddlewareError: rclpy does not work here.
    """

    name = "ros2"

    def __init__(self) -> None:
        super().__init__()
        rcl.load()
        self.nodes: dict[Ros2Node, None] = {}
        self._domains: dict[int, RosDomain] = {}
        self._wakeup = WakeupFd()
        self._closed = False

    def create_node(
        self, domain: int, namespace: str, name: str, localhost_only: bool = False
    ) -> Ros2Node:
        """Create a node.

        Raises:
            MiddlewareError: The domain cannot be joined, or not on loopback alone.
        """
        check_domain(domain)
        if localhost_only:
            check_loopback(domain, discovery_range(os.environ) == "LOCALHOST")
        if domain not in self._domains:
            self._domains[domain] = RosDomain(domain, self._wakeup)
        return Ros2Node(self, self._domains[domain], namespace, name)

    def fileno(self) -> int:
        """Return the descriptor that is readable when :meth:`dispatch` has work."""
        return self._wakeup.fileno()

    def dispatch(self) -> None:
        """Call ``on_ready`` of each reader that received something."""
        self._wakeup.clear()
        failed: Exception | None = None
        for domain in self._domains.values():
            failed = domain.dispatch() or failed
        if failed is not None:
            raise failed

    def close(self) -> None:
        """Leave the network; idempotent."""
        if self._closed:
            return
        self._closed = True
        for node in list(self.nodes):
            node.close()
        for domain in self._domains.values():
            domain.close()
        self._wakeup.close()
