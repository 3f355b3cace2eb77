"""``uros node list``: list nodes."""

from __future__ import annotations

import argparse
import sys
from typing import TYPE_CHECKING

from ..common import add_common, discover, join
from ..empty import explain_empty_list
from ..listing import add_json, print_json

if TYPE_CHECKING:
    from ...host.network import Network


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of ``uros node list``."""
    add_common(parser)
    parser.add_argument(
        "-a", "--all", action="store_true", help="list hidden nodes too, whose names begin with _"
    )
    parser.add_argument(
        "-c", "--count-nodes", action="store_true", help="print only how many nodes there are"
    )
    add_json(parser)


def visible_nodes(network: Network, include_hidden: bool) -> list[str]:
    """Return the full names of the discovered nodes, sorted; a name may occur more than once.

    Args:
        network: The domain.
        include_hidden: Whether nodes count whose names begin with ``_``.
    """
    from ...names import is_hidden_node

    return [name for name in network.graph.nodes() if include_hidden or not is_hidden_node(name)]


def run(args: argparse.Namespace) -> int:
    """Print the nodes of the domain."""
    with join(args) as network:
        discover(network, args)
        nodes = visible_nodes(network, args.all)
        if not nodes:
            explain_empty_list(network)
    if args.count_nodes:
        print(len(nodes))
        return 0
    if len(set(nodes)) < len(nodes):
        print(
            "WARNING: some nodes have the same name; what is sent to one of them may reach another",
            file=sys.stderr,
        )
    if args.json:
        print_json([{"name": name} for name in nodes])
        return 0
    for name in nodes:
        print(name)
    return 0
