"""``uros interface packages``"""

from __future__ import annotations

import argparse

from ..common import add_interfaces, know_interfaces
from .list import add_kinds, kinds


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_kinds(parser)
    add_interfaces(parser)


def run(args: argparse.Namespace) -> int:
    from ...interfaces import registry

    know_interfaces(args)
    for name in registry.packages(kinds(args)):
        print(name)
    return 0
