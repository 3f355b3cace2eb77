"""``uros board new``: begin a program for a board."""

from __future__ import annotations

import argparse
import shlex
from pathlib import Path
from typing import Final

from ..errors import ToolError

_EPILOG: Final = """\
Writes a folder with a program, its README, and its test, which runs it on a virtual board with an
agent. The last part of NAME becomes the name of the node. A folder that exists is left as it is.

examples:

  uros board new greenhouse
  python -m pytest greenhouse
  uros board run esp32_publisher --firmware greenhouse
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of ``uros board new``."""
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    parser.epilog = _EPILOG
    parser.add_argument("name", metavar="NAME", help="folder to create")


def run(args: argparse.Namespace) -> int:
    """Write the project and print the next steps.

    Raises:
        ToolError: The folder exists, its name is wrong, or it cannot be written.
    """
    from ...boards.template.project import ProjectError, write

    folder = Path(args.name)
    try:
        files = write(folder)
    except ProjectError as error:
        raise ToolError(str(error)) from error
    except OSError as error:
        raise ToolError(f"{error.filename or folder}: {error.strerror or error}") from error
    quoted = shlex.quote(str(folder))
    for file in files:
        print(file)
    print("\nNext, the test (pip install pytest), a virtual board, and a real one:\n")
    print(f"  python -m pytest {quoted}")
    print(f"  uros board run esp32_publisher --firmware {quoted}")
    print(f"  uros board deploy {quoted} --port PORT --mpy")
    return 0
