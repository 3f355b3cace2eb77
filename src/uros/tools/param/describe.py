"""``uros param describe``: print type, description and constraints of parameters."""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from typing import Any

from ...printable import printable
from ..common import add_served_node, join
from ..errors import ToolError
from .node import parameter_node
from .values import type_name


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of ``uros param describe``."""
    add_served_node(parser)
    parser.add_argument(
        "parameters", metavar="PARAMETER", nargs="+", help="names of the parameters"
    )


def run(args: argparse.Namespace) -> int:
    """Print what the node says of its parameters.

    Raises:
        ToolError: There is no such node or parameter, or the node does not answer.
    """
    with join(args) as network:
        node = parameter_node(network, args)
        fault = node.unknown(args.parameters)
        if fault:
            raise ToolError(fault)
        descriptors = node.describe(args.parameters)
    for descriptor in descriptors:
        print("\n".join(_lines(descriptor)))
    return 0


def _lines(descriptor: Any) -> Iterator[str]:
    """Yield the lines of a ``rcl_interfaces/msg/ParameterDescriptor``, as ros2 prints them."""
    yield f"Parameter name: {printable(descriptor.name)}"
    yield f"  Type: {type_name(descriptor.type)}"
    if descriptor.description:
        yield f"  Description: {printable(descriptor.description)}"
    yield "  Constraints:"
    if descriptor.read_only:
        yield "    Read only: true"
    for limits in [*descriptor.floating_point_range, *descriptor.integer_range][:1]:
        yield f"    Min value: {limits.from_value}"
        yield f"    Max value: {limits.to_value}"
        if limits.step:
            yield f"    Step: {limits.step}"
    if descriptor.additional_constraints:
        yield f"    Additional constraints: {printable(descriptor.additional_constraints)}"
