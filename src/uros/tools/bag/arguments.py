"""The arguments of the verbs that read one bag."""

from __future__ import annotations

import argparse
import os
from pathlib import Path

from ..errors import did_you_mean


def add_bag(parser: argparse.ArgumentParser) -> None:
    """Declare the bag and ``--storage``."""
    parser.add_argument(
        "bag_path", metavar="BAG", type=existing_path, help="folder of the bag, or one of its files"
    )
    add_storage(parser, "what the bag says")


def add_storage(parser: argparse.ArgumentParser, default: str) -> None:
    """Declare ``--storage``; ``default`` says what is used without it."""
    parser.add_argument(
        "-s", "--storage", choices=("mcap", "sqlite3"), default="",
        help=f"format of the files (default: {default})",
    )  # fmt: skip


def existing_path(text: str) -> str:
    """Parse the path of a folder or file that exists."""
    if not os.path.exists(text):
        meant = did_you_mean(Path(text).name, _beside(text))
        raise argparse.ArgumentTypeError(f"{text!r}: no such folder or file{meant}")
    return text


def _beside(text: str) -> list[str]:
    try:
        return os.listdir(Path(text).parent)
    except OSError:
        return []
