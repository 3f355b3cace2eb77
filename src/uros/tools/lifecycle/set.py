"""``uros lifecycle set``: trigger a transition of a node."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from typing import Any

from ...printable import printable
from ..common import add_served_node, join
from ..errors import ToolError, did_you_mean
from .node import call, described, find_lifecycle_node, states


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of ``uros lifecycle set``."""
    add_served_node(parser)
    parser.add_argument(
        "transition", metavar="TRANSITION",
        help="label or number of the transition, such as configure; 'uros lifecycle list NODE'"
        " lists them",
    )  # fmt: skip


def run(args: argparse.Namespace) -> int:
    """Trigger a transition.

    Returns:
        1 if it has failed, else 0.

    Raises:
        ToolError: There is no such node, it has no life cycle, it does not answer, or its state
            does not allow the transition.
    """
    with join(args) as network:
        node = find_lifecycle_node(network, args)
        answer = call(network, node, "get_available_transitions", args.timeout)
        transitions = [each.transition for each in answer.available_transitions]
        chosen = _chosen(args.transition, transitions)
        if chosen is None:
            state = states(network, [node], args.timeout)[node]
            now = "" if isinstance(state, ToolError) else f" in the state {described(state)}"
            possible = ", ".join(map(described, transitions)) or "none"
            close = did_you_mean(args.transition, [printable(each.label) for each in transitions])
            raise ToolError(
                f"{node} has no transition {args.transition!r}{now}; possible: {possible}{close}"
            )
        changed = call(network, node, "change_state", args.timeout, transition=chosen).success
    if changed:
        print("Transitioning successful")
        return 0
    print("Transitioning failed", file=sys.stderr)
    return 1


def _chosen(wanted: str, transitions: Sequence[Any]) -> Any:
    """Return the transition with this label, or else with this number; None if there is none."""
    labels = {each.label: each for each in reversed(transitions)}
    numbers = {str(each.id): each for each in transitions}
    return labels.get(wanted) or numbers.get(wanted)
