"""``uros action info``: print information about an action."""

from __future__ import annotations

import argparse

from ..common import add_action, add_common, discover, join, remedy
from ..listing import add_json, entries, print_json
from ..waiting import warn


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of ``uros action info``."""
    add_action(parser)
    add_common(parser)
    parser.add_argument("-t", "--show-types", action="store_true", help="print the types too")
    parser.add_argument(
        "-c", "--count", action="store_true",
        help="print only how many action clients and servers there are",
    )  # fmt: skip
    add_json(parser)


def run(args: argparse.Namespace) -> int:
    """Print the clients and servers of an action. As in ros2, it need not have any."""
    with join(args) as network:
        discover(network, args)
        graph = network.graph
        known = graph.actions()
        nodes = {
            what: graph.action_nodes(args.action, what == "clients")
            for what in ("clients", "servers")
        }
        if args.action not in known:
            warn(f"there is no action {args.action}{remedy(network, args.action, known)}")
    if args.json:
        listed = {what: entries(dict(found)) for what, found in nodes.items()}
        print_json({"name": args.action, "types": known.get(args.action, []), **listed})
        return 0
    print(f"Action: {args.action}")
    for what, found in nodes.items():
        print(f"Action {what}: {len(found)}")
        if not args.count:
            for name, types in found:
                print(f"    {name} [{', '.join(types)}]" if args.show_types else f"    {name}")
    return 0
