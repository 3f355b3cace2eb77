"""``uros lifecycle get``: print the states of nodes."""

from __future__ import annotations

import argparse

from ..common import add_served_node, discover, join
from ..empty import explain_empty_list
from ..errors import ToolError
from ..listing import add_json, print_json
from ..waiting import warn
from .node import described, find_lifecycle_node, lifecycle_nodes, states


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of ``uros lifecycle get``."""
    add_served_node(parser, "?")
    add_json(parser)


def run(args: argparse.Namespace) -> int:
    """Print the state of a node, or of all that have a life cycle.

    Returns:
        1 if a node did not answer, else 0.

    Raises:
        ToolError: There is no such node, it has no life cycle, or it does not answer.
    """
    with join(args) as network:
        if args.node is None:
            discover(network, args)
            nodes = list(dict.fromkeys(lifecycle_nodes(network, args.include_hidden_nodes)))
            if not nodes:
                explain_empty_list(network)
        else:
            nodes = [find_lifecycle_node(network, args)]
        found = states(network, nodes, args.timeout)
    status = 0
    documents = []
    for node, state in found.items():
        if isinstance(state, ToolError):
            if args.node is not None:
                raise state
            warn(f"the state of {node} is not known: {state}")
            status = 1
        elif args.json:
            documents.append({"name": node, "state": state.label, "id": state.id})
        else:
            print(described(state) if args.node is not None else f"{node}: {described(state)}")
    if args.json:
        print_json(documents if args.node is None else documents[0])
    return status
