"""``uros service type``: print the type of a service."""

from __future__ import annotations

import argparse

from ..common import add_common, add_service, discover, join, remedy
from ..errors import ToolError
from ..listing import add_json, print_json


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of ``uros service type``."""
    add_service(parser)
    add_common(parser)
    add_json(parser)


def run(args: argparse.Namespace) -> int:
    """Print the type of a service.

    Raises:
        ToolError: There is no such service.
    """
    with join(args) as network:
        discover(network, args)
        known = network.graph.services()
        if args.service not in known:
            raise ToolError(
                f"there is no service {args.service!r}{remedy(network, args.service, known)}"
            )
    if args.json:
        print_json(known[args.service])
        return 0
    for type_name in known[args.service]:
        print(type_name)
    return 0
