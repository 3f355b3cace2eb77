"""``uros node info``: print information about a node."""

from __future__ import annotations

import argparse
import sys

from ..common import add_common, add_node, discover, join, remedy
from ..errors import ToolError
from ..listing import add_json, entries, print_json


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of ``uros node info``."""
    add_node(parser)
    add_common(parser)
    parser.add_argument(
        "--include-hidden",
        action="store_true",
        help="print hidden topics, services and actions too, which have a part that begins with _,"
        " and those of a hidden node, whose name begins with _",
    )
    add_json(parser)


def run(args: argparse.Namespace) -> int:
    """Print what a node publishes, subscribes to, serves and calls.

    Raises:
        ToolError: There is no such node, or it is hidden.
    """
    from ... import names

    name = names.absolute(args.node)
    with join(args) as network:
        discover(network, args)
        nodes = network.graph.nodes()
        info = network.graph.node(name)
        if info is None:
            raise ToolError(f"there is no node {name!r}{remedy(network, name, nodes)}")
        if not args.include_hidden and names.is_hidden_node(name):
            raise ToolError(f"the node {name!r} is hidden: --include-hidden prints it")
    if nodes.count(name) > 1:
        print(
            f"WARNING: {nodes.count(name)} nodes have the name {name!r}; this is one of them",
            file=sys.stderr,
        )
    sections = {
        title: {
            of: types
            for of, types in belongings.items()
            if args.include_hidden or not names.is_hidden(of)
        }
        for title, belongings in (
            ("Subscribers", info.subscribers),
            ("Publishers", info.publishers),
            ("Service Servers", info.service_servers),
            ("Service Clients", info.service_clients),
            ("Action Servers", info.action_servers),
            ("Action Clients", info.action_clients),
        )
    }
    if args.json:
        keys = {title.lower().replace(" ", "_"): entries(of) for title, of in sections.items()}
        print_json({"name": name, **keys})
        return 0
    print(name)
    for title, belongings in sections.items():
        print(f"  {title}:")
        lines = [f"    {of}: {', '.join(types)}" for of, types in belongings.items()]
        print("\n".join(lines))  # an empty section is an empty line, as in ros2
    return 0
