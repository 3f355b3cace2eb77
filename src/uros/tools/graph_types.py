"""Types of topics, services and actions in the graph: what ``type``, ``find`` and others share."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING

from .common import discover, join, remedy
from .empty import explain_empty_list, explain_unknown_type
from .errors import ToolError
from .listing import entries, print_json

if TYPE_CHECKING:
    from ..host.graph_queries import Graph, NamesAndTypes
    from ..host.network import Network


def types_of(network: Network, what: str, name: str, known: Mapping[str, list[str]]) -> list[str]:
    """Return the types of a name.

    Args:
        network: The domain, for the remedy.
        what: What has the name: ``topic``, ``service`` or ``action``.
        name: The name.
        known: The types by name.

    Raises:
        ToolError: There is no such name.
    """
    if name not in known:
        raise ToolError(f"there is no {what} {name!r}{remedy(network, name, known)}")
    return known[name]


def only_type(verb: str, name: str, types: list[str]) -> str:
    """Return the type of a name, for a verb whose TYPE was left out.

    Args:
        verb: The verb with its group, such as ``topic echo``.
        name: The name.
        types: Its types.

    Raises:
        ToolError: It has several types.
    """
    if len(types) > 1:
        raise ToolError(
            f"{name} has several types: {', '.join(types)}; give one: uros {verb} {name} TYPE"
        )
    return types[0]


def print_types(
    args: argparse.Namespace, what: str, name: str, query: Callable[[Graph], NamesAndTypes]
) -> int:
    """Discover the domain and print the types of a name, a line each, or as JSON.

    Args:
        args: The command line.
        what: What has the name: ``topic``, ``service`` or ``action``.
        name: The name.
        query: Returns the types by name.

    Raises:
        ToolError: There is no such name.
    """
    with join(args) as network:
        discover(network, args)
        types = types_of(network, what, name, query(network.graph))
    if args.json:
        print_json(types)
        return 0
    for type_name in types:
        print(type_name)
    return 0


def print_names_of_type(
    args: argparse.Namespace,
    kind: str,
    find: Callable[[Network], NamesAndTypes],
    count_only: bool,
) -> int:
    """Print the names that have the type of the command line, a line each, or as JSON.

    Args:
        args: The command line.
        kind: The middle part of the type, which may be left out: ``msg``, ``srv`` or ``action``.
        find: Discovers the domain and returns the types by name.
        count_only: Whether to print only how many names there are.
    """
    package, slash, name = args.type.partition("/")
    wanted = f"{package}/{kind}/{name}" if slash and "/" not in name else args.type
    with join(args) as network:
        found = find(network)
        matches = {name: types for name, types in found.items() if wanted in types}
        if not matches:
            explain_empty_list(network)
            explain_unknown_type(wanted, found.values())
    if count_only:
        print(len(matches))
    elif args.json:
        print_json(entries(matches))
    else:
        for name in matches:
            print(name)
    return 0
