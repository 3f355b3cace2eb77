"""What a middleware knows of the ROS graph, by DDS names.

:mod:`uros.host.graph_queries` makes ROS names of it for users,
:mod:`uros.agent.objects.ros_graph` for boards.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Protocol

from ..qos import QoSProfile
from . import user_data
from .discovery_info import codec


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

    def reread_discovery_info(self) -> None:
        """Get the nodes of :func:`with_missed_discovery_info` again."""

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


def without_discovery_info(source: Source) -> set[bytes]:
    """Return the ROS participants (they have an enclave) whose nodes are not known yet.

    Those that say that they announce none are left out.
    """
    announced = source.announced
    return {
        guid
        for guid, data in source.participants.items()
        if user_data.ENCLAVE in data
        and user_data.WITHOUT_NODES not in data
        and guid not in announced
    }


def with_missed_discovery_info(source: Source) -> set[bytes]:
    """Return those of them that have a writer of ``ros_discovery_info`` already.

    If the sample does not come, :meth:`LiveSource.reread_discovery_info` gets it.
    """
    writing = {
        endpoint.participant
        for endpoint in source.endpoints.values()
        if endpoint.is_writer and endpoint.topic == codec.TOPIC
    }
    return without_discovery_info(source) & writing


def undiscovered_endpoints(source: Source) -> set[bytes]:
    """Return the endpoints that nodes list and that were not discovered yet."""
    endpoints = source.endpoints
    return {
        gid
        for node in living_nodes(source)
        for gid in (*node.readers, *node.writers)
        if gid not in endpoints
    }


def without_endpoints(source: Source) -> set[bytes]:
    """Return the participants without any discovered endpoint."""
    return source.participants.keys() - {
        endpoint.participant for endpoint in source.endpoints.values()
    }
