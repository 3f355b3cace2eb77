"""``uros topic type``: print the type of a topic."""

from __future__ import annotations

import argparse

from ..common import add_common, add_topic
from ..graph_types import print_types
from ..listing import add_json
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
    return print_types(args, "topic", args.topic, lambda graph: graph.topics())
