"""``uros param load``: set the parameters of a node from a file."""

from __future__ import annotations

import argparse

from ...client.parameter import ParameterType
from ..common import add_served_node, join
from ..waiting import warn
from .file import read_file
from .node import parameter_node
from .set import report


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of ``uros param load``."""
    add_served_node(parser)
    parser.add_argument(
        "file", metavar="FILE", help="parameter file, as 'uros param dump' prints it"
    )
    parser.add_argument(
        "--no-use-wildcard", action="store_true",
        help="leave out what stands in the file below /** and other wildcards",
    )  # fmt: skip


def run(args: argparse.Namespace) -> int:
    """Set the parameters; print what is set and what is not.

    Returns:
        1 if the node has refused one of them, else 0.

    Raises:
        ToolError: The file does not fit, there is no such node, or it does not answer.
    """
    from ... import names

    values = read_file(args.file, names.absolute(args.node), not args.no_use_wildcard)
    for name in [n for n, typed in values.items() if typed.kind == ParameterType.NOT_SET]:
        del values[name]
        warn(f"{name} has no value in {args.file}, and is left as it is")
    with join(args) as network:
        node = parameter_node(network, args)
        return report(
            node, values, node.set(values) if values else [],
            "Set parameter {} successful", "Set parameter {} failed",
        )  # fmt: skip
