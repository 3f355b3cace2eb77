"""``uros action find``: list actions of a type."""

from __future__ import annotations

import argparse

from ..common import add_common
from ..graph_types import print_names_of_type
from ..listing import add_json
from .list import actions


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of ``uros action find``."""
    parser.add_argument(
        "type", metavar="TYPE", help="type of the actions, such as test_msgs/action/Fibonacci"
    )
    add_common(parser)
    parser.add_argument(
        "-c", "--count-actions", action="store_true", help="print only how many actions there are"
    )
    add_json(parser)


def run(args: argparse.Namespace) -> int:
    """Print the actions of a type."""
    return print_names_of_type(
        args, "action", lambda network: actions(network, args), args.count_actions
    )
