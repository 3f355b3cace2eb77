"""The Node of a host: with no transport it joins the ROS network itself."""

from __future__ import annotations

import atexit
import weakref
from contextlib import AbstractContextManager, suppress
from typing import Any

from ..client import node
from ..client.connection import Connection
from ..middleware import open_middleware
from ..middleware.environment import environment_domain
from .direct import Direct
from .no_agent import NoAgentNotice
from .stop_signals import Terminated, stop_signals


class Node(node.Node):
    """A node of a host, with the interface of a board's (:class:`uros.client.node.Node`).

    ::

        node = uros.Node("listener")
        node.create_subscription(Temperature, "/sensors/room_temp", print)
        node.spin()

    Use a node from one thread. A node that still exists when the program ends, also by Ctrl-C, is
    destroyed then. SIGTERM and SIGHUP end :meth:`spin` as Ctrl-C does, and raise SystemExit from
    :meth:`spin_once`; a program that has handlers for them keeps these.

    Args:
        name: The node's name.
        transport: By default the node joins the ROS network by DDS. It may be a transport to an
            agent, or the ``connection`` of another node, to share it; each node is spun by itself.
        namespace: The node's namespace.
        domain_id: By default ROS_DOMAIN_ID, else 0.
        options: Those of :class:`uros.client.node.Node`.

    Raises:
        MiddlewareError: The domain cannot be joined.
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
            transport = opened = Direct(open_middleware("auto"), domain)
        if domain_id is None:
            domain_id = transport.domain if isinstance(transport, Direct) else 0
        try:
            super().__init__(name, transport, namespace, domain_id, **options)
        except BaseException:
            if opened is not None:
                opened.close()
            raise
        self._notice: NoAgentNotice | None = None
        if self._owner and not isinstance(self.connection, Direct):
            self._notice = NoAgentNotice(self.connection, name)
        if self._owner and not isinstance(self.connection, Direct):  # which closes itself at exit
            atexit.register(_leave, weakref.ref(self))

    def destroy_node(self) -> None:
        """Leave the network; :meth:`spin` returns. Nodes that share the connection stay."""
        if not self._destroyed:
            self._destroyed = True
            super().destroy_node()

    def spin_once(self, timeout_sec: float | None = None) -> bool:
        """Run the callbacks that are ready, after waiting for one.

        Args:
            timeout_sec: The longest wait; None has no limit.

        Returns:
            Whether a callback was run.
        """
        with self._interruptible():
            return self._spin_once(timeout_sec)

    def spin(self) -> None:
        """Spin until Ctrl-C, SIGTERM or SIGHUP, or until a callback destroys the node."""
        try:
            with self._interruptible():
                while not self._destroyed:
                    self._spin_once(None)
        except (KeyboardInterrupt, Terminated):
            pass

    def _spin_once(self, timeout_sec: float | None) -> bool:
        """Spin once; meanwhile say that there is no agent, when that is due."""
        # A wait may end some milliseconds early: until the line is printed, or never due.
        while self._notice is not None and (left := self._notice.left()) is not None:
            if timeout_sec is not None and timeout_sec <= left:
                break
            if super().spin_once(left):
                return True
            timeout_sec = None if timeout_sec is None else timeout_sec - left
        return super().spin_once(timeout_sec)

    def _serve(self) -> None:
        if not self._destroyed:  # by the callback that has just run
            super()._serve()

    def _interruptible(self) -> AbstractContextManager[object]:
        if isinstance(self.connection, Direct):
            return self.connection.interrupt.watched()
        return stop_signals()


def _leave(node: weakref.ref[Node]) -> None:
    """Destroy the node; otherwise the agent keeps its objects until the client timeout."""
    remaining = node()
    if remaining is not None:
        with suppress(KeyboardInterrupt):  # a second Ctrl-C ends the wait for the agent's answer
            remaining.destroy_node()
