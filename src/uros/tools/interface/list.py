"""``uros interface list``: list interface types."""

from __future__ import annotations

import argparse
from typing import Final

from ..common import add_interfaces, know_interfaces
from ..listing import add_json, print_json

_TITLES: Final = {"msg": "Messages:", "srv": "Services:", "action": "Actions:"}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of ``uros interface list``."""
    add_kinds(parser)
    add_interfaces(parser)
    add_json(parser)


def run(args: argparse.Namespace) -> int:
    """Print the known interface types."""
    from ...interfaces import list_types

    know_interfaces(args)
    names = list_types()
    if args.json:
        print_json([name for name in names if name.split("/")[1] in kinds(args)])
        return 0
    for kind in kinds(args):
        print(_TITLES[kind])
        for name in names:
            if name.split("/")[1] == kind:
                print(f"    {name}")
    return 0


def add_kinds(parser: argparse.ArgumentParser) -> None:
    """Declare ``-m``, ``-s`` and ``-a``, which choose kinds of types."""
    for letter, kind, what in (
        ("m", "msg", "messages"),
        ("s", "srv", "services"),
        ("a", "action", "actions"),
    ):
        parser.add_argument(
            f"-{letter}", f"--only-{kind}s", dest="kinds", action="append_const", const=kind,
            help=f"list only {what}",
        )  # fmt: skip


def kinds(args: argparse.Namespace) -> list[str]:
    """Return the chosen kinds, or all, in the order in which they are printed."""
    return [kind for kind in _TITLES if not args.kinds or kind in args.kinds]
