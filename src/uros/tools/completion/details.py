"""Values that depend on one before them: parameters of a node, the type of a topic, its fields.

There are none where the node does not answer soon.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any, Final, NamedTuple

if TYPE_CHECKING:
    from ...host.network import Network

# Seconds of discovery at most, and for a node to answer: a user waits for it.
DISCOVERY: Final = 0.5
_ANSWER: Final = 0.5


class Typed(NamedTuple):
    """What has been typed of a command line.

    Attributes:
        given: The values of the arguments before the last word, by their ``dest``.
        path: The words of the command.
        word: The last word, or the value in it.
    """

    given: Mapping[str, Sequence[str]]
    path: Sequence[str]
    word: str


@contextmanager
def joined(typed: Typed) -> Iterator[Network]:
    """Join the domain of a command line. RTPS of uros loads the fastest."""
    from ...host.network import Network
    from ...middleware.environment import environment_domain

    given = typed.given.get("domain")
    with Network(int(given[-1]) if given else environment_domain(), "rtps") as network:
        yield network


def know_folders(typed: Typed) -> None:
    """Apply ``--interfaces`` of a command line."""
    from ...interfaces import add_folder

    for folder in typed.given.get("interfaces", ()):
        add_folder(folder)


def parameters(typed: Typed) -> list[str]:
    """Return the parameters of the node, without those that the line has already."""
    pairs = typed.given.get("pairs", ())
    if len(pairs) % 2:
        return []  # the value of the last one
    response = _ask(typed, "list_parameters", "rcl_interfaces/srv/ListParameters")
    given = {*pairs[::2], *typed.given.get("parameters", ())}
    return sorted({*response.result.names} - given) if response else []


def transitions(typed: Typed) -> list[str]:
    """Return the labels of the transitions that the state of the node allows."""
    kind = "lifecycle_msgs/srv/GetAvailableTransitions"
    response = _ask(typed, "get_available_transitions", kind)
    available = response.available_transitions if response else ()
    return list(dict.fromkeys(each.transition.label for each in available))


def _ask(typed: Typed, service: str, type_name: str) -> Any:
    """Return the response of the node; None without one."""
    from ...interfaces import load
    from ...names import absolute
    from ..errors import ToolError
    from ..service.client import Call, call_all

    name = f"{absolute(typed.given['node'][-1])}/{service}"
    kind = load(type_name)
    with joined(typed) as network:
        if not network.spin(lambda: bool(network.graph.servers(name)), DISCOVERY):
            return None
        (response,) = call_all(network, [Call(name, kind, kind.Request())], _ANSWER)
    return None if isinstance(response, ToolError) else response


def _types(typed: Typed) -> dict[str, list[str]]:
    """Return the topics of the domain with their types; of other groups the services or actions."""
    from ...names import is_valid

    with joined(typed) as network:
        network.settle(DISCOVERY)
        graph = network.graph
        query = {"service": graph.services, "action": graph.actions}.get(typed.path[0])
        return {name: types for name, types in (query or graph.topics)().items() if is_valid(name)}


def types(typed: Typed) -> list[str]:
    """Return the types of the topic, service or action that was typed before."""
    from ...names import absolute

    given = typed.given.get(typed.path[0])
    return _types(typed).get(absolute(given[0]), []) if given else []


def prototype(typed: Typed) -> list[str]:
    """Return the VALUES of the type before them: all fields with their defaults, as YAML."""
    from ..values.plain import Show, plain
    from ..values.typed_values import load_action, load_message, load_service
    from ..values.yaml_text import one_line

    know_folders(typed)
    name = typed.given["type"][0]
    if typed.path[0] == "service":
        kind = load_service(name).Request
    elif typed.path[0] == "action":
        kind = load_action(name).Goal
    else:
        kind = load_message(name)
    # A byte is a number as well, which needs no quotes and no escape.
    return [one_line(plain(kind(), Show(truncate=None))).replace(r'"\0"', "0")]


def plotted(typed: Typed) -> list[str]:
    """Return topics with a slash behind; of a topic that was typed, its numbers."""
    from ...interfaces import load
    from ...names import is_hidden
    from ..plot.field import numbers

    know_folders(typed)
    word = typed.word if typed.word.startswith("/") else f"/{typed.word}"
    found = []
    for topic, kinds in _types(typed).items():
        start = f"{topic}/"
        if word.startswith(start):
            paths = numbers(load(kinds[0]))
            found += [start + path for path in _next_parts(paths, word.removeprefix(start))]
        elif is_hidden(word) or not is_hidden(topic):
            found.append(start)
    return found


def _next_parts(paths: Iterable[str], typed: str) -> Iterable[str]:
    """Return what paths go on with, up to the next slash."""
    ends = ((path, path.find("/", len(typed))) for path in paths if path.startswith(typed))
    return dict.fromkeys(path if end < 0 else path[: end + 1] for path, end in ends)


def fields(typed: Typed) -> list[str]:
    """Return the fields of the messages of the topic that may stand in place of the last one."""
    from ...interfaces import load
    from ..values.plain import element

    found = typed.given.get("type") or types(typed)
    if not found:
        return []
    know_folders(typed)
    message = load(found[0])
    before, dot, _ = typed.word.rpartition(".")
    for part in before.split(".") if dot else ():
        name, index, _ = part.partition("[")
        kind = dict(message._FIELDS).get(name, "")
        kind = element(kind) if index else kind
        if "/" not in kind or element(kind):
            return []
        message = load(kind)
    return [f"{before}{dot}{name}" for name, _ in message._FIELDS]
