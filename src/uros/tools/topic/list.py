"""``uros topic list``: list topics."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING

from ..common import add_common, discover, join
from ..empty import explain_empty_list
from ..listing import add_json, entries, print_json
from ..sim_time import add_use_sim_time

if TYPE_CHECKING:
    from ...host.graph_queries import Graph, NamesAndTypes
    from ...host.network import Network


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of ``uros topic list``."""
    add_common(parser)
    add_use_sim_time(parser, used=False)
    parser.add_argument("-t", "--show-types", action="store_true", help="print the types too")
    parser.add_argument(
        "-c", "--count-topics", action="store_true", help="print only how many topics there are"
    )
    parser.add_argument(
        "-v", "--verbose", action="store_true",
        help="print types and the number of publishers and subscribers",
    )  # fmt: skip
    add_hidden(parser)
    add_json(parser)


def add_hidden(parser: argparse.ArgumentParser) -> None:
    """Declare ``--include-hidden-topics``, which `visible_topics` reads."""
    parser.add_argument(
        "--include-hidden-topics",
        action="store_true",
        help="list hidden topics too, which have a part that begins with _",
    )


def visible_topics(network: Network, args: argparse.Namespace) -> NamesAndTypes:
    """Discover the domain; return its topics, the hidden ones only if they are asked for."""
    from ...names import is_hidden

    discover(network, args)
    return {
        name: types
        for name, types in network.graph.topics().items()
        if args.include_hidden_topics or not is_hidden(name)
    }


def run(args: argparse.Namespace) -> int:
    """Print the topics of the domain."""
    with join(args) as network:
        topics = visible_topics(network, args)
        if args.count_topics:
            print(len(topics))
        elif args.json:
            print_json(
                [
                    {
                        **entry,
                        "publishers": len(network.graph.publishers(entry["name"])),
                        "subscriptions": len(network.graph.subscriptions(entry["name"])),
                    }
                    for entry in entries(topics)
                ]
            )
        elif args.verbose and topics:
            print(_section(network.graph, topics, True))
            print(_section(network.graph, topics, False))
        else:
            for name, types in topics.items():
                print(f"{name} [{', '.join(types)}]" if args.show_types else name)
        if not topics:
            explain_empty_list(network)
    return 0


def _section(graph: Graph, topics: NamesAndTypes, published: bool) -> str:
    lines = ["Published topics:" if published else "Subscribed topics:"]
    for name, types in topics.items():
        count = len(graph.publishers(name) if published else graph.subscriptions(name))
        if count:
            what = ("publisher" if published else "subscriber") + "s" * (count > 1)
            lines.append(f" * {name} [{', '.join(types)}] {count} {what}")
    return "\n".join(lines) + "\n"
