"""Service clients and servers whose type is not loaded yet.

Each stands in for an endpoint that its node creates later, and passes every call on from then.
Until then it has received nothing and has no room for requests.
"""

from __future__ import annotations

from abc import abstractmethod
from typing import Generic, Protocol, TypeVar

from ...qos import QoSProfile
from ..base import Bytes, MiddlewareError, Node, OnReady, Replier, Requester, Service

ServiceEndpoint = TypeVar("ServiceEndpoint", Requester, Replier)


class PendingOwner(Protocol):
    """The node that a pending endpoint belongs to."""

    def create_pending(
        self, pending: PendingEndpoint[ServiceEndpoint], error: MiddlewareError | None = None
    ) -> ServiceEndpoint:
        """Create the endpoint; ``error`` is why the type could not be loaded.

        Raises:
            MiddlewareError: It cannot be created at all.
        """

    def cancel_pending(self, pending: PendingEndpoint[ServiceEndpoint]) -> None:
        """Note that it was closed before it was created."""


class PendingEndpoint(Generic[ServiceEndpoint]):
    """What both kinds have in common.

    Attributes:
        service: The service it belongs to.
    """

    __slots__ = ("_closed", "_endpoint", "_failure", "_node", "_on_ready", "_qos", "service")

    def __init__(
        self, node: PendingOwner, service: Service, qos: QoSProfile, on_ready: OnReady
    ) -> None:
        self.service = service
        self._node = node
        self._qos = qos
        self._on_ready = on_ready
        self._endpoint: ServiceEndpoint | None = None
        self._failure: MiddlewareError | None = None
        self._closed = False

    @abstractmethod
    def create_on(self, node: Node) -> ServiceEndpoint:
        """Create the endpoint on a node.

        Raises:
            MiddlewareError: The node refuses it.
        """

    def resolve(self, error: MiddlewareError | None) -> None:
        """Have the owner create the endpoint, unless it was closed.

        Args:
            error: Why the type could not be loaded, or None.

        Raises:
            MiddlewareError: It cannot be created; each later request or reply raises it too.
        """
        if self._closed:
            return
        try:
            self._endpoint = self._node.create_pending(self, error)
        except MiddlewareError as failure:
            self._failure = failure
            raise

    def close(self) -> None:
        """Close the endpoint, or cancel its creation; idempotent."""
        if self._endpoint is not None:
            self._endpoint.close()
        elif not self._closed:
            self._node.cancel_pending(self)
        self._closed = True

    def _created(self) -> ServiceEndpoint | None:
        if self._failure is not None:
            raise self._failure
        return self._endpoint


class PendingRequester(PendingEndpoint[Requester], Requester):
    """A service client that is pending."""

    __slots__ = ()

    def create_on(self, node: Node) -> Requester:
        """See :meth:`PendingEndpoint.create_on`."""
        return node.create_requester(self.service, self._qos, self._on_ready)

    def request(self, cdr: Bytes) -> int | None:
        """Send a request; None while pending."""
        endpoint = self._created()
        return None if endpoint is None else endpoint.request(cdr)

    def take(self, limit: int) -> list[tuple[int, bytes]]:
        """Take replies; none while pending."""
        return [] if self._endpoint is None else self._endpoint.take(limit)

    def refusal(self) -> str:
        """Return why no request is sent; empty while pending."""
        return "" if self._endpoint is None else self._endpoint.refusal()

    def again(self) -> None:
        """Have ``on_ready`` called again; nothing while pending."""
        if self._endpoint is not None:
            self._endpoint.again()

    def arrived(self, limit: int) -> list[int]:
        """Return the sizes of new replies; none while pending."""
        return [] if self._endpoint is None else self._endpoint.arrived(limit)


class PendingReplier(PendingEndpoint[Replier], Replier):
    """A server that is pending."""

    __slots__ = ()

    def create_on(self, node: Node) -> Replier:
        """See :meth:`PendingEndpoint.create_on`."""
        return node.create_replier(self.service, self._qos, self._on_ready)

    def take(self, limit: int) -> list[tuple[bytes, int, bytes]]:
        """Take requests; none while pending."""
        return [] if self._endpoint is None else self._endpoint.take(limit)

    def arrived(self, limit: int) -> list[int]:
        """Return the sizes of new requests; none while pending."""
        return [] if self._endpoint is None else self._endpoint.arrived(limit)

    def reply(self, guid: bytes, sequence: int, cdr: Bytes) -> bool:
        """Send a reply; dropped while pending, as no request can have come then."""
        endpoint = self._created()
        return True if endpoint is None else endpoint.reply(guid, sequence, cdr)
