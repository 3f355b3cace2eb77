"""``uros param delete``: delete a parameter."""

from __future__ import annotations

import argparse

from ...client.parameter import ParameterType
from ..common import add_served_node, join
from .node import parameter_node
from .set import report
from .values import Typed


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of ``uros param delete``."""
    add_served_node(parser)
    parser.add_argument("parameter", metavar="PARAMETER", help="name of the parameter")


def run(args: argparse.Namespace) -> int:
    """Delete a parameter.

    Returns:
        1 if the node has refused it, else 0.

    Raises:
        ToolError: There is no such node, or it does not answer.
    """
    values = {args.parameter: Typed(ParameterType.NOT_SET + 0, None)}
    with join(args) as network:
        node = parameter_node(network, args)
        return report(
            node, values, node.set(values),
            "Deleted parameter successfully", "Deleting parameter failed",
        )  # fmt: skip
