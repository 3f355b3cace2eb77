"""``uros action list``: list actions."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING

from ..common import add_common, discover, join
from ..empty import explain_empty_list
from ..listing import add_json, entries, print_json

if TYPE_CHECKING:
    from ...host.graph_queries import NamesAndTypes
    from ...host.network import Network


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of ``uros action list``."""
    add_common(parser)
    parser.add_argument("-t", "--show-types", action="store_true", help="print the types too")
    parser.add_argument(
        "-c", "--count-actions", action="store_true", help="print only how many actions there are"
    )
    add_json(parser)


def actions(network: Network, args: argparse.Namespace) -> NamesAndTypes:
    """Discover the domain and return its actions. As in ros2, a client alone makes an action."""
    discover(network, args)
    return network.graph.actions()


def run(args: argparse.Namespace) -> int:
    """Print the actions of the domain."""
    with join(args) as network:
        found = actions(network, args)
        if args.count_actions:
            print(len(found))
        elif args.json:
            print_json(entries(found))
        else:
            for name, types in found.items():
                print(f"{name} [{', '.join(types)}]" if args.show_types else name)
        if not found:
            explain_empty_list(network)
    return 0
