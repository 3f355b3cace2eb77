"""``uros param list``: list the parameters of one node or of all."""

from __future__ import annotations

import argparse
import re
from typing import TYPE_CHECKING

from ...printable import printable
from ..common import add_served_node, discover, join
from ..empty import explain_empty_list
from ..errors import ToolError
from ..listing import add_json, print_json
from ..node.list import visible_nodes
from ..waiting import warn
from . import node

if TYPE_CHECKING:
    from ...host.network import Network


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of ``uros param list``."""
    add_served_node(parser, "?")
    parser.add_argument(
        "--filter", metavar="REGEX", type=_regex,
        help="list only parameters whose names begin with what the regular expression matches",
    )  # fmt: skip
    parser.add_argument(
        "--param-prefixes", metavar="PREFIX", nargs="+", default=[],
        help="list only parameters with these prefixes, such as arm for arm.speed",
    )  # fmt: skip
    parser.add_argument("--param-type", action="store_true", help="print the types too")
    add_json(parser)


def _regex(text: str) -> re.Pattern[str]:
    try:
        return re.compile(text)
    except re.error as error:
        raise argparse.ArgumentTypeError(
            f"{text!r} is not a regular expression: {error}"
        ) from error


def run(args: argparse.Namespace) -> int:
    """Print the names of parameters.

    Returns:
        1 if a node did not answer, else 0.

    Raises:
        ToolError: There is no such node, it has no parameters, or it does not answer.
    """
    with join(args) as network:
        if args.node is None:
            nodes = _nodes(network, args)
        else:
            nodes = [node.parameter_node(network, args).name]
        found = node.list_all(network, nodes, args.param_prefixes, args.timeout)
        listed = {
            name: [each for each in names if args.filter is None or args.filter.match(each)]
            for name, names in found.items()
            if isinstance(names, list)
        }
        types = node.types_of_all(network, listed, args.timeout) if args.param_type else {}
    failed = {
        name: error
        for name, error in (*found.items(), *types.items())
        if isinstance(error, ToolError)
    }
    if args.node is not None and failed:
        raise failed[nodes[0]]
    for name in failed:
        warn(f"the parameters of {name} are not listed: {failed[name]}")
    if args.json:
        print_json(
            [
                {"node": name, "name": each, "type": types[name].get(each)}
                if types
                else {"node": name, "name": each}
                for name in found
                if name not in failed
                for each in listed[name]
            ]
        )
        return int(bool(failed))
    for name in found:
        if name in failed:
            continue
        if args.node is None and listed[name]:
            print(f"{name}:")
        for parameter in listed[name]:
            kind = f" (type: {types[name].get(parameter, 'not set')})" if types else ""
            print(f"  {printable(parameter)}{kind}")
    return int(bool(failed))


def _nodes(network: Network, args: argparse.Namespace) -> list[str]:
    """Return the names of the nodes that have parameters."""
    discover(network, args)
    names = [
        name
        for name in visible_nodes(network, args.include_hidden_nodes)
        if network.graph.servers(f"{name}/list_parameters")
    ]
    if not names:
        explain_empty_list(network)
    return names
