"""``uros interface proto``: print a prototype of a message as YAML."""

from __future__ import annotations

import argparse

from ..common import add_interfaces, add_type, know_interfaces
from ..values import plain


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of ``uros interface proto``."""
    add_type(parser)
    parser.add_argument(
        "--no-quotes", action="store_true", help="do not print quotes around the message"
    )
    add_interfaces(parser)


def run(args: argparse.Namespace) -> int:
    """Print a prototype of a message."""
    from ...interfaces import load
    from ..values.yaml_text import dump

    know_interfaces(args)
    found = load(args.type)
    if not plain.is_message(found):  # of a service print the request, of an action the goal
        found = found.Request if hasattr(found, "Request") else found.Goal
    text = dump(plain.plain(found(), plain.Show(truncate=None)))
    print(text if args.no_quotes else f'"{text}"')
    return 0
