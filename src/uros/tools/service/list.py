"""``uros service list``"""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING

from ..common import add_common, discover, join

if TYPE_CHECKING:
    from ...host.graph import NamesAndTypes
    from ...host.network import Network


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_common(parser)
    add_hidden(parser)
    parser.add_argument("-t", "--show-types", action="store_true", help="show the types as well")
    parser.add_argument(
        "-c", "--count-services", action="store_true", help="print only how many services there are"
    )


def add_hidden(parser: argparse.ArgumentParser) -> None:
    """``--include-hidden-services``, for :func:`services`."""
    parser.add_argument(
        "--include-hidden-services",
        action="store_true",
        help="services with a part that begins with _ as well",
    )


def services(network: Network, args: argparse.Namespace) -> NamesAndTypes:
    """Discover, and the services with their types; as in ros2, also those that are only asked."""
    from ...names import is_hidden

    discover(network, args)
    return {
        name: types
        for name, types in network.graph.services().items()
        if args.include_hidden_services or not is_hidden(name)
    }


def run(args: argparse.Namespace) -> int:
    with join(args) as network:
        found = services(network, args)
    if args.count_services:
        print(len(found))
        return 0
    for name, types in found.items():
        print(f"{name} [{', '.join(types)}]" if args.show_types else name)
    return 0
