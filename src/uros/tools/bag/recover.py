"""``uros bag recover``: finish a bag whose recording was cut off."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING

from .arguments import add_bag

if TYPE_CHECKING:
    from ...bag.recover import RecoveredFile


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of ``uros bag recover``."""
    add_bag(parser)


def run(args: argparse.Namespace) -> int:
    """Recover the files and print what became of each."""
    from ...bag.recover import recover

    for result in recover(args.bag_path, args.storage):
        for line in report(result):
            print(line)
    return 0


def report(result: RecoveredFile) -> list[str]:
    """Return what to print about a file."""
    name = result.path.name
    if not result.rewritten:
        return [f"{name}: whole, {result.kept} messages"]
    lines = [f"{name}: finished, {result.kept} messages kept"]
    if result.original is not None:
        lost = []
        if result.lost_bytes:
            lost.append(f"{result.lost_bytes} bytes cannot be read")
        if result.lost_messages:
            lost.append(f"at least {result.lost_messages} messages are lost")
        lines.append(f"{name}: {', '.join(lost)}; the original is {result.original.name}")
    return lines
