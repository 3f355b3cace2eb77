"""Values of arguments: topics, nodes, types and other names.

An argument is recognized by its ``dest`` or its ``metavar``, which are the same in all verbs.
Hidden names of topics, services and nodes are left out, unless an option includes them or the
underscore of one is typed.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any, Final

from ...names import is_hidden, is_hidden_node, is_valid

# Seconds of discovery at most: a user waits for it.
_DISCOVERY: Final = 0.5
# The ``dest`` of the options that include hidden names.
_HIDDEN: Final = "include_hidden"
_INCLUDING: Final = frozenset(
    [_HIDDEN, "include_hidden_nodes", "include_hidden_services", "include_hidden_topics"]
)

Given = Mapping[str, Sequence[str]]


def candidates(
    action: argparse.Action, given: Given, path: Sequence[str], word: str
) -> Iterable[tuple[str, str]]:
    """Return values of an argument, each with a description or "".

    Args:
        action: The argument.
        given: The values of the arguments before, by their ``dest``.
        path: The words of the command.
        word: What of the value has been typed.
    """
    if isinstance(action, argparse._SubParsersAction):
        return [(one.dest, one.help or "") for one in action._choices_actions]
    if action.choices is not None:
        return [(str(choice), "") for choice in action.choices]
    known = _BY_DEST.get(action.dest) or _BY_METAVAR.get(str(action.metavar))
    if known is None:
        return ()
    found = known({**given, _HIDDEN: ()} if is_hidden(word) else given, path)
    # The first slash of a name may be left away.
    if word and not word.startswith("/"):
        found = [name.removeprefix("/") for name in found]
    return [(name, "") for name in found]


def _graph(given: Given, query: Callable[[Any], Iterable[str]]) -> list[str]:
    """Return the names that a query finds in the domain. RTPS of uros loads the fastest."""
    from ...host.network import Network
    from ...middleware.environment import environment_domain

    number = int(given["domain"][-1]) if given.get("domain") else environment_domain()
    with Network(number, "rtps") as network:
        network.settle(_DISCOVERY)
        return [name for name in query(network.graph) if is_valid(name)]


def _visible(
    given: Given, query: Callable[[Any], Iterable[str]], is_hidden: Callable[[str], bool]
) -> list[str]:
    """Return the names that a query finds, the hidden ones only if an option includes them."""
    includes = not _INCLUDING.isdisjoint(given)
    return [name for name in _graph(given, query) if includes or not is_hidden(name)]


def _topics(given: Given, path: Sequence[str]) -> list[str]:
    return _visible(given, lambda graph: graph.topics(), is_hidden)


def _nodes(given: Given, path: Sequence[str]) -> list[str]:
    return _visible(given, lambda graph: dict.fromkeys(graph.nodes()), is_hidden_node)


def _services(given: Given, path: Sequence[str]) -> list[str]:
    return _visible(given, lambda graph: graph.services(), is_hidden)


def _actions(given: Given, path: Sequence[str]) -> list[str]:
    return _graph(given, lambda graph: graph.actions())  # hidden ones too, as action list prints


def _types(given: Given, path: Sequence[str]) -> list[str]:
    from ...interfaces import add_folder, list_types

    for folder in given.get("interfaces", ()):
        add_folder(folder)
    kind = {"topic": "msg", "service": "srv", "action": "action"}.get(path[0], "")
    return [name for name in list_types() if kind in ("", name.split("/")[1])]


def _packages(given: Given, path: Sequence[str]) -> list[str]:
    from ...interfaces import registry

    return registry.packages()


def _boards(given: Given, path: Sequence[str]) -> list[str]:
    from ...boards.deploy.known_boards import NAMED
    from ...boards.virtual.models.catalog import BOARDS

    return list(NAMED if path[-1] in ("build", "deploy") else BOARDS)


def _distributions(given: Given, path: Sequence[str]) -> list[str]:
    from ...interfaces.distro import NAMES

    return list(NAMES)


def _shells(given: Given, path: Sequence[str]) -> list[str]:
    from .shells import FUNCTIONS

    return list(FUNCTIONS)


_Known = Callable[[Given, Sequence[str]], list[str]]
_BY_DEST: Final[Mapping[str, _Known]] = {
    "topic": _topics,
    "node": _nodes,
    "service": _services,
    "action": _actions,
    "type": _types,
    "package": _packages,
    "board": _boards,
    "boards": _boards,
    "shell": _shells,
    "distro": _distributions,
}
_BY_METAVAR: Final[Mapping[str, _Known]] = {
    "TOPIC": _topics,
    "NODE": _nodes,
    "TYPE": _types,
    "BOARD": _boards,
}
