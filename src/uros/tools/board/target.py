"""``--board``: the board that a program is for, one of `uros.boards.deploy.known_boards`."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING

from ..errors import ToolError, did_you_mean

if TYPE_CHECKING:
    from ...boards.deploy.known_boards import NamedBoard


def add_named(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--board", metavar="BOARD",
        help="the board that it is for, such as pico_w ('uros board list --ports' has them): one"
        " that cannot run it is refused",
    )  # fmt: skip


def named(args: argparse.Namespace) -> NamedBoard | None:
    """The board of ``--board``. Raises ToolError for one without MicroPython, or unknown."""
    if args.board is None:
        return None
    from ...boards.deploy.known_boards import NAMED, find

    board = find(args.board)
    if board is None:
        close = did_you_mean(args.board, NAMED) or f" (there are {', '.join(NAMED)})"
        raise ToolError(f"no board {args.board!r} is known{close}; without --board any is tried")
    if not board.port:
        raise ToolError(f"{board.title} ({board.mcu}) cannot run this: {board.note}")
    return board


def print_ports() -> None:
    """A table of boards to buy."""
    from ...boards.deploy.known_boards import NAMED

    rows = [("BOARD", "MCU", "RAM", "MICROPYTHON", "WHICH IS")]
    rows += [
        (it.name, it.mcu, it.ram, f"{it.port}, {it.image}" if it.port else "none", it.title)
        for it in NAMED.values()
    ]
    widths = [max(len(row[at]) for row in rows) for at in range(4)]
    for *row, title in rows:
        columns = [text.ljust(width) for text, width in zip(row, widths, strict=True)]
        print("  ".join([*columns, title]))
    print()
    for it in NAMED.values():
        if not it.port:
            print(f"{it.name}: {it.note}.\n")
    print("docs/ports.md has the first steps for each.")
