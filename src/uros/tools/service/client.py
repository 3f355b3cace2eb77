"""Clients of services, for the verbs that call them.

A client is created, matched with a server, and asked; all in the calling thread. Requests go over
RTPS, in the form that the server uses.
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any, Final, NamedTuple

from ..common import remedy
from ..errors import ToolError
from ..waiting import warn

if TYPE_CHECKING:
    from ...host.graph_queries import EndpointInfo
    from ...host.network import Network
    from ...middleware.base import Middleware, Requester, Service
    from ...qos import QoSProfile

# How long the discovery of a service takes at most, in seconds.
_DISCOVERY: Final = 1.5
# Where the middleware does not know which servers match: a server may discover us later than we
# discover it, and then misses the request.
_SETTLE: Final = 0.15
_POLL: Final = 0.01
_PATIENCE: Final = 5.0
_BATCH: Final = 16


def find_servers(network: Network, service: str, seconds: float | None) -> list[EndpointInfo]:
    """Wait for the servers of a service.

    Args:
        network: The domain.
        service: The service's full name.
        seconds: The timeout; None has no limit.

    Raises:
        ToolError: There is none within the timeout.
    """
    graph = network.graph
    soon = _DISCOVERY if seconds is None else min(_DISCOVERY, seconds)
    if not network.spin(lambda: bool(graph.servers(service)), soon):
        known = [name for name in graph.services() if name != service]
        warn(
            f"waiting for service {service} to become available;"
            f" there is none{remedy(network, service, known)}"
        )
        left = None if seconds is None else seconds - soon
        if not network.spin(lambda: bool(graph.servers(service)), left):
            raise ToolError(
                f"there was no service {service} within {seconds:g} s"
                f"{remedy(network, service, known)}"
            )
    return graph.servers(service)


class ServiceClient:
    """A client of a service, and the loop that serves it. Close it.

    Args:
        network: The domain.
        service: The service's full name.
        kind: The service's class, with ``Request`` and ``Response``.
        qos: The client's profile; that of ROS 2 by default.

    Raises:
        MiddlewareError: The client cannot be created.
    """

    def __init__(
        self, network: Network, service: str, kind: Any, qos: QoSProfile | None = None
    ) -> None:
        from ...qos import services_profile

        self._network = network
        self._service = service
        self._kind = kind
        self._qos = services_profile() if qos is None else qos
        self._replies: dict[int, bytes] = {}
        self._requester = self._create(network)

    def _create(self, network: Network) -> Requester:
        return network.node.create_requester(self._description(), self._qos, _nothing)

    def _description(self) -> Service:
        from ...middleware.base import Service

        return Service(
            f"rq{self._service}Request", self._kind.Request._DDS_TYPE,
            f"rr{self._service}Reply", self._kind.Response._DDS_TYPE,
        )  # fmt: skip

    def match(self, seconds: float | None) -> None:
        """Wait until a server has matched.

        Args:
            seconds: The timeout; None has no limit.

        Raises:
            ToolError: None has matched within the timeout.
        """
        if self._requester.servers() is None:
            self.wait(lambda: False, _SETTLE)
            return
        patience = _PATIENCE if seconds is None else min(_PATIENCE, seconds)
        if self.wait(self.is_matched, patience):
            return
        if seconds is None:
            warn(f"{_unmatched(self._service, patience)}; still waiting")
        if not self.wait(self.is_matched, None if seconds is None else seconds - patience):
            raise _unmatched(self._service, seconds)

    def is_matched(self) -> bool:
        """Return whether a server has matched, or the middleware does not know."""
        return self._requester.servers() != 0

    def wait(self, done: Callable[[], bool], seconds: float | None) -> bool:
        """Serve the network until ``done()``. Return False if the time is over before."""
        return self._network.spin(done, seconds)

    def request(self, message: Any) -> int:
        """Send a request; return its number, for :meth:`answer`.

        Raises:
            MiddlewareError: A server would misread it.
        """
        number = self.try_request(message)
        while number is None:
            self.wait(lambda: False, _POLL)
            number = self.try_request(message)
        return number

    def try_request(self, message: Any) -> int | None:
        """Send a request as :meth:`request` does; return None if there is no room now."""
        from ...interfaces.codec import to_cdr

        return self._requester.request(to_cdr(message))

    def answer(self, number: int, seconds: float | None) -> Any:
        """Wait for the response to a request.

        Args:
            number: The request's number.
            seconds: The timeout; None has no limit.

        Raises:
            ToolError: There is none within the timeout, or there will be none.
        """

        def came() -> bool:
            return self.is_answered(number)

        patience = _PATIENCE if seconds is None else min(_PATIENCE, seconds)
        if not self.wait(came, patience):
            if seconds is None:
                warn(f"{self._service} has not answered for {patience:g} s; still waiting")
            left = None if seconds is None else seconds - patience
            if not self.wait(came, left):
                raise _unanswered(self._service, seconds)
        return self.response(number)

    def is_answered(self, number: int) -> bool:
        """Return whether :meth:`response` would return or raise now."""
        self._replies.update(self._requester.take(_BATCH))
        return (
            number in self._replies
            or bool(self._requester.refusal())
            or not self._network.graph.servers(self._service)
        )

    def response(self, number: int) -> Any:
        """Return the response that has come.

        Raises:
            ToolError: None came, and none will come.
        """
        from ...interfaces.codec import from_cdr

        if number in self._replies:
            return from_cdr(self._kind.Response, self._replies.pop(number))
        raise ToolError(
            self._requester.refusal() or f"{self._service} ended before it answered; call it again"
        )

    def close(self) -> None:
        """Delete the client; idempotent."""
        self._requester.close()


class RclpyClient(ServiceClient):
    """A client that rclpy makes, on a middleware of its own.

    Raises:
        ToolError: rclpy cannot make it.
    """

    _middleware: Middleware

    def _create(self, network: Network) -> Requester:
        from ...middleware import open_middleware
        from ...middleware.base import MiddlewareError

        try:
            self._middleware = open_middleware("ros2")
        except MiddlewareError as error:
            raise ToolError(f"-m ros2 needs rclpy: {error}") from error
        try:
            node = self._middleware.create_node(network.domain, "/", f"_uros_asks_{os.getpid()}")
            return node.create_requester(self._description(), self._qos, _nothing)
        except MiddlewareError as error:
            self._middleware.close()
            raise ToolError(f"-m ros2 needs rclpy: {error}") from error

    def match(self, seconds: float | None) -> None:
        """Wait until rclpy has found a server; as in the base class."""
        requester: Any = self._requester
        if not self.wait(requester.entity.service_server_is_available, seconds):
            raise ToolError(f"rclpy did not find {self._service} within {seconds:g} s")
        self.wait(lambda: False, _SETTLE)

    def wait(self, done: Callable[[], bool], seconds: float | None) -> bool:
        """Serve both middlewares; as in the base class."""
        end = None if seconds is None else time.monotonic() + seconds
        while True:
            self._middleware.dispatch()
            self._middleware.tick()
            if done():
                return True
            if end is not None and time.monotonic() >= end:
                return False
            self._network.spin(lambda: False, _POLL)

    def close(self) -> None:
        """Delete the client and its middleware; idempotent."""
        super().close()
        self._middleware.close()


def _unmatched(service: str, seconds: float | None) -> ToolError:
    return ToolError(
        f"a server of {service} was found, but did not match within {seconds:g} s: its QoS may not"
        f" fit, which 'uros service info -v {service}' prints"
    )


def _unanswered(service: str, seconds: float | None) -> ToolError:
    return ToolError(
        f"{service} did not answer within {seconds:g} s; is its node busy, or not spinning?"
    )


# --- several services at once -------------------------------------------------------------------


class Call(NamedTuple):
    """A request to a service, by the service's full name and class."""

    service: str
    kind: Any
    request: Any


def call_all(network: Network, calls: Sequence[Call], seconds: float) -> list[Any]:
    """Call services at the same time.

    Args:
        network: The domain.
        calls: What to call.
        seconds: The timeout for all of them.

    Returns:
        The response of each call, or a ToolError that says why there is none.
    """
    clients = [ServiceClient(network, call.service, call.kind) for call in calls]
    numbers: dict[int, int] = {}
    outcomes: dict[int, Any] = {}

    def done() -> bool:
        for index, (client, call) in enumerate(zip(clients, calls, strict=True)):
            if index in outcomes:
                continue
            try:
                if index not in numbers and client.is_matched():
                    number = client.try_request(call.request)
                    if number is not None:
                        numbers[index] = number
                if index in numbers and client.is_answered(numbers[index]):
                    outcomes[index] = client.response(numbers[index])
            except _failures() as error:
                outcomes[index] = ToolError(str(error))
        return len(outcomes) == len(clients)

    try:
        network.spin(done, seconds)
    finally:
        for client in clients:
            client.close()
    for index, call in enumerate(calls):
        if index not in outcomes:
            late = _unanswered if index in numbers else _unmatched
            outcomes[index] = late(call.service, seconds)
    return [outcomes[index] for index in range(len(calls))]


def _failures() -> tuple[type[Exception], ...]:
    from ...interfaces.errors import InterfaceError
    from ...middleware.base import MiddlewareError

    return ToolError, MiddlewareError, InterfaceError


def _nothing() -> None:
    """Ignore the event: the loop takes replies after each one."""
