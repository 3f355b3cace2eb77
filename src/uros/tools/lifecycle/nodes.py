"""``uros lifecycle nodes``: list the nodes with a life cycle."""

from __future__ import annotations

import argparse

from ..common import add_common, discover, join
from ..empty import explain_empty_list
from ..listing import add_json, print_json
from .node import lifecycle_nodes


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of ``uros lifecycle nodes``."""
    add_common(parser)
    parser.add_argument(
        "-a", "--all", action="store_true", help="list hidden nodes too, whose names begin with _"
    )
    parser.add_argument(
        "-c", "--count-nodes", action="store_true", help="print only how many nodes there are"
    )
    add_json(parser)


def run(args: argparse.Namespace) -> int:
    """Print the nodes."""
    with join(args) as network:
        discover(network, args)
        nodes = list(dict.fromkeys(lifecycle_nodes(network, args.all)))
        if not nodes:
            explain_empty_list(network)
    if args.count_nodes:
        print(len(nodes))
    elif args.json:
        print_json([{"name": name} for name in nodes])
    else:
        for name in nodes:
            print(name)
    return 0
