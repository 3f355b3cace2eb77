"""What a middleware can tell of the ROS graph, by its DDS names.

:mod:`uros.host.graph` makes ROS names of it for people, :mod:`uros.agent.objects.ros_graph` for
boards.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Protocol

from ..qos import QoSProfile


class EndpointSource(Protocol):
    """A writer or a reader; ``qos.user_data`` is what it announces itself."""

    @property
    def guid(self) -> bytes: ...
    @property
    def participant(self) -> bytes: ...
    @property
    def is_writer(self) -> bool: ...
    @property
    def topic(self) -> str: ...
    @property
    def type_name(self) -> str: ...
    @property
    def qos(self) -> QoSProfile: ...


class NodeSource(Protocol):
    """A node as its participant announces it, with the GUIDs of its endpoints."""

    namespace: str
    name: str
    readers: list[bytes]
    writers: list[bytes]


class Source(Protocol):
    """``participants`` maps a GUID to its USER_DATA, ``endpoints`` a GUID to the endpoint,
    ``announced`` a participant's GUID to its nodes, which may come before the participant.
    """

    @property
    def participants(self) -> Mapping[bytes, bytes]: ...
    @property
    def endpoints(self) -> Mapping[bytes, EndpointSource]: ...
    @property
    def announced(self) -> Mapping[bytes, Iterable[NodeSource]]: ...


class LiveSource(Source, Protocol):
    """A source that keeps itself up to date until it is closed."""

    def close(self) -> None:
        """Stop watching. Twice is once."""


def living_nodes(source: Source) -> list[NodeSource]:
    """The nodes of the participants that are there.

    A board's services may stand under a hidden node too, rclpy's in its agent
    (:mod:`.dds.hidden`): that one is left out, where all it has stands under the board's.
    """
    alive = source.participants
    nodes = [
        node
        for participant, announced in source.announced.items()
        if participant in alive
        for node in announced
    ]
    hidden = {(it.namespace, it.name[1:]) for it in nodes if it.name.startswith("_")}
    if not hidden:
        return nodes
    gids: dict[tuple[str, str], set[bytes]] = {}
    for node in nodes:
        name = node.namespace, node.name
        if name in hidden:
            gids.setdefault(name, set()).update(node.readers, node.writers)

    def stands_twice(node: NodeSource) -> bool:
        whole = gids.get((node.namespace, node.name[1:])) if node.name.startswith("_") else None
        return whole is not None and whole.issuperset([*node.readers, *node.writers])

    return [node for node in nodes if not stands_twice(node)]
