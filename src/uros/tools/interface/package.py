"""``uros interface package``: list the interface types of a package."""

from __future__ import annotations

import argparse

from ..common import add_interfaces, know_interfaces
from ..errors import ToolError, did_you_mean
from ..listing import add_json, print_json
from .list import add_kinds, kinds


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of ``uros interface package``."""
    parser.add_argument("package", metavar="PACKAGE", help="name of a package, such as std_msgs")
    add_kinds(parser)
    add_interfaces(parser)
    add_json(parser)


def run(args: argparse.Namespace) -> int:
    """Print the types of a package.

    Raises:
        ToolError: The package is unknown.
    """
    know_interfaces(args)
    chosen = kinds(args)
    types = [name for name in types_of(args.package) if name.split("/")[1] in chosen]
    if args.json:
        print_json(types)
        return 0
    for name in types:
        print(name)
    return 0


def types_of(package: str) -> list[str]:
    """Return the names of a package's types.

    Raises:
        ToolError: The package is unknown.
    """
    from ...interfaces import list_types, registry

    names = [name for name in list_types() if name.startswith(package + "/")]
    if not names:
        close = did_you_mean(package, registry.packages())
        remedy = "; give the folder of its definitions with --interfaces DIR"
        raise ToolError(f"there is no package {package!r}{close or remedy}")
    return names
