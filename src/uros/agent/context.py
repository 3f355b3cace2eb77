"""Protocols of what the parts of the agent use of it and of each other.

The parts (:mod:`.policy`, :mod:`.persistence`, :mod:`.objects`) import this module, and
:mod:`.agent` and :mod:`.server` import the parts, so that modules do not import each other.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol

from ..middleware.base import Middleware
from .clock import Clock
from .log import Log, RateLimit
from .objects.object_table import XrceObject
from .objects.ros_graph import Graphs
from .objects.xml_profiles import References
from .policy.admission import Admission, Refusals
from .policy.limits import Limits
from .policy.memory_budget import MemoryBudget
from .policy.rules import Rules
from .policy.time_budget import DeferredCloseQueue, TimeBudget
from .session.session import Session
from .transports.base import ServerTransport

if TYPE_CHECKING:
    from .persistence.records import Reading, Representation


class CreateClientRequest(NamedTuple):
    """What a CREATE_CLIENT asks for, as far as it is needed to admit the client later."""

    session_id: int
    mtu: int
    properties: list[tuple[str, str]]


class ClientState(Protocol):
    """What policy and persistence use of a :class:`~uros.agent.objects.client.ProxyClient`."""

    key: int
    session: Session
    objects: dict[int, XrceObject]
    certificate: str | None
    born: float

    def recreate(
        self, object_id: int, form: int, content: str | bytes, kind: int, parent: int, little: bool
    ) -> None:
        """Create an object again that existed before the agent was restarted."""

    def read(
        self, object_id: int, request_id: int, stream_id: int,
        control: tuple[int, int, int, int] | None,
    ) -> bool:  # fmt: skip
        """Continue a READ_DATA from before the restart; return whether its object exists."""


class Persistence(Protocol):
    """What the agent and its clients report to the session store (``--state``)."""

    def placed(
        self, client: ClientState, transport: ServerTransport, peer: Any,
        properties: list[tuple[str, str]] | None,
    ) -> None:  # fmt: skip
        """Record that a client was created, re-established its session or has another address."""

    def forget(self, key: int) -> None:
        """Record that a client was deleted."""

    def created(self, client: ClientState, obj: XrceObject, representation: Representation) -> None:
        """Record that an object was created."""

    def deleted(self, client: ClientState, object_id: int) -> None:
        """Record that an object was deleted."""

    def reading(self, client: ClientState, object_id: int, reading: Reading | None) -> None:
        """Record that a READ_DATA of an object began; None: it ended."""

    def keep(self, sessions: Iterable[Session]) -> None:
        """Write what these sessions are about to acknowledge or send."""


class AgentContext(Protocol):
    """What the parts of the agent use of :class:`~uros.agent.agent.Agent`."""

    log: Log
    faults: RateLimit
    clock: Clock
    middleware: Middleware
    references: References
    graphs: Graphs
    rules: Rules
    admission: Admission
    refusals: Refusals
    limits: Limits
    budget: MemoryBudget
    time_budget: TimeBudget
    close_queue: DeferredCloseQueue
    session_store: Persistence | None
    attended: set[Session]
    domain_of_agent: int
    domain_override: int | None
    # Calls a function once, so many seconds from now.
    wake_at: Callable[[float, Callable[[], None]], None]

    @property
    def clients(self) -> Mapping[int, ClientState]:
        """The clients by key."""

    def now(self) -> int:
        """Return the time in milliseconds modulo 2^30."""

    def failed(self, error: Exception) -> None:
        """Log an unexpected error."""

    def attend(self, session: Session) -> None:
        """Note that the session has something to send, or a new deadline."""

    def place(self, key: int) -> tuple[ServerTransport, Any]:
        """Return a client's transport, and its address there."""

    def address(self, key: int) -> str:
        """Return a client's address as text."""

    def delete_client(self, key: int) -> bool:
        """Delete a client and its objects; return whether it existed."""

    def take_over(
        self, key: int, transport: ServerTransport, peer: Any, request: CreateClientRequest | None
    ) -> None:
        """Give the client's key to this address, and answer the request if there is one."""

    def deny(
        self, key: int, transport: ServerTransport, peer: Any, request: CreateClientRequest
    ) -> None:
        """Answer a request with STATUS_ERR_DENIED."""

    def resume(
        self, key: int, transport: ServerTransport, peer: Any, request: CreateClientRequest
    ) -> ClientState:
        """Create a client again that existed before the restart, without a message from it."""


class ServerContext(Protocol):
    """What an attachment uses of :class:`~uros.agent.server.Server`."""

    transports: list[ServerTransport]

    @property
    def agent(self) -> AgentContext:
        """The agent that the server runs."""

    def wake_at(self, seconds: float, call: Callable[[], None]) -> None:
        """Call ``call`` once, ``seconds`` from now."""
