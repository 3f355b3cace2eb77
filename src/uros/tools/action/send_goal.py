"""``uros action send_goal``: send a goal, and print its result.

Ctrl-C asks the server to cancel the goal, and waits for its end; Ctrl-C again leaves at once.
"""

from __future__ import annotations

import argparse
import sys
import time
from typing import TYPE_CHECKING, Any, Final

from ..common import add_action, add_common, join, unsigned_float
from ..errors import ToolError
from ..graph_types import only_type
from ..values import plain
from ..values.fill import Filled
from ..values.typed_values import add_type_and_values, load_action, type_and_text
from ..values.yaml_text import dump
from ..waiting import warn
from .goal import Goal, wait_for_server

if TYPE_CHECKING:
    from ...host.network import Network

# By number, as in action_msgs/msg/GoalStatus.
_STATES: Final = (
    "UNKNOWN", "ACCEPTED", "EXECUTING", "CANCELING", "SUCCEEDED", "CANCELED", "ABORTED",
)  # fmt: skip
# Return codes of action_msgs/srv/CancelGoal. rclpy refuses by 0 without a goal that is canceled.
_UNKNOWN_GOAL: Final = 2
_TERMINATED: Final = 3
# Seconds for the answer to a goal that is to be canceled at once.
_PATIENCE: Final = 5.0
_INTERRUPTED: Final = 130


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of ``uros action send_goal``."""
    add_action(parser)
    add_type_and_values(parser, "test_msgs/action/Fibonacci", "action")
    add_common(parser)
    parser.add_argument("-f", "--feedback", action="store_true", help="print the feedback too")
    parser.add_argument(
        "-t", "--timeout", metavar="S", type=unsigned_float,
        help="seconds to wait for a server, for its answer and for the result; exit status 1 if one"
        " does not come, and the goal goes on; 0 leaves as soon as the goal is accepted"
        " (default: no limit)",
    )  # fmt: skip


def run(args: argparse.Namespace) -> int:
    """Send a goal and print its end. As in ros2, a goal that was refused is a normal end.

    Raises:
        ToolError: There is no server, it does not answer, or it left.
    """
    type_name, text = type_and_text(args)
    with join(args) as network:
        kind = load_action(type_name) if type_name else None
        filled = Filled(kind.Goal, text) if kind else None
        _say("Waiting for an action server to become available...")
        types = wait_for_server(network, args.action, args.timeout or None)
        if kind is None:
            kind = load_action(only_type("action send_goal", args.action, types))
        if kind._TYPE not in types:
            raise ToolError(f"{args.action} is {' and '.join(types)}, not {kind._TYPE}")
        filled = filled or Filled(kind.Goal, text)
        filled.stamp(time.time_ns())
        return _send(network, args, kind, filled.message)


def _send(network: Network, args: argparse.Namespace, kind: Any, message: Any) -> int:
    longest = args.timeout or None
    feedback = _Feedback() if args.feedback else None
    with Goal(network, args.action, kind, feedback) as goal:
        goal.match(longest)
        _say(f"Sending goal:\n     {_yaml(message)}")
        try:
            goal.send(message)
            if not goal.is_accepted(longest):
                _say("Goal was rejected.")
                return 0
            _say(f"Goal accepted with ID: {goal.id.hex()}\n")
            if feedback is not None:
                feedback.begin()
            if args.timeout != 0:
                _print_end(goal.result(longest))
            return 0
        except KeyboardInterrupt:
            if not goal.is_sent:
                raise
            return _cancel(goal)


def _cancel(goal: Goal) -> int:
    """Cancel the goal, and wait for its end.

    Raises:
        ToolError: The goal is not canceled.
    """
    try:
        _say("Canceling goal...")
        if not goal.is_accepted(_PATIENCE):  # Ctrl-C came before the server's answer
            _say("Goal was rejected.")
            return _INTERRUPTED
        response = goal.cancel()
        if response.goals_canceling:
            _say("Goal canceled.")
        elif response.return_code == _UNKNOWN_GOAL:
            raise ToolError("the goal is not canceled: the server does not know it, or no longer")
        elif response.return_code != _TERMINATED:
            raise ToolError("the goal is not canceled: the server refuses, and the goal goes on")
        _print_end(goal.result(None))
    except KeyboardInterrupt:
        warn("left before the end of the goal, which may go on")
        raise
    return _INTERRUPTED


class _Feedback:
    """Prints feedback, which may come before the server's answer to the goal, after that answer."""

    def __init__(self) -> None:
        self._early: list[Any] | None = []

    def __call__(self, message: Any) -> None:
        if self._early is None:
            _say(f"Feedback:\n    {_yaml(message)}")
        else:
            self._early.append(message)

    def begin(self) -> None:
        """Print what has come, and from now on at once."""
        early, self._early = self._early, None
        for message in early or []:
            self(message)


def _print_end(response: Any) -> None:
    status = response.status
    name = _STATES[status] if 0 <= status < len(_STATES) else _STATES[0]
    _say(f"Result:\n    {_yaml(response.result)}")
    _say(f"Goal finished with status: {name}")


def _yaml(message: Any) -> str:
    return dump(plain.plain(message, plain.Show(None)))


def _say(text: str) -> None:
    sys.stdout.write(text + "\n")
    sys.stdout.flush()
