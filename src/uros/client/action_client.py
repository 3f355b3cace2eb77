"""Uses an action: sends goals, hears how they go, asks for results.

::

    client = ActionClient(node, Fibonacci, "fibonacci")

    def accepted(future):
        goal = future.result()                 # OSError: it could not be sent, or the agent is lost
        if goal.accepted:
            goal.get_result_async().add_done_callback(ended)

    def ended(future):
        answer = future.result()
        print(answer.status == GoalStatus.STATUS_SUCCEEDED, answer.result.sequence)

    client.send_goal_async(Fibonacci.Goal(7), print).add_done_callback(accepted)

A session's end fails every future that waits. Goals outlive it at their server: when
`server_is_ready` says yes again, a `ClientGoalHandle` can be asked for its result again, as long
as the server keeps that, and hears feedback.
"""

from ..ticks import ticks_add, ticks_diff
from .actions import ACCEPTED, SUCCEEDED, UNKNOWN, End
from .entities import Client, Future, Subscription

try:
    from typing import Any, Callable
except ImportError:  # MicroPython
    pass


class ClientGoalHandle:
    """A goal that was sent. ``accepted`` is None until the server has answered, ``stamp`` the
    server's time of accepting it; ``status`` is what was last heard of it.
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
        self._future: "Future | None" = None  # of its being sent
        self._results = 0  # requests for the result that wait

    def get_result_async(self) -> Future:
        """Ask for the result. The future's result has ``status`` and ``result``; it is done when
        the goal has come to its end, which may be at any time.

        A server that does not know the goal (any more) answers STATUS_UNKNOWN.
        """
        return self._client._ask_result(self)

    def cancel_goal_async(self) -> Future:
        """Ask the server to cancel it. The future's result has ``return_code``, 0 for yes, and
        ``goals_canceling``, a list of GoalInfo. The goal ends later, and may end otherwise.
        """
        return self._client._cancel(self.goal_id, None)


class ActionClient(End):
    """See the module. ``callback`` of feedback gets the FeedbackMessage, as with rclpy: what the
    server sent is its ``feedback``.
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
        # By UUID: goals that something may still be heard of.
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
        # In this order: feedback that has come before a result is told before it.
        self.made = self.parts = (
            self._send_goal, self._cancel_goal, feedback, self.states, self._get_result,
        )  # fmt: skip

    def server_is_ready(self) -> bool:
        """Whether a goal can be sent now. As far as the agent is concerned: XRCE has no way of
        asking whether somebody serves the action, so a goal may find nobody. Its future then stays
        as it is, until it is given up by `remove_pending_request`.
        """
        for part in self.parts:
            if not part.created:
                return False
        return True

    def wait_for_server(self, timeout_sec: "float | None" = None) -> bool:
        """Spin the node until `server_is_ready`, or the time is up; whether it is."""
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

        ``goal_uuid`` is a UUID message, by default of 16 random octets. TypeError: ``goal`` is
        another type; packing raises for values that do not fit.
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
        if future.done():  # it could not be sent
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
            future._result = handle  # for the callbacks behind this one

        future.add_done_callback(answered)
        return future

    def remove_pending_request(self, future: Future) -> None:
        """Wait no longer for what a future of this client, or of a goal of it, stands for."""
        for part in (self._send_goal, self._cancel_goal, self._get_result):
            part.remove_pending_request(future)
        for key in list(self._goals):
            if self._goals[key]._future is future:
                del self._goals[key]

    def cancel_all_goals_async(self) -> Future:
        """Ask the server to cancel all goals, of all its clients; see `cancel_goal_async`."""
        return self._cancel(None, None)

    def cancel_goals_before_async(self, stamp: "Any") -> Future:
        """Ask the server to cancel all goals that it accepted until this Time."""
        return self._cancel(None, stamp)

    def destroy(self) -> None:
        """Take it off the network; requests that wait for an answer fail."""
        super().destroy()
        for part in self.parts:
            part.on_lost()
        for part in self.parts:
            while isinstance(part, Client) and part.is_ready(0):
                self.attempt(part.execute, True)

    # --- for goals ----------------------------------------------------------------------------

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

    # --- what it hears ------------------------------------------------------------------------

    def _on_feedback(self, message: "Any") -> None:
        handle = self._goals.get(bytes(message.goal_id.uuid))
        if handle is not None and handle._feedback_callback is not None:
            handle._feedback_callback(message)

    def _on_status(self, message: "Any") -> None:
        for it in message.status_list:
            key = bytes(it.goal_info.goal_id.uuid)
            handle = self._goals.get(key)
            if handle is not None:
                handle.status = it.status
                if it.status >= SUCCEEDED and not handle._results and handle.accepted:
                    del self._goals[key]  # nothing more will come, unless it is asked


def random_uuid() -> bytes:
    """16 random octets."""
    try:
        from os import urandom

        return urandom(16)
    except ImportError:
        from random import getrandbits

        return bytes([getrandbits(8) for _ in range(16)])
