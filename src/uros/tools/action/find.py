"""``uros action find``: list actions of a type."""

from __future__ import annotations

import argparse

from ..common import add_common, discover, join
from ..empty import explain_empty_list, explain_unknown_type
from ..listing import add_json, entries, print_json


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of ``uros action find``."""
    parser.add_argument(
        "type", metavar="TYPE", help="type of the actions, such as test_msgs/action/Fibonacci"
    )
    add_common(parser)
    parser.add_argument(
        "-c", "--count-actions", action="store_true", help="print only how many actions there are"
    )
    add_json(parser)


def run(args: argparse.Namespace) -> int:
    """Print the actions of a type."""
    package, _, name = args.type.partition("/")
    wanted = args.type if "/" in name else f"{package}/action/{name}"
    with join(args) as network:
        discover(network, args)
        listed = network.graph.actions()
        matches = {action: types for action, types in listed.items() if wanted in types}
        if not matches:
            explain_empty_list(network)
            explain_unknown_type(wanted, listed.values())
    if args.count_actions:
        print(len(matches))
    elif args.json:
        print_json(entries(matches))
    else:
        for action in matches:
            print(action)
    return 0
