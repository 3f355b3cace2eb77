"""``uros board build``: build a program for a board."""

from __future__ import annotations

import argparse
import shlex
from pathlib import Path
from typing import Final

from ..common import add_interfaces, know_interfaces
from ..errors import ToolError, did_you_mean
from .board_option import add_board_option, chosen_board

_EPILOG: Final = """\
A program is a folder with a main.py. The modules of uros and the ROS interfaces that it imports are
written beside it, shrunk, and nothing else.

examples:

  uros board build ra6m5_sensor_node build/ra6m5_sensor_node --mpy
  uros board build my_program build/my_program --interfaces my_msgs
  uros board build my_program build/my_program --mpy --mip

'uros board deploy' does the same and copies the files to the board.
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of ``uros board build``."""
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    parser.epilog = _EPILOG + _passes_help()
    parser.add_argument(
        "program", metavar="NAME", help="folder with a main.py, or a name of 'uros board list'"
    )
    parser.add_argument(
        "out", metavar="OUT", help="folder to write; an earlier build in it is replaced"
    )
    add_board_option(parser)
    add_build(parser)
    parser.add_argument(
        "--mip", action="store_true",
        help="also write a package.json, with which mip and 'mpremote mip' install the files",
    )  # fmt: skip
    parser.add_argument(
        "--freeze", action="store_true",
        help="also write a manifest.py, with which MicroPython's build freezes the program into a"
        " firmware",
    )  # fmt: skip


def add_build(parser: argparse.ArgumentParser) -> None:
    """Declare the options of the builder."""
    parser.add_argument(
        "--mpy", action="store_true",
        help="compile to bytecode, which loads faster and needs less memory (default: source)",
    )  # fmt: skip
    add_interfaces(parser)
    add_provided(parser)
    parser.add_argument(
        "--without", metavar="PASS", action="append", default=[],
        help="skip a pass over uros's modules; 'uros board build --help' lists them; may be"
        " repeated",
    )  # fmt: skip
    parser.add_argument(
        "--no-lean", dest="without", action="append_const", const="terse-errors",
        help="older name of --without terse-errors: keep the texts of errors",
    )  # fmt: skip
    parser.add_argument(
        "--no-bundle", dest="without", action="append_const", const="bundle",
        help="older name of --without bundle: with --mpy, one file for each module",
    )  # fmt: skip


def add_secrets(parser: argparse.ArgumentParser) -> None:
    """Declare ``--secrets``, which `read_secrets` reads."""
    parser.add_argument(
        "--secrets", metavar="FILE",
        help="Python file with names and passwords, which the board gets as its module secrets"
        " (default: secrets.py beside main.py); its content is never printed",
    )  # fmt: skip


def read_secrets(args: argparse.Namespace, folder: Path) -> bytes | None:
    """Return the content of ``--secrets``, or of secrets.py in the folder; None without one.

    Raises:
        ToolError: The file cannot be read, or is no Python.
    """
    from ...boards.builder import secrets_file
    from ...boards.builder.errors import BuildError

    file = None if args.secrets is None else Path(args.secrets)
    try:
        return secrets_file.read_secrets(folder, file)
    except BuildError as error:
        raise ToolError(str(error)) from None


def add_provided(parser: argparse.ArgumentParser) -> None:
    """Declare ``--provided``."""
    parser.add_argument(
        "--provided", metavar="MODULE", action="append", default=[],
        help="module that the board's firmware has, and whose import is no error; may be repeated",
    )  # fmt: skip


def _passes_help() -> str:
    """Return the passes that ``--without`` can skip, for an epilog."""
    from ...boards.builder.pipeline import PASSES

    lines = [
        f"  {step.name:<15} {step.purpose}{' (--mpy)' if step.bytecode else ''}" for step in PASSES
    ]
    return "\n".join(["", "passes over uros's modules, in this order:", "", *lines, ""])


def run(args: argparse.Namespace) -> int:
    """Build a program and print the next step.

    Raises:
        InterfaceError: A definition is wrong.
        ToolError: The program cannot be built.
    """
    chosen_board(args)
    program, out = program_folder(args.program), Path(args.out)
    _check_freeze(args, program)
    files = build_files(args, program, out)
    size = sum(file.stat().st_size for file in files)
    print(f"{out}: {len(files)} file{'s' if len(files) > 1 else ''}, {size} bytes")
    _tell_of_secrets(program)
    if args.freeze:
        from ...boards.deploy import frozen

        manifest_file, left = frozen.write_manifest(out, files, program)
        print("\nNext, with the sources of MicroPython, such as:\n")
        print("  make -C micropython/ports/rp2 BOARD=RPI_PICO_W \\")
        print(f"    FROZEN_MANIFEST={shlex.quote(str(manifest_file.resolve()))}")
        if left:
            print(f"\nNo modules, so copy them to the board: {', '.join(left)}")
        return 0
    if args.mip:
        from ...boards.deploy.mip import write_manifest

        manifest = shlex.quote(str(write_manifest(out, files)))
        print("\nNext, with the port of the board's console in place of PORT:\n")
        print(f"  mpremote connect PORT mip install --target . {manifest}")
        return 0
    print("\nNext, with the port of the board's console in place of PORT:\n")
    print(f"  uros board deploy {shlex.quote(str(out))} --port PORT")
    print("\nor with MicroPython's own tool:\n")
    print(f"  mpremote connect PORT cp -r {shlex.quote(str(out))}/* :")
    print("  mpremote connect PORT reset")
    return 0


def _check_freeze(args: argparse.Namespace, program: Path) -> None:
    """Raise ToolError if ``--freeze`` does not go with other options or with the program."""
    from ...boards.deploy.frozen import MANIFEST

    if args.freeze and (args.mpy or args.mip):
        raise ToolError(
            "--freeze takes the program as text, which the build of the firmware compiles: leave"
            f" {'--mpy' if args.mpy else '--mip'} out"
        )
    if args.freeze and (program / MANIFEST).exists():
        raise ToolError(f"{program / MANIFEST} has the name of the file that --freeze writes")


def _tell_of_secrets(program: Path) -> None:
    from ...boards.builder.secrets_file import FILE, first_import

    place = first_import(program)
    if place:
        print(
            f"\n{place} imports secrets, which a build leaves out. Copy them once, by"
            f" 'uros board deploy\n--secrets FILE' or: mpremote connect PORT cp FILE :{FILE}"
        )


def build_files(args: argparse.Namespace, program: Path, out: Path) -> list[Path]:
    """Build a program as the options say.

    Args:
        args: The command line.
        program: The program's folder.
        out: The folder to write.

    Returns:
        The files.

    Raises:
        InterfaceError: A definition is wrong.
        ToolError: The program cannot be built.
    """
    from ...boards.builder.errors import BuildError
    from ...boards.builder.file_system import build

    know_interfaces(args)
    form = "mpy" if args.mpy else "py"
    try:
        return build(program, out, form, without=args.without, provided=args.provided)
    except BuildError as error:
        raise ToolError(str(error)) from error
    except OSError as error:
        raise ToolError(f"{error.filename or out}: {error.strerror or error}") from error


def program_folder(name: str) -> Path:
    """Return the folder of a program.

    Args:
        name: The name of a virtual board, or a folder.

    Raises:
        ToolError: There is no such board or folder, or no main.py in it.
    """
    from ...boards.virtual.engine.runner import firmware_folder
    from ...boards.virtual.models.catalog import BOARDS, BoardError

    if name in BOARDS:
        try:
            return firmware_folder(BOARDS[name])
        except BoardError as error:
            raise ToolError(str(error)) from error
    folder = Path(name)
    if folder.is_file():
        raise ToolError(f"{name} is a file: give the folder of a main.py, such as {folder.parent}")
    if not folder.is_dir():
        beside = sorted(str(main.parent) for main in folder.parent.glob("*/main.py"))
        close = did_you_mean(name, [*beside, *BOARDS])
        if not close and folder.parent == Path():
            close = f" (boards: {', '.join(BOARDS)})"
        raise ToolError(
            f"there is no board or folder {name!r}{close or '; give the folder of a main.py'}"
        )
    if not (folder / "main.py").is_file():
        raise ToolError(f"{folder}: there is no main.py in it, which a board starts")
    return folder
