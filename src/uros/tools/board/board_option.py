"""The option ``--board``: the real board that a program is for."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING

from ..errors import ToolError, did_you_mean

if TYPE_CHECKING:
    from ...boards.deploy.known_boards import NamedBoard


def add_board_option(parser: argparse.ArgumentParser) -> None:
    """Declare ``--board``."""
    parser.add_argument(
        "--board", metavar="BOARD",
        help="the board that the program is for, such as pico_w; 'uros board list --ports' lists"
        " them. A board that cannot run it is refused",
    )  # fmt: skip


def chosen_board(args: argparse.Namespace) -> NamedBoard | None:
    """Return the board of ``--board``, one of `uros.boards.deploy.known_boards`.

    Raises:
        ToolError: The board is unknown, or has no MicroPython.
    """
    if args.board is None:
        return None
    from ...boards.deploy.known_boards import NAMED, find

    board = find(args.board)
    if board is None:
        close = did_you_mean(args.board, NAMED) or f" (there are {', '.join(NAMED)})"
        raise ToolError(
            f"unknown board {args.board!r}{close} (without --board any board is accepted)"
        )
    if not board.port:
        raise ToolError(f"{board.title} ({board.mcu}) cannot run this: {board.note}")
    return board
