"""``uros bag reindex``: write metadata.yaml of a bag from its files."""

from __future__ import annotations

import argparse

from .arguments import add_bag


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of ``uros bag reindex``."""
    add_bag(parser)


def run(args: argparse.Namespace) -> int:
    """Write the metadata and say what they have."""
    from ...bag.metadata import FILE_NAME
    from ...bag.reindex import reindex

    metadata = reindex(args.bag_path, args.storage)
    print(
        f"{args.bag_path}: {FILE_NAME} is written: {metadata.message_count} messages in"
        f" {len(metadata.files)} file{'s' if len(metadata.files) != 1 else ''}"
    )
    return 0
