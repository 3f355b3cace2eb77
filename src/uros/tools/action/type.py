"""``uros action type``: print the type of an action."""

from __future__ import annotations

import argparse

from ..common import add_action, add_common
from ..graph_types import print_types
from ..listing import add_json


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of ``uros action type``."""
    add_action(parser)
    add_common(parser)
    add_json(parser)


def run(args: argparse.Namespace) -> int:
    """Print the type of an action.

    Raises:
        ToolError: There is no such action.
    """
    return print_types(args, "action", args.action, lambda graph: graph.actions())
