"""``uros param dump``: print the parameters of a node as a parameter file."""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from typing import Any

from ..common import add_served_node, join
from .node import parameter_node
from .values import Typed, plain


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of ``uros param dump``."""
    add_served_node(parser)
    parser.add_argument("--print", action="store_true", help=argparse.SUPPRESS)  # of Humble


def run(args: argparse.Namespace) -> int:
    """Print the parameters.

    Raises:
        ToolError: There is no such node, or it does not answer.
    """
    with join(args) as network:
        node = parameter_node(network, args)
        names = node.names()
        values = node.get(names)
        if values is None:  # one of them has no value, and the node then gives none
            values = [(node.get([name]) or [Typed(0, None)])[0] for name in names]
    print(dumped(node.name, dict(zip(names, values, strict=True))))
    return 0


def dumped(node: str, values: Mapping[str, Typed]) -> str:
    """Return the parameter file of a node, as PyYAML writes it for ``ros2 param dump``."""
    import yaml

    tree: dict[str, Any] = {}
    for name in sorted(values):
        _insert(tree, name, plain(values[name]))
    text: str = yaml.dump({node: {"ros__parameters": tree}}, default_flow_style=False)
    return text


def _insert(tree: dict[str, Any], name: str, value: Any) -> None:
    """Insert a value below the parts of its dotted name.

    Where a parameter has the name of such a part, the rest of the name stays in one piece.
    """
    while "." in name:
        part, rest = name.split(".", 1)
        inner = tree.setdefault(part, {})
        if not isinstance(inner, dict):
            break
        tree, name = inner, rest
    tree[name] = value
