"""Managed (lifecycle) node of a host."""

from __future__ import annotations

from typing import Any

from ..client.lifecycle import LifecycleMethods, StateMachine
from .node import Node


class LifecycleNode(LifecycleMethods, Node):
    """A host's :class:`~uros.host.node.Node` with a life cycle.

    It has the interface of :mod:`uros.client.lifecycle`, whose names are those of rclpy.lifecycle.
    """

    def __init__(
        self,
        name: str,
        transport: Any = None,
        namespace: str = "",
        domain_id: int | None = None,
        enable_communication_interface: bool = True,
        **options: Any,
    ) -> None:
        Node.__init__(self, name, transport, namespace, domain_id, **options)
        self._managed = []
        self._machine = StateMachine(self, enable_communication_interface)
