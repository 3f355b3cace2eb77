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
    """Return the nodes of the participants that are there."""
    alive = source.participants
    return [
        node
        for participant, announced in source.announced.items()
        if participant in alive
        for node in announced
    ]
