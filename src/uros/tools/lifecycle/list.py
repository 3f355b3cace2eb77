"""``uros lifecycle list``: list the transitions of a node."""

from __future__ import annotations

import argparse

from ...printable import printable
from ..common import add_served_node, join
from .node import call, described, find_lifecycle_node


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of ``uros lifecycle list``."""
    add_served_node(parser)
    parser.add_argument(
        "-a", "--all", action="store_true",
        help="list all transitions, not only those that the present state allows",
    )  # fmt: skip


def run(args: argparse.Namespace) -> int:
    """Print the transitions, each with its start state and its goal state.

    Raises:
        ToolError: There is no such node, it has no life cycle, or it does not answer.
    """
    service = "get_transition_graph" if args.all else "get_available_transitions"
    with join(args) as network:
        node = find_lifecycle_node(network, args)
        answer = call(network, node, service, args.timeout)
    for each in answer.available_transitions:
        print(f"- {described(each.transition)}")
        print(f"\tStart: {printable(each.start_state.label)}")
        print(f"\tGoal: {printable(each.goal_state.label)}")
    return 0
