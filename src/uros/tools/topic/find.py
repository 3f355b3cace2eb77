"""``uros topic find``: list topics of a type."""

from __future__ import annotations

import argparse

from ..common import add_common
from ..graph_types import print_names_of_type
from ..listing import add_json
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
    return print_names_of_type(
        args, "msg", lambda network: visible_topics(network, args), args.count_topics
    )
