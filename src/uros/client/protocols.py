"""The contracts between a node, its entities, what connects them, and the transport below.

Declarations for type checkers and readers alone: boards never import this module.

* `NodeConnection` is what a node and its entities need. Two classes implement it:
  :class:`uros.client.connection.Connection`, a session with an agent, and
  :class:`uros.host.direct.Direct`, a host's own participants on the ROS network.
* `ConnectedEntity` is what such a connection needs of that which is added to it.
* `Transport` is the board's end of a line, which a ``Connection`` uses.
"""

try:
    from typing import Any, Callable, Protocol

    from ..wire.cdr import Buffer
    from .clock import Clock

    class Transport(Protocol):
        """The board's end of a line; message-oriented: framing is hidden."""

        mtu: int
        """The largest message, in bytes."""

        def open(self) -> None:
            """Open the line.

            Raises:
                OSError: There is no line now; the caller tries again later.
            """

        def close(self) -> None:
            """Close the line; idempotent."""

        def send(self, message: "Buffer", size: int) -> None:
            """Send the first ``size`` bytes, or lose them; never block.

            The buffer is the caller's again afterwards.

            Raises:
                OSError: The line is gone.
            """

        def receive(self, timeout_ms: int) -> "bytes | None":
            """Return the next message; wait for it at most ``timeout_ms``.

            Raises:
                OSError: The line is gone.
            """

    class ConnectedEntity(Protocol):
        """A node, or an entity of one, as its connection sees it."""

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
        """An entity to which samples, requests or replies come."""

        def on_data(self, buf: "Buffer", start: int, stop: int, little: bool) -> None:
            """Take a sample out of ``buf``, which is the caller's again afterwards."""

        def on_refused(self, request_id: int) -> bool:
            """Return whether it made this request, and if so fail its future."""

    class NodeConnection(Protocol):
        """What connects nodes with the ROS network: by an agent, or on a host by itself."""

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
            """Connect an entity now and in all sessions to come.

            Args:
                entity: A `ConnectedEntity`; a node before what belongs to it.

            Returns:
                Its number, unique among those with the same first kind.
            """

        def remove(self, entity: "Any", object_ids: "tuple[int, ...]") -> None:
            """Disconnect an entity for good.

            Args:
                entity: What was added.
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
                reliable: Whether on the reliable stream.

            Returns:
                The request id; 0 where there is no room now: nothing was sent.
            """

        def transient_local(self, depth: int) -> "Any":
            """Return the ``qos`` of a publisher whose last ``depth`` messages late readers get."""

        def pump(self, timeout_ms: int) -> None:
            """Do what is due, then take what comes.

            Args:
                timeout_ms: The longest wait for something; below 0 nothing is taken.
            """

        def close(self) -> None:
            """Leave the agent or the network."""

except ImportError:  # MicroPython
    pass
