"""``uros service type``: print the type of a service."""

from __future__ import annotations

import argparse

from ..common import add_common, add_service
from ..graph_types import print_types
from ..listing import add_json


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of ``uros service type``."""
    add_service(parser)
    add_common(parser)
    add_json(parser)


def run(args: argparse.Namespace) -> int:
    """Print the type of a service.

    Raises:
        ToolError: There is no such service.
    """
    return print_types(args, "service", args.service, lambda graph: graph.services())
