"""Action server: accepts goals, executes them, sends feedback, status and results.

::

    def fibonacci(goal):                       # a generator: the node runs between its steps
        sequence = [0, 1]
        for i in range(1, goal.request.order):
            if goal.is_cancel_requested:
                goal.canceled()
                return Fibonacci.Result(sequence)
            sequence.append(sequence[i] + sequence[i - 1])
            goal.publish_feedback(Fibonacci.Feedback(sequence))
            yield 0.5                          # half a second
        goal.succeed()
        return Fibonacci.Result(sequence)

    ActionServer(node, Fibonacci, "fibonacci", fibonacci)

A board has no threads, so long work must be split: while a callback runs, nothing else does.
``execute_callback(goal)`` may therefore be

* a function that returns the result at once;
* a generator. It yields a number to continue after as many seconds, None to continue in the next
  round of the executor, or a future, for example of a service call: ``yield`` returns its result or
  raises its error when it is done;
* a coroutine (``async def``), in which ``await Wait(...)`` is what ``yield`` is in a generator. It
  cannot await objects of asyncio;
* None. The program then ends its goals itself, from a timer or an asyncio task, by
  ``goal.succeed(result)``, ``goal.abort(result)`` or ``goal.canceled(result)``.

Goals do not end with a session: while the agent is away the server continues its work, and results
are kept for requests that come after it is back.
"""

from ..ticks import ticks_add, ticks_diff
from .actions import (
    ABORTED,
    ACCEPTED,
    CANCELED,
    CANCELING,
    EXECUTING,
    SUCCEEDED,
    CancelResponse,
    End,
    GoalResponse,
)
from .entities import Publisher, Service

try:
    from typing import Any, Callable, Final
except ImportError:  # MicroPython
    pass

# By the new state of a goal: the states from which it may be entered.
_FROM: Final = (b"", b"", b"\x01", b"\x01\x02", b"\x02\x03", b"\x03", b"\x02\x03")
_NAMES: Final = ("", "accepted", "executing", "canceling", "succeeded", "canceled", "aborted")

# Return codes of CancelGoal other than 0.
_REJECTED: Final = 1
_UNKNOWN_GOAL: Final = 2
_TERMINATED: Final = 3

# Most pending requests for the result of one goal. The limit prevents this attack: a client that
# repeats the request without end.
_MOST_ASKED: Final = 8
# Longest pause of a goal's work, and the first result timeout that means no limit, in seconds.
_LONGEST_S: Final = 500000


class Wait:
    """Awaitable for coroutines: ``Wait(seconds)``, ``Wait(None)`` or ``Wait(future)``."""

    def __init__(self, awaited: "Any") -> None:
        self.awaited = awaited

    def __await__(self) -> "Any":
        result = yield self.awaited
        return result

    __iter__ = __await__  # MicroPython awaits by __iter__


class ServerGoalHandle:
    """An accepted goal; ``request`` is the Goal message, ``goal_id`` its UUID."""

    def __init__(self, server: "ActionServer", request: "Any", goal_status: "Any") -> None:
        self.request = request
        self._server = server
        self._goal_status = goal_status  # a GoalStatus: UUID, time of acceptance and status
        self._work: "Any" = None  # the execute callback, then its generator or coroutine
        self._begun = False
        self._due = 0
        self._future: "Any" = None  # the future for which the work waits
        self._result: "_Packed | None" = None  # the answer to get_result
        self._asked: "list[bytes]" = []  # identities of pending requests for the result
        self._end = 0  # when the goal ended: the result is kept from then on

    @property
    def goal_id(self) -> "Any":
        """The UUID message of the goal."""
        return self._goal_status.goal_info.goal_id

    @property
    def status(self) -> int:
        """A state of GoalStatus."""
        status: int = self._goal_status.status
        return status

    @property
    def is_active(self) -> bool:
        """Whether the goal has not ended."""
        return self.status < SUCCEEDED

    @property
    def is_cancel_requested(self) -> bool:
        """Whether a client asked to cancel the goal and the server accepted that."""
        return self.status == CANCELING

    def execute(self, execute_callback: "Callable[[Any], Any] | None" = None) -> None:
        """Execute the goal from the next round, by default with the server's execute callback."""
        if self.status == ACCEPTED:
            self._move(EXECUTING)
        self._work = execute_callback or self._server.execute_callback
        self._begun = False
        self._due = self._server.node.clock.ms()

    def publish_feedback(self, feedback: "Any") -> bool:
        """Send a Feedback message; return False if it was dropped, as `Publisher.publish` does."""
        return self._server._feed(self, feedback)

    def succeed(self, result: "Any" = None) -> None:
        """Set the state to succeeded; without ``result`` it is what the execute callback returns.

        Raises:
            RuntimeError: The state of the goal does not allow it.
            TypeError: ``result`` is no Result message.
            ValueError: ``result`` cannot be packed.
        """
        self._move(SUCCEEDED, result)

    def abort(self, result: "Any" = None) -> None:
        """Set the state to aborted; see `succeed`."""
        self._move(ABORTED, result)

    def canceled(self, result: "Any" = None) -> None:
        """Set the state to canceled, as requested; see `succeed`."""
        self._move(CANCELED, result)

    def _may(self, status: int) -> bool:
        return self.status in _FROM[status]

    def _move(self, status: int, result: "Any" = None) -> None:
        server = self._server
        if not self._may(status):
            raise RuntimeError(
                "%s: a goal that is %s cannot become %s"
                % (server.name, _NAMES[self.status], _NAMES[status])
            )
        packed = None
        if status >= SUCCEEDED and (result is not None or self._work is None):
            packed = server._pack(status, result)
        self._goal_status.status = status
        self._end = server.node.clock.ms()
        server._say()
        if packed is not None:
            server._done(self, packed)


class _Packed:
    """A packed message, which later changes of the program's result do not affect."""

    def __init__(self, message: "Any") -> None:
        self._TYPE = message._TYPE
        self._octets = bytearray(message.cdr_size())
        message.pack_into(self._octets, 0, 0)

    def cdr_size(self, o: int = 0) -> int:
        return o + len(self._octets)

    def pack_into(self, buf: "Any", offset: int, start: int) -> int:
        end = offset + len(self._octets)
        buf[offset:end] = self._octets
        return end


class _Server(Service):
    """Service with deferred replies; ``callback(identity, request)`` returns nothing."""

    def __init__(
        self, end: "ActionServer", name: str, type: "Any",
        callback: "Callable[[bytes, Any], None]",
    ) -> None:  # fmt: skip
        self._server = end
        self._late: "list[Any]" = []  # (identity, response) not sent yet
        super().__init__(end.node, end.service(name), type, 10, callback)

    def on_lost(self) -> None:
        self._late = []
        super().on_lost()
        self._server._lost()

    def is_ready(self, now: int) -> bool:
        self._flush()
        return bool(self._queue)

    def execute(self, new: bool) -> None:
        identity, request = self._queue.pop(0)
        self.callback(identity, request)

    def reply(self, identity: bytes, response: "Any") -> None:
        self._late.append((identity, response))
        self._flush()

    def _flush(self) -> None:
        while self._late or self._answer is not None:
            if self._answer is None:
                self._answer = self._late.pop(0)
            answer = self._answer
            try:
                self._reply()
            except MemoryError:  # retried later; an empty response would be wrong
                self._answer = answer
            except Exception as error:  # the result is too long: send an empty one
                self._server.node.executor._fail(error)
                self._answer = (answer[0], self.type.Response())
                self._reply()
            if self._answer is not None:
                return


class ActionServer(End):
    """Server of an action; arguments follow rclpy. A callback that raises counts as REJECT.

    Args:
        node: The node.
        action_type: The generated class of the action.
        action_name: The action's name.
        execute_callback: See the module.
        goal_callback: Gets the Goal message and returns GoalResponse.ACCEPT or REJECT. Without it
            all goals are accepted.
        handle_accepted_callback: Gets the goal handle and decides when execution begins. Without
            it, it begins at once.
        cancel_callback: Gets the goal handle and returns CancelResponse.ACCEPT or REJECT. Without
            it all cancel requests are rejected.
        feedback_pub_qos_profile: QoS of the feedback topic.
        status_pub_qos_profile: QoS of the status topic.
        result_timeout: Seconds for which a result is kept after the end of its goal, while the
            agent is connected; negative: without limit.
        max_goals: Most goals that the server knows at a time. At the limit the oldest result is
            dropped early; if all goals are active, new ones are rejected.
    """

    def __init__(
        self,
        node: "Any",
        action_type: "Any",
        action_name: str,
        execute_callback: "Callable[[Any], Any] | None" = None,
        goal_callback: "Callable[[Any], int] | None" = None,
        handle_accepted_callback: "Callable[[Any], object] | None" = None,
        cancel_callback: "Callable[[Any], int] | None" = None,
        feedback_pub_qos_profile: "Any" = 10,
        status_pub_qos_profile: "Any" = None,
        result_timeout: float = 10,
        max_goals: int = 8,
    ) -> None:
        super().__init__(node, action_type, action_name)
        self.execute_callback = execute_callback
        self.goal_callback = goal_callback
        self.handle_accepted_callback = handle_accepted_callback
        self.cancel_callback = cancel_callback
        self.max_goals = max_goals
        self.goals: "list[ServerGoalHandle]" = []  # the known goals, the oldest first
        self._keep_ms = int(result_timeout * 1000) if 0 <= result_timeout < _LONGEST_S else -1
        self._turn = 0  # index of the goal that is executed next
        self._status_pending = False  # the status has changed and is not published yet
        self._away = False  # a session was lost, and no new one has been seen
        impl = action_type.Impl
        make = self.make
        self._send_goal: _Server = make(
            _Server, self, "send_goal", impl.SendGoalService, self._on_goal
        )
        self._cancel_goal: _Server = make(
            _Server, self, "cancel_goal", impl.CancelGoalService, self._on_cancel
        )
        self._get_result: _Server = make(
            _Server, self, "get_result", impl.GetResultService, self._on_result
        )
        self._feedback: Publisher = make(
            Publisher, node, self.topic("feedback"), impl.FeedbackMessage,
            feedback_pub_qos_profile,
        )  # fmt: skip
        self.make_states(Publisher, status_pub_qos_profile)
        self.parts = self.entities[:3]

    def destroy(self) -> None:
        """Destroy the server and close the generators that execute goals."""
        super().destroy()
        goals = self.goals
        self.goals = []
        for goal in goals:
            if goal._begun and hasattr(goal._work, "close"):
                self.attempt(goal._work.close)
            goal._work = None

    # --- as a handle of the executor --------------------------------------------------------

    def is_ready(self, now: int) -> bool:
        """Return whether a request is queued or work on a goal is due; publish a pending status."""
        if self._away and self.states.created:  # a new agent
            self._away = False
            for goal in self.goals:
                goal._end = now
        if self._status_pending and self.states.created:
            self._say()
        if super().is_ready(now):
            return True
        for goal in self.goals:
            if self._wait(goal, now) <= 0:
                return True
        return False

    def next_deadline(self) -> "int | None":
        """Return the ticks at which the next work on a goal is due, or None."""
        now = self.node.clock.ms()
        least = 0x1FFFFFFF
        for goal in self.goals:
            least = min(least, self._wait(goal, now))
        return None if least == 0x1FFFFFFF else ticks_add(now, max(0, least))

    def _wait(self, goal: ServerGoalHandle, now: int) -> int:
        """Return the milliseconds until work on a goal, or its removal, is due."""
        if goal._work is not None:
            if goal._future is None:
                return ticks_diff(goal._due, now)
            return 0 if goal._future.done() else 0x1FFFFFFF
        if goal._result is None or self._keep_ms < 0:
            return 0x1FFFFFFF
        if self._away or not self._get_result.created:  # the result cannot be requested
            return 0x1FFFFFFF
        return ticks_diff(goal._end, now) + self._keep_ms

    def execute(self, new: bool) -> None:
        """Handle a request, if there is one, and do one step of one goal, round robin."""
        self.attempt(super().execute, True)
        now = self.node.clock.ms()
        for i in range(len(self.goals)):
            goal = self.goals[(self._turn + i) % len(self.goals)]
            if self._wait(goal, now) <= 0:
                self._turn = (self._turn + i + 1) % len(self.goals)
                if goal._work is not None:
                    self._step(goal)
                else:
                    self.goals.remove(goal)
                    self._say()
                return

    # --- execution of goals -------------------------------------------------------------------

    def _step(self, goal: ServerGoalHandle) -> None:
        result = None
        try:
            if not goal._begun:
                goal._begun = True
                result = goal._work(goal)
                if result is not None and not hasattr(result, "_TYPE"):
                    goal._work = result  # a generator, or a coroutine
                    self._resume(goal)
                    return
            else:
                self._resume(goal)
                return
        except StopIteration as stop:
            result = stop.value
        except Exception as error:
            self.node.executor._fail(error)
            self._ended(goal, None, True)
            return
        self._ended(goal, result, False)

    def _resume(self, goal: ServerGoalHandle) -> None:
        future = goal._future
        goal._future = None
        error = None if future is None else future.exception()
        if error is not None:
            pause = goal._work.throw(error)
        else:
            pause = goal._work.send(None if future is None else future.result())
        if hasattr(pause, "done"):
            goal._future = pause
        else:
            wait = 0 if pause is None else int(min(pause, _LONGEST_S) * 1000)
            goal._due = ticks_add(self.node.clock.ms(), wait)

    def _ended(self, goal: ServerGoalHandle, result: "Any", reported: bool) -> None:
        """Handle the end of the execution.

        Args:
            goal: The goal.
            result: What the execute callback returned.
            reported: Whether it raised, which is reported already.
        """
        goal._work = None
        if goal._result is not None:  # passed to succeed(), abort() or canceled()
            return
        status = ABORTED if goal.is_active else goal.status
        try:
            packed = self._pack(status, result)
        except Exception as error:
            self.node.executor._fail(error)
            reported = True
            packed = self._pack(status, None)
        if not goal.is_active:
            self._done(goal, packed)
            return
        if not reported:
            self.node.executor._fail(
                RuntimeError(
                    "%s: the work on a goal ended without succeed(), abort() or canceled(): it"
                    " counts as aborted" % self.name
                )
            )
        goal._move(ABORTED, packed)

    def _pack(self, status: int, result: "Any") -> _Packed:
        """Return the packed GetResult response."""
        kind = self.action_type.Result
        if isinstance(result, _Packed):
            return result
        if result is None:
            result = kind()
        elif getattr(result, "_TYPE", None) != kind._TYPE:
            raise TypeError(
                "%s: a result is a %s, not %s"
                % (self.name, kind._TYPE, getattr(result, "_TYPE", type(result).__name__))
            )
        return _Packed(self.action_type.Impl.GetResultService.Response(status, result))

    def _done(self, goal: ServerGoalHandle, packed: _Packed) -> None:
        goal._result = packed
        asked = goal._asked
        goal._asked = []
        for identity in asked:
            self._get_result.reply(identity, packed)

    # --- status and feedback ------------------------------------------------------------------

    def _say(self) -> None:
        """Publish the states of all goals, now or as soon as they can be sent."""
        self._status_pending = True
        if self.states.created:
            self._status_pending = self.attempt(self._publish_status) is False

    def _publish_status(self) -> "Any":
        message = self.action_type.Impl.GoalStatusMessage(
            [goal._goal_status for goal in self.goals]
        )
        return self.states.publish(message)

    def _feed(self, goal: ServerGoalHandle, feedback: "Any") -> bool:
        kind = self.action_type.Feedback
        if getattr(feedback, "_TYPE", None) != kind._TYPE:
            raise TypeError("%s: feedback is a %s" % (self.name, kind._TYPE))
        message = self.action_type.Impl.FeedbackMessage(goal.goal_id, feedback)
        return self._feedback.publish(message)

    def _lost(self) -> None:
        """Drop pending requests for results and publish the status again: the session has ended."""
        self._away = True
        self._status_pending = bool(self.goals)
        for goal in self.goals:
            goal._asked = []

    # --- requests -----------------------------------------------------------------------------

    def _find(self, goal_id: "Any") -> "ServerGoalHandle | None":
        uuid = bytes(goal_id.uuid)
        for goal in self.goals:
            if bytes(goal.goal_id.uuid) == uuid:
                return goal
        return None

    def _has_room(self) -> bool:
        if len(self.goals) < self.max_goals:
            return True
        for goal in self.goals:
            if goal._result is not None and goal._work is None:
                self.goals.remove(goal)
                return True
        return False

    def _on_goal(self, identity: bytes, request: "Any") -> None:
        impl = self.action_type.Impl
        response = impl.SendGoalService.Response()
        response.accepted = (
            self._find(request.goal_id) is None
            and (
                self.goal_callback is None
                or self.attempt(self.goal_callback, request.goal) == GoalResponse.ACCEPT
            )
            and self._has_room()
        )
        goal = None
        if response.accepted:
            goal_status = impl.Status()
            goal_status.goal_info.goal_id = request.goal_id
            goal_status.status = ACCEPTED
            self.node.clock.stamp(goal_status.goal_info.stamp)
            response.stamp = goal_status.goal_info.stamp
            goal = ServerGoalHandle(self, request.goal, goal_status)
            self.goals.append(goal)
        self._send_goal.reply(identity, response)
        if goal is not None:
            self._say()
            self.attempt(self.handle_accepted_callback or ServerGoalHandle.execute, goal)

    def _on_cancel(self, identity: bytes, request: "Any") -> None:
        """Handle CancelGoal, which selects goals by id and time.

        Without both it selects all goals, with an id alone that goal, with a time the goals
        accepted until then and the goal of the id.
        """
        info = request.goal_info
        uuid = bytes(info.goal_id.uuid)
        until = (info.stamp.sec, info.stamp.nanosec)
        timed = until != (0, 0)
        has_id = uuid != bytes(16)
        response = self.action_type.Impl.CancelGoalService.Response()
        if has_id and not timed:
            response.return_code = _UNKNOWN_GOAL
        wanted = []
        for goal in self.goals:
            goal_info = goal._goal_status.goal_info
            if has_id and bytes(goal_info.goal_id.uuid) == uuid:
                if not timed:
                    response.return_code = 0 if goal._may(CANCELING) else _TERMINATED
            elif timed:
                if (goal_info.stamp.sec, goal_info.stamp.nanosec) > until:
                    continue
            elif has_id:
                continue
            if goal._may(CANCELING):
                wanted.append(goal)
        for goal in wanted:
            if (
                self.cancel_callback is not None
                and self.attempt(self.cancel_callback, goal) == CancelResponse.ACCEPT
                and goal._may(CANCELING)  # the callback may have ended it
            ):
                goal._move(CANCELING)
                response.goals_canceling.append(goal._goal_status.goal_info)
        if wanted and not response.goals_canceling:
            response.return_code = _REJECTED
        self._cancel_goal.reply(identity, response)

    def _on_result(self, identity: bytes, request: "Any") -> None:
        goal = self._find(request.goal_id)
        if goal is None:
            response = self.action_type.Impl.GetResultService.Response()
            self._get_result.reply(identity, response)  # its status is UNKNOWN
        elif goal._result is not None:
            self._get_result.reply(identity, goal._result)
        else:
            if len(goal._asked) >= _MOST_ASKED:
                goal._asked.pop(0)
            goal._asked.append(identity)
