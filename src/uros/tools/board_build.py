"""``uros board build``"""

from __future__ import annotations

import argparse
import shlex
from pathlib import Path
from typing import Final

from .errors import ToolError, did_you_mean

_EPILOG: Final = """\
A program is a folder with a main.py. What it imports of uros and of ROS interfaces is written
beside it, shrunk, and nothing else.

examples:

  uros board build ra6m5_sensor_node build/ra6m5_sensor_node --mpy
  uros board build my_program build/my_program --interfaces my_msgs
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    parser.epilog = _EPILOG
    parser.add_argument(
        "program", metavar="NAME", help="see 'uros board list'; or a folder with a main.py"
    )
    parser.add_argument(
        "out", metavar="OUT", help="folder to write; what was built there before is replaced"
    )
    parser.add_argument(
        "--mpy", action="store_true",
        help="bytecode, which loads faster and takes less memory (default: text)",
    )  # fmt: skip
    parser.add_argument(
        "--interfaces", metavar="DIR", action="append", default=[],
        help="folder with .msg and .srv files to know besides; may be repeated",
    )  # fmt: skip
    parser.add_argument(
        "--no-lean", dest="lean", action="store_false",
        help="keep the words of errors, which take memory",
    )  # fmt: skip
    parser.add_argument(
        "--no-bundle", dest="bundle", action="store_false",
        help="with --mpy: a file for each module, not one for all of uros",
    )  # fmt: skip


def run(args: argparse.Namespace) -> int:
    """Build, and say what to do next. Raises ToolError and InterfaceError."""
    from ..boards.build import BuildError, build
    from ..interfaces import add_folder

    program, out = _folder(args.program), Path(args.out)
    for folder in args.interfaces:
        add_folder(folder)
    form = "mpy" if args.mpy else "py"
    try:
        files = build(program, out, form, lean=args.lean, bundle=args.mpy and args.bundle)
    except BuildError as error:
        raise ToolError(str(error)) from error
    except OSError as error:
        raise ToolError(f"{error.filename or out}: {error.strerror or error}") from error
    size = sum(file.stat().st_size for file in files)
    print(f"{out}: {len(files)} file{'s' if len(files) > 1 else ''}, {size} bytes")
    print("\nNext, with the port of the board's console in place of PORT:\n")
    print(f"  mpremote connect PORT cp -r {shlex.quote(str(out))}/* :")
    print("  mpremote connect PORT reset")
    return 0


def _folder(name: str) -> Path:
    """The program's folder. Raises ToolError."""
    from ..boards.board import BOARDS, BoardError
    from ..boards.running import firmware_folder

    if name in BOARDS:
        try:
            return firmware_folder(BOARDS[name])
        except BoardError as error:
            raise ToolError(str(error)) from error
    folder = Path(name)
    if not folder.is_dir():
        close = did_you_mean(name, BOARDS) or f" (boards are {', '.join(BOARDS)})"
        raise ToolError(f"there is no board or folder {name!r}{close}")
    if not (folder / "main.py").is_file():
        raise ToolError(f"{folder}: no main.py in it, which is what a board starts")
    return folder
