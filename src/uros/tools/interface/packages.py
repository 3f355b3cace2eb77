"""``uros interface packages``: list packages with interface types."""

from __future__ import annotations

import argparse

from ..common import add_interfaces, know_interfaces
from ..listing import add_json, print_json
from .list import add_kinds, kinds


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of ``uros interface packages``."""
    add_kinds(parser)
    add_interfaces(parser)
    add_json(parser)


def run(args: argparse.Namespace) -> int:
    """Print the packages that have interface types."""
    from ...interfaces import registry

    know_interfaces(args)
    packages = registry.packages(kinds(args))
    if args.json:
        print_json(packages)
        return 0
    for name in packages:
        print(name)
    return 0
