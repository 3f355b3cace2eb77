"""``uros interface list``"""

from __future__ import annotations

import argparse
from typing import Final

from ..common import add_interfaces, know_interfaces

_TITLES: Final = {"msg": "Messages:", "srv": "Services:", "action": "Actions:"}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_kinds(parser)
    add_interfaces(parser)


def run(args: argparse.Namespace) -> int:
    from ...interfaces import list_types

    know_interfaces(args)
    names = list_types()
    for kind in kinds(args):
        print(_TITLES[kind])
        for name in names:
            if name.split("/")[1] == kind:
                print(f"    {name}")
    return 0


def add_kinds(parser: argparse.ArgumentParser) -> None:
    """``-m -s -a``: of which kinds; all, where none is given."""
    for letter, kind, what in (
        ("m", "msg", "messages"),
        ("s", "srv", "services"),
        ("a", "action", "actions"),
    ):
        parser.add_argument(
            f"-{letter}", f"--only-{kind}s", dest="kinds", action="append_const", const=kind,
            help=f"only {what}",
        )  # fmt: skip


def kinds(args: argparse.Namespace) -> list[str]:
    """The kinds that were asked for, in the order in which they are shown."""
    return [kind for kind in _TITLES if not args.kinds or kind in args.kinds]
