"""``uros board stubs``: write type stubs for editors."""

from __future__ import annotations

import argparse
import shlex
from pathlib import Path
from typing import Final

from ..common import add_interfaces, know_interfaces
from ..errors import ToolError
from .board_option import add_board_option, chosen_board

_EPILOG: Final = """\
An editor, mypy or pyright then knows the fields of messages in programs for boards. The stubs of
MicroPython itself (machine, network, time.sleep_ms) are packages of PyPI, one for each port; this
command prints how to install those into the same folder.

examples:

  uros board stubs typings --board pico_w
  uros board stubs typings --interfaces my_msgs
"""
# The packages of PyPI; renesas-ra has none, and its machine module is derived from that of stm32.
_PACKAGES: Final = {
    "esp32": "micropython-esp32-stubs",
    "rp2": "micropython-rp2-stubs",
    "stm32": "micropython-stm32-stubs",
    "renesas-ra": "micropython-stm32-stubs",
}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of ``uros board stubs``."""
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    parser.epilog = _EPILOG
    parser.add_argument(
        "folder", metavar="FOLDER", nargs="?", default="typings",
        help="folder of stubs; other files in it stay (default: typings, where Pylance looks)",
    )  # fmt: skip
    add_board_option(parser)
    add_interfaces(parser)


def run(args: argparse.Namespace) -> int:
    """Write the stubs and print the next step.

    Raises:
        InterfaceError: A definition is wrong.
        ToolError: The board is unknown, or the stubs cannot be written.
    """
    from ...interfaces.stubs import write_stubs

    board = chosen_board(args)
    know_interfaces(args)
    folder = Path(args.folder)
    try:
        packages = write_stubs(folder)
    except OSError as error:
        raise ToolError(f"{error.filename or folder}: {error.strerror or error}") from error
    stubs = _PACKAGES[board.port] if board else "micropython-esp32-stubs"
    print(f"{folder}: stubs of {len(packages)} packages of messages")
    print("\nNext, the stubs of MicroPython, those of your board's port, such as:\n")
    print(f"  python -m pip install --target {shlex.quote(str(folder))} {stubs}")
    return 0
