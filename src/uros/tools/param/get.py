"""``uros param get``: print the value of a parameter."""

from __future__ import annotations

import argparse

from ...client.parameter import ParameterType
from ..common import add_served_node, join
from ..errors import ToolError
from ..listing import add_json, print_json
from .node import parameter_node
from .values import Typed, json_value, shown, type_name


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of ``uros param get``."""
    add_served_node(parser)
    parser.add_argument("parameter", metavar="PARAMETER", help="name of the parameter")
    parser.add_argument(
        "--hide-type", action="store_true", help="print the value alone, without its type"
    )
    add_json(parser)


def run(args: argparse.Namespace) -> int:
    """Print a value.

    Raises:
        ToolError: There is no such node or parameter, or the node does not answer.
    """
    with join(args) as network:
        node = parameter_node(network, args)
        (typed,) = node.get([args.parameter]) or (Typed(ParameterType.NOT_SET, None),)
        if typed.kind == ParameterType.NOT_SET and (fault := node.unknown([args.parameter])):
            raise ToolError(fault)
    if args.json:
        print_json(
            {
                "node": node.name,
                "name": args.parameter,
                "type": type_name(typed.kind),
                "value": json_value(typed),
            }
        )
    else:
        print(shown(typed, args.hide_type))
    return 0
