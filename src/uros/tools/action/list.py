"""``uros action list``: list actions."""

from __future__ import annotations

import argparse

from ..common import add_common, discover, join
from ..empty import explain_empty_list
from ..listing import add_json, entries, print_json


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of ``uros action list``."""
    add_common(parser)
    parser.add_argument("-t", "--show-types", action="store_true", help="print the types too")
    parser.add_argument(
        "-c", "--count-actions", action="store_true", help="print only how many actions there are"
    )
    add_json(parser)


def run(args: argparse.Namespace) -> int:
    """Print the actions of the domain. As in ros2, a client alone makes an action."""
    with join(args) as network:
        discover(network, args)
        actions = network.graph.actions()
        if args.count_actions:
            print(len(actions))
        elif args.json:
            print_json(entries(actions))
        else:
            for name, types in actions.items():
                print(f"{name} [{', '.join(types)}]" if args.show_types else name)
        if not actions:
            explain_empty_list(network)
    return 0
