"""Definitions of types that no folder has: asked of nodes that use them.

Nodes of ROS 2 since Jazzy serve ``~/get_type_description`` for the types of their endpoints. They
ask for the type's hash, which nobody announces of a service: this works for messages alone.
"""

from __future__ import annotations

import re
import tempfile
import time
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
_POLL: Final = 0.05
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
    question = TypeQuestion(network, name, time.monotonic())
    try:
        while not network.spin(lambda: question.turn(time.monotonic()), _POLL):
            pass
        if question.answer is None:
            return
        texts = definitions(question.answer)
    except (InterfaceError, ValueError) as error:
        warn(f"the definition of {type_name} that a node has cannot be used: {error}")
        return
    finally:
        question.close()
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


def is_asked_for(type_name: str, endpoints: Iterable[EndpointInfo]) -> bool:
    """Return whether a type is one for which the nodes of these endpoints can be asked."""
    return bool(_MESSAGE.fullmatch(type_name)) and any(map(_has_hash, endpoints))


def _has_hash(endpoint: EndpointInfo) -> bool:
    return endpoint.type_hash.startswith("RIHS")


class TypeQuestion:
    """Asks the nodes that use a message for its definition, one after the other.

    It does not wait: call :meth:`turn` while the network is served, and :meth:`close` in the end.

    Args:
        network: The domain.
        name: The message.
        now: The time in seconds.
        patience: Seconds for a node to match, and as many for it to answer.
        appears: Seconds within which a node that can be asked may appear.

    Attributes:
        answer: The ``GetTypeDescription`` response, or None.
        node: The node that has given it, or is being asked.
    """

    def __init__(
        self,
        network: Network,
        name: str,
        now: float,
        patience: float = _PATIENCE,
        appears: float = 0.0,
    ) -> None:
        self._network = network
        self._name = name
        self._patience = patience
        self._appears_by = now + appears
        self._asked: set[str] = set()
        self._client: ServiceClient | None = None
        self._number: int | None = None
        self._until = 0.0
        self._request: Any = None
        self.answer: Any = None
        self.node = ""

    def turn(self, now: float) -> bool:
        """Go on; return whether the answer has come, or none will come."""
        from ..interfaces import InterfaceError
        from ..middleware.base import MiddlewareError

        try:
            if self._client is None and not self._ask_next(now):
                return self.answer is not None or bool(self._asked) or now >= self._appears_by
            answer = self._poll(now)
        except (ToolError, MiddlewareError, InterfaceError):
            self.close()
            return False
        if answer is None:
            return False
        self.close()
        described = answer.type_description.type_description.type_name
        if not answer.successful or described != self._name:
            return False
        self.answer = answer
        return True

    def _ask_next(self, now: float) -> bool:
        """Create a client of the next node; return whether there is one."""
        from ..interfaces import load

        if self.answer is not None or len(self._asked) >= _MOST_NODES:
            return False
        services = self._network.graph.services()
        for endpoint in _endpoints(self._network, self._name):
            node = f"{endpoint.node_namespace.rstrip('/')}/{endpoint.node_name}"
            service = f"{node}/get_type_description"
            if node in self._asked or service not in services or not _has_hash(endpoint):
                continue
            self._asked.add(node)
            self.node = node
            kind = load(_SERVICE)
            self._request = kind.Request(
                type_name=self._name, type_hash=endpoint.type_hash, include_type_sources=True
            )
            self._number, self._until = None, now + self._patience
            self._client = ServiceClient(self._network, service, kind)
            return True
        return False

    def _poll(self, now: float) -> Any:
        """Return the answer of the node; None if it has not come yet."""
        client = self._client
        assert client is not None
        if self._number is None and client.is_matched():
            self._number = client.try_request(self._request)
            self._until = now + self._patience
        if self._number is not None and client.is_answered(self._number):
            return client.response(self._number)
        if now >= self._until:
            raise ToolError(f"{self.node} does not answer")
        return None

    def close(self) -> None:
        """Delete the client; idempotent."""
        if self._client is not None:
            self._client.close()
            self._client = None


def _endpoints(network: Network, name: str) -> Iterator[EndpointInfo]:
    graph = network.graph
    for topic, types in graph.topics().items():
        if name in types:
            yield from _of_type(graph.publishers(topic), name)
            yield from _of_type(graph.subscriptions(topic), name)


def _of_type(endpoints: Iterable[EndpointInfo], name: str) -> Iterator[EndpointInfo]:
    return (endpoint for endpoint in endpoints if endpoint.type_name == name)


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
