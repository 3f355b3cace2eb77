"""A goal that a verb sends: its services, feedback, result and cancellation."""

from __future__ import annotations

from collections.abc import Callable
from types import TracebackType
from typing import TYPE_CHECKING, Any, Final

from ...client.action_client import random_uuid
from ..common import remedy
from ..errors import ToolError
from ..service.client import ServiceClient
from ..waiting import warn

if TYPE_CHECKING:
    from ...host.network import Network, Received

SERVICES: Final = ("send_goal", "cancel_goal", "get_result")
"""The names of an action's services, behind ``/_action/``."""

# How long the discovery of an action takes at most, in seconds.
_DISCOVERY: Final = 1.5
# Seconds for the answer to a request to cancel.
_PATIENCE: Final = 5.0
_FEEDBACK_DEPTH: Final = 10
# Seconds for which feedback may come behind the result.
_LATE_FEEDBACK: Final = 0.05


def service_of(action: str, name: str) -> str:
    """Return the full name of one of an action's `SERVICES`."""
    return f"{action}/_action/{name}"


def server_types(network: Network, action: str) -> list[str]:
    """Return the types of an action's servers that have all their services, sorted."""
    graph = network.graph
    if not all(graph.servers(service_of(action, name)) for name in SERVICES):
        return []
    requests = graph.servers(service_of(action, "send_goal"))
    return sorted({server.type_name.removesuffix("_SendGoal_Request") for server in requests})


def wait_for_server(network: Network, action: str, seconds: float | None) -> list[str]:
    """Wait for a server of an action; return the types of all of them.

    Args:
        network: The domain.
        action: The action's full name.
        seconds: The timeout; None has no limit.

    Raises:
        ToolError: There is none within the timeout.
    """

    def is_there() -> bool:
        return bool(server_types(network, action))

    soon = _DISCOVERY if seconds is None else min(_DISCOVERY, seconds)
    if not network.spin(is_there, soon):
        known = [name for name in network.graph.actions() if name != action]
        left = None if seconds is None else seconds - soon
        if left is None or left > 0.0:
            warn(f"there is no server of the action {action}{remedy(network, action, known)}")
        if not network.spin(is_there, left):
            raise ToolError(
                f"there was no server of the action {action} within {seconds:g} s"
                f"{remedy(network, action, known)}"
            )
    return server_types(network, action)


class Goal:
    """A goal for the servers of an action that are there now; a context manager.

    Args:
        network: The domain.
        action: The action's full name.
        kind: The action's class.
        on_feedback: Gets each feedback message of the goal; None to receive none.

    Raises:
        MiddlewareError: The clients cannot be created.
    """

    def __init__(
        self,
        network: Network,
        action: str,
        kind: Any,
        on_feedback: Callable[[Any], object] | None = None,
    ) -> None:
        from ...qos import QoSProfile

        self.id = random_uuid()
        self._network = network
        self._action = action
        self._kind = kind
        self._on_feedback = on_feedback
        self._number: int | None = None  # of the request that sends the goal
        self._accepted: bool | None = None  # None before the server's answer
        self._servers = self._gids()
        if on_feedback is not None:  # before the services, so that a server knows it first
            network.listen(
                f"{action}/_action/feedback", kind.Impl.FeedbackMessage._TYPE,
                QoSProfile(_FEEDBACK_DEPTH), self._feedback,
            )  # fmt: skip
        impl = kind.Impl
        kinds = (impl.SendGoalService, impl.CancelGoalService, impl.GetResultService)
        self._send, self._cancel, self._result = self._clients = [
            ServiceClient(network, service_of(action, name), service)
            for name, service in zip(SERVICES, kinds, strict=True)
        ]

    def match(self, seconds: float | None) -> None:
        """Wait until a server has matched the clients.

        Args:
            seconds: The timeout of each client; None has no limit.

        Raises:
            ToolError: None has matched within the timeout.
        """
        for client in self._clients:
            client.match(seconds)

    @property
    def is_sent(self) -> bool:
        """Whether the goal was sent."""
        return self._number is not None

    def send(self, goal: Any) -> None:
        """Send the goal."""
        request = self._kind.Impl.SendGoalService.Request()
        request.goal_id.uuid = self.id
        request.goal = goal
        self._number = self._send.request(request)

    def is_accepted(self, seconds: float | None) -> bool:
        """Wait for the server's answer to the goal; return whether it accepts the goal.

        Args:
            seconds: The timeout; None has no limit.

        Raises:
            ToolError: There is no answer within the timeout, or the server has left.
        """
        if self._accepted is None:
            assert self._number is not None, "sent"
            late = "did not answer; is its node busy, or not spinning?"
            self._accepted = self._answer(self._send, self._number, seconds, late).accepted
        return bool(self._accepted)

    def result(self, seconds: float | None) -> Any:
        """Wait for the end of the goal; return the response, with ``status`` and ``result``.

        Args:
            seconds: The timeout; None has no limit.

        Raises:
            ToolError: The goal has not ended within the timeout, or the server has left.
        """
        request = self._kind.Impl.GetResultService.Request()
        request.goal_id.uuid = self.id
        number = self._result.request(request)
        late = "has not ended the goal, which goes on"
        response = self._answer(self._result, number, seconds, late)
        if self._on_feedback is not None:
            # It was sent before the result, but over a topic, which another thread may receive.
            self._network.spin(lambda: False, _LATE_FEEDBACK)
        return response

    def cancel(self) -> Any:
        """Ask the server to cancel the goal; return its response.

        Raises:
            ToolError: The server does not answer, or has left.
        """
        request = self._kind.Impl.CancelGoalService.Request()
        request.goal_info.goal_id.uuid = self.id
        number = self._cancel.request(request)
        late = "does not answer the request to cancel the goal, which may go on"
        return self._answer(self._cancel, number, _PATIENCE, late)

    def close(self) -> None:
        """Delete the clients; idempotent. The goal goes on."""
        for client in self._clients:
            client.close()

    def __enter__(self) -> Goal:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()

    def _gids(self) -> set[bytes]:
        servers = self._network.graph.servers(service_of(self._action, "send_goal"))
        return {server.gid for server in servers}

    def _is_served(self) -> bool:
        """Whether a server of the beginning is there. A later one does not know the goal."""
        return bool(server_types(self._network, self._action)) and bool(
            self._servers & self._gids()
        )

    def _answer(self, client: ServiceClient, number: int, seconds: float | None, late: str) -> Any:
        """Wait for the response to a request; ``late`` says what is missing after the timeout."""

        def came() -> bool:
            return client.is_answered(number) or not self._is_served()

        if not self._network.spin(came, seconds):
            raise ToolError(f"within {seconds:g} s {self._action} {late}")
        try:
            return client.response(number)
        except ToolError as error:
            if self._is_served():
                raise
            raise ToolError(
                f"the server of {self._action} has left the network before the end of the goal"
            ) from error

    def _feedback(self, received: Received) -> None:
        from ...interfaces import InterfaceError, codec

        try:
            message = codec.from_cdr(self._kind.Impl.FeedbackMessage, received.cdr)
        except InterfaceError as error:
            warn(f"a feedback could not be read: {error}")
            return
        if bytes(message.goal_id.uuid) == self.id and self._on_feedback is not None:
            self._on_feedback(message.feedback)
