"""Action client: sends goals, receives feedback and status, requests results.

::

    client = ActionClient(node, Fibonacci, "fibonacci")

    def accepted(future):
        goal = future.result()                 # OSError: not sent, or the agent is lost
        if goal.accepted:
            goal.get_result_async().add_done_callback(ended)

    def ended(future):
        answer = future.result()
        print(answer.status == GoalStatus.STATUS_SUCCEEDED, answer.result.sequence)

    client.send_goal_async(Fibonacci.Goal(7), print).add_done_callback(accepted)

The end of a session fails every pending future. Goals continue at their server: when
`server_is_ready` returns True again, the result of a `ClientGoalHandle` can be requested again, as
long as the server keeps it, and feedback is received.
"""

from ..ticks import ticks_add, ticks_diff
from .actions import ACCEPTED, SUCCEEDED, UNKNOWN, End
from .connection import AGENT_CONNECTED
from .entities import Client, Future, Subscription

try:
    from typing import Any, Callable
except ImportError:  # MicroPython
    pass


class ClientGoalHandle:
    """A goal that was sent.

    ``accepted`` is None until the server has answered, ``stamp`` is the server's time of accepting
    the goal, and ``status`` is the last status received.
    """

    def __init__(
        self, client: "ActionClient", goal_id: "Any",
        feedback_callback: "Callable[[Any], object] | None",
    ) -> None:  # fmt: skip
        self.goal_id = goal_id
        self.accepted: "bool | None" = None
        self.stamp: "Any" = None
        self.status = UNKNOWN
        self._client = client
        self._feedback_callback = feedback_callback
        self._future: "Future | None" = None  # of the SendGoal request
        self._results = 0  # pending requests for the result

    def get_result_async(self) -> Future:
        """Request the result.

        The future is done when the goal has ended. Its result has ``status`` and ``result``. A
        server that does not know the goal, or no longer, answers STATUS_UNKNOWN.
        """
        return self._client._ask_result(self)

    def cancel_goal_async(self) -> Future:
        """Ask the server to cancel the goal.

        The future's result has ``return_code``, 0 if accepted, and ``goals_canceling``, a list of
        GoalInfo. The goal ends later, possibly in another state.
        """
        return self._client._cancel(self.goal_id, None)


class ActionClient(End):
    """Client of an action.

    The callback for feedback gets the FeedbackMessage, as in rclpy; its ``feedback`` is the
    server's Feedback message.
    """

    def __init__(
        self,
        node: "Any",
        action_type: "Any",
        action_name: str,
        feedback_sub_qos_profile: "Any" = 10,
        status_sub_qos_profile: "Any" = None,
    ) -> None:
        super().__init__(node, action_type, action_name)
        impl = action_type.Impl
        # By UUID: goals for which messages may still be received.
        self._goals: "dict[bytes, ClientGoalHandle]" = {}
        make = self.make
        self._send_goal: Client = make(
            Client, node, self.service("send_goal"), impl.SendGoalService, 10
        )
        self._cancel_goal: Client = make(
            Client, node, self.service("cancel_goal"), impl.CancelGoalService, 10
        )
        self._get_result: Client = make(
            Client, node, self.service("get_result"), impl.GetResultService, 10
        )
        feedback = make(
            Subscription, node, self.topic("feedback"), impl.FeedbackMessage,
            feedback_sub_qos_profile, self._on_feedback,
        )  # fmt: skip
        self.make_states(Subscription, status_sub_qos_profile, self._on_status)
        # In this order, so that feedback received before a result is passed on before it.
        self.entities = self.parts = (
            self._send_goal, self._cancel_goal, feedback, self.states, self._get_result,
        )  # fmt: skip

    def server_is_ready(self) -> bool:
        """Return whether a goal can be sent to the agent now: the node is connected.

        XRCE cannot tell whether a server exists, so a goal may have none. Its future then stays
        pending until `remove_pending_request`.
        """
        # While a session is being created, the parts are but no sample may be written yet.
        if self.node.connection.state != AGENT_CONNECTED:
            return False
        for part in self.parts:
            if not part.created:
                return False
        return True

    def wait_for_server(self, timeout_sec: "float | None" = None) -> bool:
        """Spin the node until `server_is_ready` or the time is up; return whether it is ready."""
        clock = self.node.clock
        wait = 0x1FFFFFFF if timeout_sec is None else min(int(timeout_sec * 1000), 0x1FFFFFFF)
        end = ticks_add(clock.ms(), wait)
        while not self.server_is_ready():
            left = ticks_diff(end, clock.ms())
            if timeout_sec is None:
                left = 1000
            elif left <= 0:
                return False
            self.node.spin_once(left / 1000)
        return True

    def send_goal_async(
        self, goal: "Any", feedback_callback: "Callable[[Any], object] | None" = None,
        goal_uuid: "Any" = None,
    ) -> Future:  # fmt: skip
        """Send a Goal message; the future's result is a `ClientGoalHandle`, accepted or not.

        Args:
            goal: A Goal message. Packing raises for values out of range.
            feedback_callback: Gets each FeedbackMessage of the goal.
            goal_uuid: A UUID message; by default of 16 random octets.

        Raises:
            TypeError: ``goal`` is of another type.
        """
        kind = self.action_type.Goal
        if getattr(goal, "_TYPE", None) != kind._TYPE:
            raise TypeError("%s: a goal is a %s" % (self.name, kind._TYPE))
        request = self.action_type.Impl.SendGoalService.Request()
        request.goal = goal
        if goal_uuid is not None:
            request.goal_id = goal_uuid
        else:
            request.goal_id.uuid = random_uuid()
        handle = ClientGoalHandle(self, request.goal_id, feedback_callback)
        future = self._send_goal.call_async(request)
        if future.done():  # the request could not be sent
            return future
        key = bytes(request.goal_id.uuid)
        self._goals[key] = handle
        handle._future = future

        def answered(future: Future) -> None:
            handle._future = None
            if future.exception() is not None:
                self._goals.pop(key, None)
                return
            response = future.result()
            handle.accepted = response.accepted
            handle.stamp = response.stamp
            if handle.accepted and handle.status == UNKNOWN:
                handle.status = ACCEPTED
            if not handle.accepted or handle.status >= SUCCEEDED:
                self._goals.pop(key, None)
            future._result = handle  # for the callbacks after this one

        future.add_done_callback(answered)
        return future

    def remove_pending_request(self, future: Future) -> None:
        """Stop waiting for a future of this client or of one of its goals."""
        for part in (self._send_goal, self._cancel_goal, self._get_result):
            part.remove_pending_request(future)
        for key in list(self._goals):
            if self._goals[key]._future is future:
                del self._goals[key]

    def cancel_all_goals_async(self) -> Future:
        """Ask the server to cancel all goals of all clients; see `cancel_goal_async`."""
        return self._cancel(None, None)

    def cancel_goals_before_async(self, stamp: "Any") -> Future:
        """Ask the server to cancel all goals that it accepted until this Time."""
        return self._cancel(None, stamp)

    def destroy(self) -> None:
        """Destroy the client; pending requests fail."""
        super().destroy()
        for part in self.parts:
            part.on_lost()
        for part in self.parts:
            while isinstance(part, Client) and part.is_ready(0):
                self.attempt(part.execute, True)

    # --- requests of goal handles -------------------------------------------------------------

    def _ask_result(self, handle: ClientGoalHandle) -> Future:
        key = bytes(handle.goal_id.uuid)
        request = self.action_type.Impl.GetResultService.Request()
        request.goal_id = handle.goal_id
        future = self._get_result.call_async(request)
        if not future.done():
            handle._results += 1
            self._goals[key] = handle

        def answered(future: Future) -> None:
            handle._results -= 1
            if future.exception() is None:
                status = future.result().status
                if status != UNKNOWN:
                    handle.status = status
                self._goals.pop(key, None)

        if not future.done():
            future.add_done_callback(answered)
        return future

    def _cancel(self, goal_id: "Any", stamp: "Any") -> Future:
        request = self.action_type.Impl.CancelGoalService.Request()
        if goal_id is not None:
            request.goal_info.goal_id = goal_id
        if stamp is not None:
            request.goal_info.stamp = stamp
        return self._cancel_goal.call_async(request)

    # --- feedback and status ------------------------------------------------------------------

    def _on_feedback(self, message: "Any") -> None:
        handle = self._goals.get(bytes(message.goal_id.uuid))
        if handle is not None and handle._feedback_callback is not None:
            handle._feedback_callback(message)

    def _on_status(self, message: "Any") -> None:
        for goal_status in message.status_list:
            key = bytes(goal_status.goal_info.goal_id.uuid)
            handle = self._goals.get(key)
            if handle is not None:
                handle.status = goal_status.status
                if goal_status.status >= SUCCEEDED and not handle._results and handle.accepted:
                    del self._goals[key]  # no more messages, unless the result is requested


def random_uuid() -> bytes:
    """Return 16 random octets."""
    try:
        from os import urandom

        return urandom(16)
    except ImportError:
        from random import getrandbits

        return bytes([getrandbits(8) for _ in range(16)])
