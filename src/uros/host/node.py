"""The Node of a host: with no transport it joins the ROS network itself."""

from __future__ import annotations

import atexit
import weakref
from contextlib import AbstractContextManager, nullcontext
from typing import Any

from ..client import node
from ..client.connection import Connection
from ..middleware import open_middleware
from ..middleware.environment import environment_domain
from .direct import Direct


class Node(node.Node):
    """A board's node (:class:`uros.client.node.Node`) that needs neither board nor agent::

        node = uros.Node("listener")
        node.create_subscription(Temperature, "/sensors/room_temp", print)
        node.spin()

    Without ``transport`` it joins the ROS network by DDS, in ``domain_id``, else ROS_DOMAIN_ID,
    else 0, and raises MiddlewareError where that cannot be. ``transport`` may be a board's line,
    or the ``connection`` of another node to share it; each is spun by itself. Use a node from one
    thread. A node that is there when the program ends, by Ctrl-C too, is destroyed then.
    """

    _connections = (Connection, Direct)

    def __init__(
        self,
        name: str,
        transport: Any = None,
        namespace: str = "",
        domain_id: int | None = None,
        **options: Any,
    ) -> None:
        self._destroyed = False
        opened: Direct | None = None
        if transport is None:
            domain = environment_domain() if domain_id is None else domain_id
            transport = opened = Direct(open_middleware("dds"), domain)
        if domain_id is None:
            domain_id = transport.domain if isinstance(transport, Direct) else 0
        try:
            super().__init__(name, transport, namespace, domain_id, **options)
        except BaseException:
            if opened is not None:
                opened.close()
            raise
        if self._owner and not isinstance(self.connection, Direct):  # that one leaves by itself
            atexit.register(_leave, weakref.ref(self))

    def destroy_node(self) -> None:
        """Leave the network; :meth:`spin` returns. Nodes that share the connection stay."""
        if not self._destroyed:
            self._destroyed = True
            super().destroy_node()

    def spin_once(self, timeout_sec: float | None = None) -> bool:
        """Run one round of callbacks, waiting for something to do at most so long (None: for
        ever); whether there was one.
        """
        with self._interruptible():
            return super().spin_once(timeout_sec)

    def spin(self) -> None:
        """Spin until Ctrl-C, or until a callback destroys the node."""
        try:
            with self._interruptible():
                while not self._destroyed:
                    super().spin_once()
        except KeyboardInterrupt:
            pass

    def _interruptible(self) -> AbstractContextManager[None]:
        if isinstance(self.connection, Direct):
            return self.connection.interrupt.watched()
        return nullcontext()


def _leave(node: weakref.ref[Node]) -> None:
    """Take leave of the agent, which else would keep the node's objects for its dead time."""
    left = node()
    if left is not None:
        left.destroy_node()
