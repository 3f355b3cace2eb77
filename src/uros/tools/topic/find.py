"""``uros topic find``: list topics of a type."""

from __future__ import annotations

import argparse

from ..common import add_common, join
from ..empty import explain_empty_list, explain_unknown_type
from ..listing import add_json, entries, print_json
from ..sim_time import add_use_sim_time
from .list import add_hidden, visible_topics


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of ``uros topic find``."""
    parser.add_argument(
        "type", metavar="TYPE", help="type of the topics, such as std_msgs/msg/String"
    )
    add_common(parser)
    add_use_sim_time(parser, used=False)
    parser.add_argument(
        "-c", "--count-topics", action="store_true", help="print only how many topics there are"
    )
    add_hidden(parser)
    add_json(parser)


def run(args: argparse.Namespace) -> int:
    """Print the topics of a type."""
    package, slash, name = args.type.partition("/")
    wanted = f"{package}/msg/{name}" if slash and "/" not in name else args.type
    with join(args) as network:
        topics = visible_topics(network, args)
        matches = {topic: types for topic, types in topics.items() if wanted in types}
        if not matches:
            explain_empty_list(network)
            explain_unknown_type(wanted, topics.values())
    if args.count_topics:
        print(len(matches))
    elif args.json:
        print_json(entries(matches))
    else:
        for topic in matches:
            print(topic)
    return 0
