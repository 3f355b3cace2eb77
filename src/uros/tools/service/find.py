"""``uros service find``"""

from __future__ import annotations

import argparse

from ..common import add_common, join
from .list import add_hidden, services


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("type", metavar="TYPE", help="type of services: std_srvs/srv/Trigger")
    add_common(parser)
    add_hidden(parser)
    parser.add_argument(
        "-c", "--count-services", action="store_true", help="print only how many services there are"
    )


def run(args: argparse.Namespace) -> int:
    package, _, name = args.type.partition("/")
    wanted = args.type if "/" in name else f"{package}/srv/{name}"
    with join(args) as network:
        found = [one for one, types in services(network, args).items() if wanted in types]
    if args.count_services:
        print(len(found))
    else:
        for one in found:
            print(one)
    return 0
