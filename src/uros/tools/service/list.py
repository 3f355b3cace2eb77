"""``uros service list``: list services."""

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
    """Declare the arguments of ``uros service list``."""
    add_common(parser)
    add_hidden(parser)
    parser.add_argument("-t", "--show-types", action="store_true", help="print the types too")
    parser.add_argument(
        "-c", "--count-services", action="store_true", help="print only how many services there are"
    )
    add_json(parser)


def add_hidden(parser: argparse.ArgumentParser) -> None:
    """Declare ``--include-hidden-services``, which :func:`services` applies."""
    parser.add_argument(
        "--include-hidden-services",
        action="store_true",
        help="list hidden services too, which have a part that begins with _",
    )


def services(network: Network, args: argparse.Namespace) -> NamesAndTypes:
    """Discover the services and return their types. As in ros2, a client alone makes a service."""
    from ...names import is_hidden

    discover(network, args)
    return {
        name: types
        for name, types in network.graph.services().items()
        if args.include_hidden_services or not is_hidden(name)
    }


def run(args: argparse.Namespace) -> int:
    """Print the services of the domain."""
    with join(args) as network:
        found = services(network, args)
        if not found:
            explain_empty_list(network)
    if args.count_services:
        print(len(found))
        return 0
    if args.json:
        print_json(entries(found))
        return 0
    for name, types in found.items():
        print(f"{name} [{', '.join(types)}]" if args.show_types else name)
    return 0
