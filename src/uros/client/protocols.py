"""Protocols of a node's entities, their connection and the transport below it.

Declarations for type checkers and readers only: boards never import this module.

* `NodeConnection` is what a node and its entities need. Two classes implement it:
  :class:`uros.client.connection.Connection`, a session with an agent, and
  :class:`uros.host.direct.Direct`, a host's own participants on the ROS network.
* `ConnectedEntity` is what such a connection needs of the entities added to it.
* `Transport` is the board's end of the link to its agent, which a ``Connection`` uses.
"""

try:
    from typing import Any, Callable, Protocol

    from ..wire.cdr import Buffer
    from .clock import Clock

    class Transport(Protocol):
        """The board's end of the link to its agent; message-oriented: framing is hidden."""

        mtu: int
        """The largest message, in bytes."""

        def open(self) -> None:
            """Open the link.

            Raises:
                OSError: The link is not available now; the caller retries later.
            """

        def close(self) -> None:
            """Close the link; idempotent."""

        def send(self, message: "Buffer", size: int) -> None:
            """Send the first ``size`` bytes, or lose them; never block.

            The caller may reuse the buffer afterwards.

            Raises:
                OSError: The link has failed.
            """

        def receive(self, timeout_ms: int) -> "bytes | None":
            """Return the next message; wait for it at most ``timeout_ms``.

            Raises:
                OSError: The link has failed.
            """

    class ConnectedEntity(Protocol):
        """A node, or an entity of a node, as its connection uses it."""

        kinds: "tuple[int, ...]"
        """Kinds of its XRCE objects, in the order of their creation."""
        name: str

        def create(self, connection: "Any", step: int) -> bool:
            """Make request number ``step`` of those that create it at the agent.

            Only a session with an agent calls it.

            Returns:
                Whether it was the last request.
            """

        def on_lost(self) -> None:
            """Forget what belongs to the session, which has ended."""

    class ReceivingEntity(ConnectedEntity, Protocol):
        """An entity that receives samples, requests or replies."""

        def on_data(self, buf: "Buffer", start: int, stop: int, little: bool) -> None:
            """Take a sample out of ``buf``, which the caller may reuse afterwards."""

        def on_refused(self, request_id: int) -> bool:
            """Return whether the entity made this request; if so, fail its future."""

    class NodeConnection(Protocol):
        """Connection of nodes with the ROS network: by an agent, or on a host directly."""

        clock: Clock
        state: int
        """WAITING_AGENT, AGENT_AVAILABLE, AGENT_CONNECTED or AGENT_DISCONNECTED."""
        on_state: "Callable[[int], object] | None"
        """Called with each new state."""
        reason: str
        """Why the last agent was lost; empty before."""
        connections: int
        """How many sessions have reached AGENT_CONNECTED."""
        has_agent: bool
        """Whether it is an XRCE session with an agent, a `Connection`.

        Without an agent QoS profiles apply as a whole, and publishers have no buffers of a session.
        A plain attribute, since a property makes every store to an object of its class slower on
        MicroPython.
        """

        def add(self, entity: "Any") -> int:
            """Connect an entity now and in all later sessions.

            Args:
                entity: A `ConnectedEntity`; a node is added before its entities.

            Returns:
                The entity's number, unique among those with the same first kind.
            """

        def remove(self, entity: "Any", object_ids: "tuple[int, ...]") -> None:
            """Disconnect an entity permanently.

            Args:
                entity: The entity that was added.
                object_ids: Its XRCE objects, in the order of their creation.
            """

        def write(
            self, object_id: int, message: "Any", prefix: bytes, reliable: "bool | int"
        ) -> int:
            """Send a message; never wait.

            Args:
                object_id: The XRCE id of the datawriter, requester or replier.
                message: A generated message.
                prefix: Bytes in front of it: the request's identity in a reply.
                reliable: Whether to use the reliable stream.

            Returns:
                The request id, or 0 if the message cannot be sent or queued now.
            """

        def transient_local(self, depth: int) -> "Any":
            """Return the ``qos`` of a publisher with transient local durability and this depth."""

        def pump(self, timeout_ms: int) -> None:
            """Do what is due, then receive.

            Args:
                timeout_ms: Longest wait for a message; below 0 nothing is received.
            """

        def close(self) -> None:
            """Close the session with the agent, or leave the network."""

except ImportError:  # MicroPython
    pass
