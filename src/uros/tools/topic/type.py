"""``uros topic type``: print the type of a topic."""

from __future__ import annotations

import argparse

from ..common import add_common, add_topic, discover, join, remedy
from ..errors import ToolError
from ..listing import add_json, print_json
from ..sim_time import add_use_sim_time


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of ``uros topic type``."""
    add_topic(parser)
    add_common(parser)
    add_use_sim_time(parser, used=False)
    add_json(parser)


def run(args: argparse.Namespace) -> int:
    """Print the types of a topic, a line each.

    Raises:
        ToolError: There is no such topic.
    """
    with join(args) as network:
        discover(network, args)
        topics = network.graph.topics()
        if args.topic not in topics:
            raise ToolError(
                f"there is no topic {args.topic!r}{remedy(network, args.topic, topics)}"
            )
    if args.json:
        print_json(topics[args.topic])
        return 0
    for type_name in topics[args.topic]:
        print(type_name)
    return 0
