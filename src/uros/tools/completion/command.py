"""``uros completion``: print what a shell needs to complete command lines of uros."""

from __future__ import annotations

import argparse
import os
from pathlib import PurePath

from ..errors import UsageError
from .shells import FUNCTIONS, lines, open_quote, split


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of ``uros completion``."""
    parser.add_argument(
        "shell",
        metavar="SHELL",
        nargs="?",
        help=f"{', '.join(FUNCTIONS)} (default: the shell of SHELL); its start file evaluates the"
        " output",
    )
    # What the function of a shell calls: the shell, and the line up to the cursor.
    parser.add_argument("--next", metavar="SHELL", help=argparse.SUPPRESS)


def run(args: argparse.Namespace) -> int:
    """Print the function of a shell, or what may come next on a command line.

    Raises:
        UsageError: There is no completion for this shell.
    """
    if args.next:
        from .words import complete

        typed = args.shell or ""
        words = split(typed)[1:] or [""]
        for line in lines(args.next, words[-1], open_quote(typed), complete(words)):
            print(line)
        return 0
    shell = args.shell or PurePath(os.environ.get("SHELL", "")).name
    if shell not in FUNCTIONS:
        of = f"the shell {shell!r}" if shell else "an unknown shell, since SHELL is not set"
        raise UsageError(
            f"there is no completion for {of}; name one: uros completion {' | '.join(FUNCTIONS)}"
        )
    print(FUNCTIONS[shell], end="")
    return 0
