"""``uros service find``: list services of a type."""

from __future__ import annotations

import argparse

from ..common import add_common, join
from ..empty import explain_empty_list, explain_unknown_type
from ..listing import add_json, entries, print_json
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
    package, _, name = args.type.partition("/")
    wanted = args.type if "/" in name else f"{package}/srv/{name}"
    with join(args) as network:
        listed = services(network, args)
        matches = {service: types for service, types in listed.items() if wanted in types}
        if not matches:
            explain_empty_list(network)
            explain_unknown_type(wanted, listed.values())
    if args.count_services:
        print(len(matches))
    elif args.json:
        print_json(entries(matches))
    else:
        for service in matches:
            print(service)
    return 0
