"""``uros board index``: build a package index for MicroPython's mip."""

from __future__ import annotations

import argparse
import shlex
from pathlib import Path
from typing import Final

from ..common import add_interfaces, know_interfaces
from ..errors import ToolError
from ..progress import Progress

_EPILOG: Final = """\
A package index for MicroPython's installer mip. It has the client ('uros'), its other modules one
by one ('uros-parameters'), and message types ('std_msgs/msg/Int32', or all of 'std_msgs'). Any web
server can serve the folder; boards on a network can install from it.

  uros board index build/mip
  python3 -m http.server --directory build/mip 8000

on the board:

  import mip
  mip.install("uros", index="http://192.168.1.2:8000")
  mip.install("std_msgs/msg/Int32", index="http://192.168.1.2:8000")

'uros board build' and 'deploy' make smaller files, because they know the program.
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of ``uros board index``."""
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    parser.epilog = _EPILOG
    parser.add_argument("out", metavar="OUT", help="folder to write; other files in it stay")
    parser.add_argument(
        "--py", dest="mpy", action="store_false",
        help="source only, which needs no mpy-cross (default: source and bytecode)",
    )  # fmt: skip
    add_interfaces(parser)


def run(args: argparse.Namespace) -> int:
    """Write the index and print how to use it.

    Raises:
        InterfaceError: A definition is wrong.
        ToolError: The index cannot be built.
    """
    from ...boards.builder.errors import BuildError
    from ...boards.deploy.mip import write_index

    know_interfaces(args)
    out = Path(args.out)
    try:
        with Progress("packages") as progress:
            forms = ("py", "mpy") if args.mpy else ("py",)
            names = write_index(out, forms, progress=progress.show)
    except BuildError as error:
        raise ToolError(str(error)) from error
    except OSError as error:
        raise ToolError(f"{error.filename or out}: {error.strerror or error}") from error
    own = [name for name in names if name.startswith("uros")]
    print(f"{out}: {len(names)} packages; of uros: {', '.join(own)}")
    print("\nNext, with the port of the board's console in place of PORT:\n")
    print(f"  mpremote connect PORT mip install --index {shlex.quote(str(out))} uros std_msgs")
    return 0
