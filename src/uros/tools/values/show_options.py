"""The options of how messages are printed: ``--csv``, ``--no-arr`` and more."""

from __future__ import annotations

import argparse
from typing import Final

from ..common import unsigned_int
from . import plain

_TRUNCATE: Final = 128


def add_show_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument(
        "--csv", action="store_true", help="print each message as a line of comma-separated values"
    )
    parser.add_argument("--no-arr", action="store_true", help="do not print arrays")
    parser.add_argument("--no-str", action="store_true", help="do not print strings")
    parser.add_argument(
        "-f", "--full-length", action="store_true", help="do not cut long arrays and strings"
    )
    parser.add_argument(
        "-l",
        "--truncate-length",
        metavar="N",
        type=unsigned_int,
        default=_TRUNCATE,
        help=f"cut arrays and strings to this length (default: {_TRUNCATE})",
    )
    parser.add_argument(
        "--flow-style", action="store_true", help="print arrays in brackets on one line"
    )


def chosen_show(args: argparse.Namespace) -> plain.Show:
    """Return how to print the values; ``--csv`` and ``--flow-style`` are for the caller."""
    cut = None if args.full_length else args.truncate_length
    return plain.Show(cut, args.no_arr, args.no_str)
