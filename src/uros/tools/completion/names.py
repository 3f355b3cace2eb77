"""Values of arguments: topics, nodes, types and other names.

An argument is recognized by its ``dest`` or its ``metavar``, which are the same in all verbs.
Hidden names of topics, services and nodes are left out, unless an option includes them or the
underscore of one is typed.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterable, Mapping
from typing import Any, Final

from ...names import is_hidden, is_hidden_node, is_valid
from . import details
from .details import DISCOVERY, Typed, joined, know_folders
from .shells import NO_FILES

# The ``dest`` of the options that include hidden names.
_HIDDEN: Final = "include_hidden"
_INCLUDING: Final = frozenset(
    [_HIDDEN, "include_hidden_nodes", "include_hidden_services", "include_hidden_topics"]
)


def candidates(action: argparse.Action, typed: Typed) -> Iterable[tuple[str, str]]:
    """Return values of an argument, each with a description or "".

    Nothing is found where the domain cannot be joined, or a value before or a type is wrong: the
    command itself says what is.
    """
    from ...middleware.base import MiddlewareError
    from ..errors import ToolError

    if isinstance(action, argparse._SubParsersAction):
        return [(one.dest, one.help or "") for one in action._choices_actions]
    if action.choices is not None:
        return [(str(choice), "") for choice in action.choices]
    known = _BY_DEST.get(action.dest) or _BY_METAVAR.get(str(action.metavar))
    if known is None:
        return ()
    if is_hidden(typed.word):
        typed = typed._replace(given={**typed.given, _HIDDEN: ()})
    try:
        found = known(typed)
    except (MiddlewareError, ToolError, ValueError, OSError):
        found = []
    # The first slash of a name may be left away.
    if typed.word and not typed.word.startswith("/"):
        found = [name.removeprefix("/") for name in found]
    candidates = [(name, "") for name in found]
    return [*candidates, NO_FILES] if action.dest == "values" else candidates


def _graph(typed: Typed, query: Callable[[Any], Iterable[str]]) -> list[str]:
    """Return the names that a query finds in the domain."""
    with joined(typed) as network:
        network.settle(DISCOVERY)
        return [name for name in query(network.graph) if is_valid(name)]


def _visible(
    typed: Typed, query: Callable[[Any], Iterable[str]], is_hidden: Callable[[str], bool]
) -> list[str]:
    """Return the names that a query finds, the hidden ones only if an option includes them."""
    includes = not _INCLUDING.isdisjoint(typed.given)
    return [name for name in _graph(typed, query) if includes or not is_hidden(name)]


def _topics(typed: Typed) -> list[str]:
    return _visible(typed, lambda graph: graph.topics(), is_hidden)


def _nodes(typed: Typed) -> list[str]:
    return _visible(typed, lambda graph: dict.fromkeys(graph.nodes()), is_hidden_node)


def _services(typed: Typed) -> list[str]:
    return _visible(typed, lambda graph: graph.services(), is_hidden)


def _actions(typed: Typed) -> list[str]:
    return _graph(typed, lambda graph: graph.actions())  # hidden ones too, as action list prints


def _types(typed: Typed) -> list[str]:
    """Return the types of the name on the line, or all of this kind if none of them fits."""
    from ...interfaces import list_types

    own = [name for name in details.types(typed) if name.startswith(typed.word)]
    if own:
        return own
    know_folders(typed)
    kind = {"topic": "msg", "service": "srv", "action": "action"}.get(typed.path[0], "")
    return [name for name in list_types() if kind in ("", name.split("/")[1])]


def _packages(typed: Typed) -> list[str]:
    from ...interfaces import registry

    return registry.packages()


def _boards(typed: Typed) -> list[str]:
    from ...boards.deploy.known_boards import NAMED
    from ...boards.virtual.models.catalog import BOARDS

    return list(NAMED if typed.path[-1] in ("build", "deploy") else BOARDS)


def _distributions(typed: Typed) -> list[str]:
    from ...interfaces.distro import NAMES

    return list(NAMES)


def _shells(typed: Typed) -> list[str]:
    from .shells import FUNCTIONS

    return list(FUNCTIONS)


_Known = Callable[[Typed], list[str]]
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
    "parameter": details.parameters,
    "parameters": details.parameters,
    "pairs": details.parameters,
    "transition": details.transitions,
    "values": details.prototype,
    "paths": details.plotted,
    "field": details.fields,
}
_BY_METAVAR: Final[Mapping[str, _Known]] = {
    "TOPIC": _topics,
    "NODE": _nodes,
    "TYPE": _types,
    "BOARD": _boards,
}
