"""``uros service find``: list services of a type."""

from __future__ import annotations

import argparse

from ..common import add_common
from ..graph_types import print_names_of_type
from ..listing import add_json
from .list import add_hidden, services


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of ``uros service find``."""
    parser.add_argument(
        "type", metavar="TYPE", help="type of the services, such as std_srvs/srv/Trigger"
    )
    add_common(parser)
    add_hidden(parser)
    parser.add_argument(
        "-c", "--count-services", action="store_true", help="print only how many services there are"
    )
    add_json(parser)


def run(args: argparse.Namespace) -> int:
    """Print the services of a type."""
    return print_names_of_type(
        args, "srv", lambda network: services(network, args), args.count_services
    )
