"""What a middleware can tell of the ROS graph, by its DDS names.

:mod:`uros.host.graph` makes ROS names of it for people, :mod:`uros.agent.graph` for boards.
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
    ``announced`` a participant's GUID to its nodes, which may come before the participant."""

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
    """The nodes of the participants that are there."""
    alive = source.participants
    return [
        node
        for participant, nodes in source.announced.items()
        if participant in alive
        for node in nodes
    ]
