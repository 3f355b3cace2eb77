"""``uros board list``: list virtual boards, and real ones that can run uros."""

from __future__ import annotations

import argparse
from collections.abc import Iterable
from typing import TYPE_CHECKING

from ..errors import ToolError, did_you_mean
from ..listing import add_json, print_json

if TYPE_CHECKING:
    from ...boards.virtual.hardware.board import Happening


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of ``uros board list``."""
    parser.add_argument(
        "board", metavar="NAME", nargs="?",
        help="print this board, with its actions and faults",
    )  # fmt: skip
    parser.add_argument(
        "--ports", action="store_true",
        help="list real boards: the MicroPython of each, and why some cannot run uros",
    )  # fmt: skip
    add_json(parser)


def run(args: argparse.Namespace) -> int:
    """Print a table of boards, or one board in detail.

    Raises:
        ToolError: There is no such board.
    """
    from ...boards.virtual.models.catalog import BOARDS

    if args.ports:
        _print_ports(args.json)
        return 0
    if args.board is None and args.json:
        print_json(
            [
                {"name": spec.name, "mcu": spec.mcu, "text": spec.text, "ports": spec.ports}
                for spec in BOARDS.values()
            ]
        )
        return 0
    if args.board is None:
        width = max(map(len, BOARDS))
        mcu = ""
        for spec in BOARDS.values():
            if spec.mcu != mcu:
                print(f"\n{spec.mcu}:" if mcu else f"{spec.mcu}:")
                mcu = spec.mcu
            print(f"  {spec.name:{width}}  {spec.text}")
        print("\n'uros board list --ports' lists real boards.")
        print("'uros board run NAME' runs one, 'uros board list NAME' has its actions and faults.")
        return 0
    check_name(args.board)
    _describe(args.board, args.json)
    return 0


def check_name(name: str) -> None:
    """Check the name of a virtual board.

    Raises:
        ToolError: There is no such board.
    """
    from ...boards.virtual.models.catalog import BOARDS

    if name not in BOARDS:
        from ...boards.deploy.known_boards import NAMED

        if name in NAMED:
            raise ToolError(
                f"{name!r} is a real board ('uros board list --ports' lists those), not a virtual"
                " one: 'uros board list' has the names"
            )
        close = did_you_mean(name, BOARDS) or f" (there are {', '.join(BOARDS)})"
        raise ToolError(f"there is no board {name!r}{close}")


def _describe(name: str, as_json: bool) -> None:
    from ...boards.virtual.engine.advice import uart_texts
    from ...boards.virtual.engine.runner import firmware_folder
    from ...boards.virtual.hardware.board import VirtualBoard
    from ...boards.virtual.models.catalog import BoardError, find

    spec = find(name)
    board = VirtualBoard(spec)
    try:
        try:
            folder = str(firmware_folder(spec))
        except BoardError:
            folder = f"{spec.firmware} (not installed)"
        acts, faults = board.acts(), board.faults()
        pins = [f"{pin.name} {pin.function}" for pin in board.pins.values() if pin.function]
        if as_json:
            print_json(
                {
                    "name": name, "mcu": spec.mcu, "text": spec.text, "firmware": folder,
                    "ports": spec.ports, "pins": pins, "uarts": uart_texts(board),
                    "actions": _happenings(acts), "faults": _happenings(faults),
                }
            )  # fmt: skip
            return
        print(f"{spec.name}: {spec.text}\n")
        print(f"MCU       {spec.mcu}")
        print(f"firmware  {folder}")
        print(f"ports     MicroPython for {', '.join(spec.ports)}")
        if board.uarts:
            print(f"UARTs     {'; '.join(uart_texts(board))}")
        print(f"pins      {', '.join(pins)}")
        width = max(len(happening.spec) for happening in (*acts, *faults))
        print("\nActions, typed while it runs or given with --fault:")
        for act in acts:
            print(f"  {act.spec:{width}}  {act.text}")
        print("\nFaults, likewise:")
        for fault in faults:
            print(f"  {fault.spec:{width}}  {fault.text}")
        print("PART:off clears the faults of a part, all:off all faults.")
    finally:
        board.close()


def _happenings(some: Iterable[Happening]) -> list[dict[str, str]]:
    return [{"name": happening.spec, "text": happening.text} for happening in some]


def _print_ports(as_json: bool) -> None:
    """Print a table of real boards."""
    from ...boards.deploy.known_boards import NAMED

    if as_json:
        from dataclasses import asdict

        print_json([asdict(board) for board in NAMED.values()])
        return
    rows = [("BOARD", "MCU", "RAM", "MICROPYTHON", "WHICH IS")]
    rows += [
        (
            board.name, board.mcu, board.ram,
            f"{board.port}, {board.image}" if board.port else "none", board.title,
        )
        for board in NAMED.values()
    ]  # fmt: skip
    widths = [max(len(row[at]) for row in rows) for at in range(4)]
    for *row, title in rows:
        columns = [text.ljust(width) for text, width in zip(row, widths, strict=True)]
        print("  ".join([*columns, title]))
    print()
    for board in NAMED.values():
        if not board.port:
            print(f"{board.name}: {board.note}.\n")
    print("docs/ports.md has the first steps for each.")
