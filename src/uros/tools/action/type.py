"""``uros action type``: print the type of an action."""

from __future__ import annotations

import argparse

from ..common import add_action, add_common, discover, join, remedy
from ..errors import ToolError
from ..listing import add_json, print_json


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of ``uros action type``."""
    add_action(parser)
    add_common(parser)
    add_json(parser)


def run(args: argparse.Namespace) -> int:
    """Print the type of an action.

    Raises:
        ToolError: There is no such action.
    """
    with join(args) as network:
        discover(network, args)
        known = network.graph.actions()
        if args.action not in known:
            raise ToolError(
                f"there is no action {args.action!r}{remedy(network, args.action, known)}"
            )
    if args.json:
        print_json(known[args.action])
        return 0
    for type_name in known[args.action]:
        print(type_name)
    return 0
