"""``uros interface packages``: list packages with interface types."""

from __future__ import annotations

import argparse

from ..common import add_interfaces, know_interfaces
from .list import add_kinds, kinds


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of ``uros interface packages``."""
    add_kinds(parser)
    add_interfaces(parser)


def run(args: argparse.Namespace) -> int:
    """Print the packages that have interface types."""
    from ...interfaces import registry

    know_interfaces(args)
    for name in registry.packages(kinds(args)):
        print(name)
    return 0
