"""Definitions of types that no folder has: asked of nodes that use them.

Nodes of ROS 2 since Jazzy serve ``~/get_type_description`` for the types of their endpoints. They
ask for the type's hash, which nobody announces of a service: this works for messages alone.
"""

from __future__ import annotations

import re
import tempfile
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from .errors import ToolError
from .service.client import ServiceClient
from .waiting import warn

if TYPE_CHECKING:
    from ..host.graph_queries import EndpointInfo
    from ..host.network import Network

_SERVICE: Final = "type_description_interfaces/srv/GetTypeDescription"
# Seconds to wait for a node, and the most nodes that are asked for a type.
_PATIENCE: Final = 2.0
_MOST_NODES: Final = 3
# Attack: a node that answers with ever more definitions, or with names that are paths.
_MOST_TYPES: Final = 256
_MESSAGE: Final = re.compile(r"[a-z][a-z0-9_]*/msg/[A-Za-z][A-Za-z0-9_]*")
_ENCODING: Final = "msg"
# type_description_interfaces/msg/FieldType: a type's number within its group of 48, and the groups.
_BASES: Final = {
    2: "int8", 3: "uint8", 4: "int16", 5: "uint16", 6: "int32", 7: "uint32", 8: "int64",
    9: "uint64", 10: "float32", 11: "float64", 13: "char", 15: "bool", 16: "byte", 17: "string",
    18: "wstring", 21: "string<={}", 22: "wstring<={}",
}  # fmt: skip
_NESTED: Final = 1
_GROUP: Final = 48
_SHAPES: Final = ("", "[{}]", "[<={}]", "[]")
# What stands for a structure without fields.
_NO_FIELDS: Final = "structure_needs_at_least_one_member"

# Holds the files for as long as the process runs.
_folders: list[tempfile.TemporaryDirectory[str]] = []


def know_type(network: Network, type_name: str) -> None:
    """Make a message known if no folder has its definition and a node in the domain does.

    Otherwise nothing happens, and loading the type tells what is wrong.

    Args:
        network: The domain; what is in it is discovered if the type is unknown.
        type_name: The message.
    """
    from ..interfaces import InterfaceError, registry

    name = registry.normalize(type_name)
    if registry.exists(name) or not _MESSAGE.fullmatch(name):
        return
    network.settle()
    try:
        answer = _ask_owners(network, name)
        if answer is None:
            return
        texts = definitions(answer)
    except (InterfaceError, ValueError) as error:
        warn(f"the definition of {type_name} that a node has cannot be used: {error}")
        return
    _add({each: text for each, text in texts.items() if not registry.exists(each)})


def definitions(answer: Any) -> dict[str, str]:
    """Return the texts of the files that define a message and the messages that it nests.

    Args:
        answer: A node's ``GetTypeDescription`` response: texts of files, and a description in place
            of each that is missing.

    Raises:
        ValueError: The description is too long, or nothing in ROS 2 interfaces is like it.
    """
    described = answer.type_description
    parts = [described.type_description, *described.referenced_type_descriptions]
    if len(parts) > _MOST_TYPES:
        raise ValueError(f"it has {len(parts)} parts; {_MOST_TYPES} are the most")
    texts = {
        source.type_name: source.raw_file_contents
        for source in answer.type_sources
        if source.encoding == _ENCODING
    }
    return {
        part.type_name: texts.get(part.type_name) or _section(part)
        for part in parts
        if _MESSAGE.fullmatch(part.type_name)
    }


def _section(part: Any) -> str:
    return "".join(
        f"{_field_type(field.type)} {field.name}\n"
        for field in part.fields
        if field.name != _NO_FIELDS
    )


def _field_type(kind: Any) -> str:
    shape, base = divmod(kind.type_id, _GROUP)
    if shape >= len(_SHAPES) or (base not in _BASES and base != _NESTED):
        raise ValueError(f"a field has the unknown type {kind.type_id}")
    if base == _NESTED:
        package, _, plain = kind.nested_type_name.partition("/msg/")
        text = f"{package}/{plain}"
    else:
        text = _BASES[base].format(kind.string_capacity)
    return text + _SHAPES[shape].format(kind.capacity)


# --- the nodes ----------------------------------------------------------------------------------


def _ask_owners(network: Network, name: str) -> Any:
    """Return the answer of a node that has an endpoint of a type, or None."""
    from ..middleware.base import MiddlewareError

    services = network.graph.services()
    asked: dict[str, str] = {}
    for endpoint in _endpoints(network, name):
        node = f"{endpoint.node_namespace.rstrip('/')}/{endpoint.node_name}"
        if f"{node}/get_type_description" in services:
            asked.setdefault(node, endpoint.type_hash)
    for node, type_hash in list(asked.items())[:_MOST_NODES]:
        try:
            answer = _ask(network, f"{node}/get_type_description", name, type_hash)
        except (ToolError, MiddlewareError):
            continue
        if answer.successful and answer.type_description.type_description.type_name == name:
            return answer
    return None


def _endpoints(network: Network, name: str) -> Iterator[EndpointInfo]:
    graph = network.graph
    for topic, types in graph.topics().items():
        if name in types:
            yield from _of_type(graph.publishers(topic), name)
            yield from _of_type(graph.subscriptions(topic), name)


def _of_type(endpoints: Iterable[EndpointInfo], name: str) -> Iterator[EndpointInfo]:
    return (endpoint for endpoint in endpoints if endpoint.type_name == name)


def _ask(network: Network, service: str, name: str, type_hash: str) -> Any:
    from ..interfaces import load

    kind = load(_SERVICE)
    client = ServiceClient(network, service, kind)
    try:
        client.match(_PATIENCE)
        request = kind.Request(type_name=name, type_hash=type_hash, include_type_sources=True)
        return client.answer(client.request(request), _PATIENCE)
    finally:
        client.close()


def _add(texts: Mapping[str, str]) -> None:
    """Make definitions known to this process."""
    from ..interfaces import add_folder

    folder = tempfile.TemporaryDirectory(prefix="uros_types_")
    _folders.append(folder)
    for name, text in texts.items():
        package, kind, plain = name.split("/")
        file = Path(folder.name, package, kind, f"{plain}.{kind}")
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(text, encoding="utf-8")
    add_folder(folder.name)
