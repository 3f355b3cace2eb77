"""``uros interface proto``"""

from __future__ import annotations

import argparse

from . import values
from .common import add_interfaces, add_type, know_interfaces


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_type(parser)
    parser.add_argument("--no-quotes", action="store_true", help="without the quotes around it")
    add_interfaces(parser)


def run(args: argparse.Namespace) -> int:
    from ..interfaces import load
    from .yaml_text import dump

    know_interfaces(args)
    found = load(args.type)
    if not values.is_message(found):  # what one sends to a service, or to an action
        found = found.Request if hasattr(found, "Request") else found.Goal
    text = dump(values.plain(found(), values.Show(truncate=None)))
    print(text if args.no_quotes else f'"{text}"')
    return 0
