"""What a middleware knows of the ROS graph, by DDS names.

:mod:`uros.host.graph_queries` makes ROS names of it for users,
:mod:`uros.agent.objects.ros_graph` for boards.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Protocol

from ..qos import QoSProfile


class EndpointSource(Protocol):
    """A writer or a reader; ``qos.user_data`` is the USER_DATA it announces."""

    @property
    def guid(self) -> bytes:
        """Its GUID."""

    @property
    def participant(self) -> bytes:
        """The GUID of its participant."""

    @property
    def is_writer(self) -> bool:
        """Whether it is a writer."""

    @property
    def topic(self) -> str:
        """The DDS name of its topic."""

    @property
    def type_name(self) -> str:
        """The DDS name of its type."""

    @property
    def qos(self) -> QoSProfile:
        """Its profile."""


class NodeSource(Protocol):
    """A node as its participant announces it, with the GUIDs of its endpoints."""

    namespace: str
    name: str
    readers: list[bytes]
    writers: list[bytes]


class Source(Protocol):
    """A graph as it is known now."""

    @property
    def participants(self) -> Mapping[bytes, bytes]:
        """USER_DATA of each participant, by its GUID."""

    @property
    def endpoints(self) -> Mapping[bytes, EndpointSource]:
        """The endpoints by their GUIDs."""

    @property
    def announced(self) -> Mapping[bytes, Iterable[NodeSource]]:
        """The nodes of each participant, by its GUID; it may not be discovered yet."""


class LiveSource(Source, Protocol):
    """A source that keeps itself up to date until it is closed."""

    def close(self) -> None:
        """Stop watching; idempotent."""


def living_nodes(source: Source) -> list[NodeSource]:
    """Return the nodes of the participants that are there.

    A board's services may belong to a hidden node too, rclpy's in its agent
    (:mod:`.dds.suppressed_nodes`). That one is left out if the board's node lists all of its
    endpoints.
    """
    alive = source.participants
    nodes = [
        node
        for participant, announced in source.announced.items()
        if participant in alive
        for node in announced
    ]
    doubles = {(node.namespace, node.name[1:]) for node in nodes if node.name.startswith("_")}
    if not doubles:
        return nodes
    gids: dict[tuple[str, str], set[bytes]] = {}
    for node in nodes:
        name = node.namespace, node.name
        if name in doubles:
            gids.setdefault(name, set()).update(node.readers, node.writers)

    def is_double(node: NodeSource) -> bool:
        if not node.name.startswith("_"):
            return False
        listed = gids.get((node.namespace, node.name[1:]))
        return listed is not None and listed.issuperset([*node.readers, *node.writers])

    return [node for node in nodes if not is_double(node)]
